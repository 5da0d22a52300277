"""The quality of a magnetic field: hard and soft iron that are known are found, and the rest is refused."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from xbus.report import Quality, magnetic_field_quality
from xbus.report.field_quality import FieldRows

Array = npt.NDArray[Any]


def directions(rows: int, seed: int = 0) -> Array:
    """Returns random directions, evenly distributed."""
    found = np.random.default_rng(seed).normal(size=(rows, 3))
    return np.asarray(found / np.linalg.norm(found, axis=1)[:, None])


def noise(rows: int, deviation: float, seed: int = 1) -> Array:
    return np.random.default_rng(seed).normal(scale=deviation, size=(rows, 3))


def refused(values: Array) -> str:
    """Returns why a field is not judged."""
    found = magnetic_field_quality(values)
    assert found.quality == Quality.UNKNOWN
    assert (found.ellipsoid, found.before, found.after) == (None, None, None)
    head, _, reason = found.verdict.partition(": ")
    assert head == "not enough motion to judge"
    return reason.partition("; turn the device about all of its axes")[0]


offsets = st.tuples(*[st.floats(-0.5, 0.5)] * 3)
factors = st.tuples(*[st.floats(0.7, 1.4)] * 3)
shears = st.tuples(*[st.floats(-0.15, 0.15)] * 3)


@settings(max_examples=30, deadline=None)
@given(offsets, factors, shears, st.floats(0, 0.01), st.integers(0, 9), st.floats(-1, 1))
def test_known_iron_is_found_or_refused(
    hard: Any, scale: Any, shear: Any, deviation: float, seed: int, lowest: float
) -> None:
    soft = np.diag(scale)
    soft[np.triu_indices(3, 1)] = soft.T[np.triu_indices(3, 1)] = shear
    seen = directions(2000, seed)
    seen = seen[seen @ directions(1, seed)[0] > lowest]  # a cap, or the whole sphere
    found = magnetic_field_quality(seen @ soft + hard + noise(len(seen), deviation, seed))
    if lowest < -0.3:
        assert found.quality != Quality.UNKNOWN
        assert found.coverage == pytest.approx((1 - max(lowest, -1)) / 2, abs=0.15)
    if found.ellipsoid is None:
        assert found.verdict.startswith("not enough motion to judge: ")
        return
    worst = 0.01 + 10 * deviation
    np.testing.assert_allclose(found.ellipsoid.center, hard, atol=worst)
    wanted = np.linalg.inv(soft)
    wanted /= np.cbrt(np.linalg.det(wanted))
    np.testing.assert_allclose(found.ellipsoid.shape, wanted, atol=worst)
    assert found.ellipsoid.radius == pytest.approx(np.cbrt(np.linalg.det(soft)), abs=worst)
    assert found.after is not None
    assert deviation / 2.5 - 1e-3 < found.after < 2.5 * deviation + 1e-3


@pytest.mark.parametrize(
    ("offset", "quality"), [(0.03, Quality.GOOD), (0.06, Quality.FAIR), (0.12, Quality.DISTURBED)]
)
def test_an_offset_decides(offset: float, quality: Quality) -> None:
    found = magnetic_field_quality(directions(2000) + np.array([offset, 0, 0]) + noise(2000, 0.002))
    assert found.quality == quality
    assert found.verdict.startswith(f"{quality.value}: the norm deviates by ")
    assert ("after a correction" in found.verdict) == (quality != Quality.GOOD)
    # Of a shift by h, the RMS deviation of the norm is h / sqrt(3).
    assert found.before == pytest.approx(offset / np.sqrt(3), rel=0.1)
    assert found.after == pytest.approx(0.002, rel=0.1)


def test_a_field_that_changes_from_place_to_place() -> None:
    field = directions(2000) * np.random.default_rng(2).uniform(0.87, 1.13, (2000, 1))
    found = magnetic_field_quality(field)
    assert found.quality == Quality.DISTURBED
    assert found.verdict.endswith(
        "also after a correction, so the field is not the same everywhere"
    )


def test_the_norm() -> None:
    field = directions(1000)
    field[:100] *= 1.2
    norm = magnetic_field_quality(field).norm
    assert (norm.mean, norm.min, norm.max) == pytest.approx((1.02, 1, 1.2))
    assert norm.std == pytest.approx(0.06)
    assert (norm.within_5, norm.within_10) == (0.9, 0.9)


def turned_about(axis: Array, height: float, rows: int = 2000) -> Array:
    """Returns the directions during turns about an axis."""
    angle = np.linspace(0, 20, rows)
    first = np.cross(axis, [1, 0, 0])
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    width = np.sqrt(1 - height**2)
    circle = np.outer(np.cos(angle), first) + np.outer(np.sin(angle), second)
    return np.asarray(width * circle + height * axis)


@pytest.mark.parametrize("deviation", [0, 0.002, 0.01])
@pytest.mark.parametrize("height", [0, 0.4, 0.9])
@pytest.mark.parametrize("axis", [(0, 0, 1), (0, 0.6, 0.8)])
def test_turns_about_one_axis(axis: Any, height: float, deviation: float) -> None:
    field = turned_about(np.array(axis, float), height) + noise(2000, deviation)
    assert "turned" in refused(field)


@pytest.mark.parametrize("offset", [1, 3, 8])
def test_a_magnet_that_is_stronger_than_the_field(offset: float) -> None:
    hard = offset * np.array([0.6, 0, -0.8])
    found = magnetic_field_quality(directions(2000) + hard + noise(2000, 0.01))
    assert found.quality == Quality.DISTURBED
    assert found.ellipsoid is not None
    np.testing.assert_allclose(found.ellipsoid.center, hard, atol=0.01)


@pytest.mark.parametrize("deviation", [0, 0.002, 0.01])
def test_a_device_at_rest(deviation: float) -> None:
    field = np.tile([0.3, 0.1, 0.9], (2000, 1)) + noise(2000, deviation)
    assert refused(field) == "the device was hardly turned"
    assert refused(0 * field) == "the device was hardly turned"


@pytest.mark.parametrize("lowest", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("deviation", [0.002, 0.01])
def test_a_part_of_the_directions(lowest: float, deviation: float) -> None:
    seen = directions(6000)
    seen = seen[seen[:, 1] > lowest]
    refused(seen + noise(len(seen), deviation))


def test_other_surfaces() -> None:
    cube = np.random.default_rng(3).uniform(-1, 1, (3000, 3))
    two = np.concatenate([directions(1000), directions(1000, 7) + np.array([1.5, 0, 0])])
    reason = "the values are on no ellipsoid, so the field is not the same everywhere"
    for field in (cube, two):
        found = magnetic_field_quality(field)
        assert found.quality == Quality.DISTURBED
        assert re.fullmatch(rf"disturbed: the norm deviates by \d\d %, and {reason}", found.verdict)
        assert found.coverage is not None
        assert found.coverage > 0.9
        assert (found.ellipsoid, found.before, found.after) == (None, None, None)
    # Seen from far away, the same is in few directions.
    assert refused(cube + np.array([0, 0, 2])) == reason


def test_few_rows_and_no_number() -> None:
    assert refused(np.empty((0, 3))) == "the recording has only 0 rows"
    assert refused(directions(99)) == "the recording has only 99 rows"
    bad = np.full((500, 3), np.nan)
    bad[100:200], bad[200:300, 1] = np.inf, 1e300
    found = magnetic_field_quality(bad)
    assert (found.rows, found.missing) == (0, 500)
    assert np.isnan(found.norm.mean)
    # The rest is judged.
    found = magnetic_field_quality(np.concatenate([bad, directions(500)]))
    assert (found.rows, found.missing, found.quality) == (500, 500, Quality.GOOD)
    with pytest.raises(ValueError, match=r"\(N, 3\), not \(9,\)"):
        magnetic_field_quality(np.zeros(9))


@settings(max_examples=10, deadline=None)
@given(st.lists(st.integers(0, 20_000), max_size=5))
def test_parts_are_the_whole(cuts: list[int]) -> None:
    field = np.float32(directions(20_000) + np.array([0.1, 0.2, 0.3]))
    rows = FieldRows()
    for part in np.split(field, sorted(cuts)):
        rows.add(part)
    found, whole = rows.quality(), magnetic_field_quality(field)
    np.testing.assert_array_equal(found.points, whole.points)
    assert FieldRows.MAX_POINTS / 2 <= len(found.points) <= FieldRows.MAX_POINTS
    assert found.verdict == whole.verdict
    assert vars(found.norm) == pytest.approx(vars(whole.norm))


@settings(max_examples=50, deadline=None)
@given(arrays(np.float32, st.tuples(st.integers(0, 120), st.just(3)), elements=st.floats(width=32)))
def test_any_numbers_get_a_verdict(values: Array) -> None:
    found = magnetic_field_quality(values)
    assert found.rows + found.missing == len(values)
    assert found.verdict.startswith(found.quality.value)
