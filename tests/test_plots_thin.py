"""Curves in few points: which points are kept, and where a line ends."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xbus.plots.thin import BINS, Bands, Curve, Curves, FloatArray, Steps, thin

SEEDS = st.integers(0, 2**32 - 1)


def walk(seed: int, rows: int) -> tuple[FloatArray, FloatArray]:
    """Returns ascending times and values, some of them equal."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.choice([0, 1, 1, 1, 40], rows)) / 1024
    values: FloatArray = np.cumsum(rng.integers(-9, 10, rows)) / 8
    return time, values


def extremes(time: FloatArray, values: FloatArray, width: float) -> list[tuple[int, float, float]]:
    """Returns the number, minimum and maximum of each bin, computed in the plain way."""
    found: dict[int, list[float]] = {}
    for at, value in zip(np.floor(time / width).astype(int).tolist(), values.tolist(), strict=True):
        found.setdefault(at, []).append(value)
    return [(at, min(those), max(those)) for at, those in found.items()]


def fill(curves: Curves, time: FloatArray, values: FloatArray, cuts: list[int]) -> Curve:
    """Returns the one curve of rows that arrive in pieces."""
    edges = [0, *sorted(cuts), len(time)]
    for start, end in pairwise(edges):
        part = slice(start, end)
        curves.add(time[part], values[part, None], np.zeros(end - start, bool))
    return curves.curves[0]


# Points


@given(SEEDS, st.integers(1, 3000), st.sampled_from((2**-10, 2**-6, 0.25, 4.0)))
def test_the_extremes_of_every_bin_are_kept(seed: int, rows: int, width: float) -> None:
    time, values = walk(seed, rows)
    kept = thin(time, values, width)
    assert np.all(np.diff(kept) > 0)
    assert extremes(time[kept], values[kept], width) == extremes(time, values, width)
    bins = len(set(np.floor(time / width)))
    assert len(kept) <= 2 * bins


def test_an_empty_curve_stays_empty() -> None:
    assert len(thin(np.empty(0), np.empty(0), 1.0)) == 0


@given(SEEDS, st.lists(st.integers(0, 20_000), max_size=6))
def test_parts_give_the_same_extremes_as_the_whole(seed: int, cuts: list[int]) -> None:
    """For any cuts of a log, each bin keeps its extremes and time is in order."""
    time, values = walk(seed, 20_000)
    whole = Curves(("x",))
    curve = fill(whole, time, values, cuts)
    assert whole.width > 0
    assert np.all(np.diff(curve.time) >= 0)
    assert len(curve.time) <= 2 * BINS
    assert extremes(curve.time, curve.values, whole.width) == extremes(time, values, whole.width)
    # Bins are no wider than they must be.
    assert (time[-1] - time[0]) / whole.width > BINS / 2 - 2


def test_few_points_stay_as_they_are() -> None:
    time, values = walk(1, 2 * BINS)
    curve = fill(Curves(("x",)), time, values, [100])
    assert curve.time.tolist() == time.tolist()
    assert curve.values.tolist() == values.tolist()


def test_one_spike_in_an_hour_at_2_khz() -> None:
    rows = 7_200_000
    values = np.random.default_rng(1).normal(size=rows).astype(np.float32)
    values[4_321_987] = 99.5
    curves = Curves(("x",))
    for start in range(0, rows, 600_000):
        part = slice(start, start + 600_000)
        time = np.arange(part.start, part.stop) / 2000
        curves.add(time, values[part, None], np.zeros(600_000, bool))
    (curve,) = curves.curves
    at = int(np.argmax(curve.values))
    assert (curve.time[at], curve.values[at]) == (4_321_987 / 2000, 99.5)
    assert len(curve.time) <= 2 * BINS
    assert curves.maximum[0] == 99.5


def test_times_out_of_order_are_put_in_order() -> None:
    curves = Curves(("x",))
    curves.add(np.array([0.0, 3, 1]), np.array([[0.0], [3], [1]]), np.zeros(3, bool))
    curves.add(np.array([2.0]), np.array([[2.0]]), np.zeros(1, bool))
    assert curves.curves[0].values.tolist() == [0, 1, 2, 3]


def test_figures_of_all_rows() -> None:
    time, values = walk(5, 30_000)
    curves = Curves(("x",))
    fill(curves, time, 1e9 + values, [7, 11_000, 29_999])
    assert curves.mean[0] - 1e9 == pytest.approx(values.mean(), abs=1e-5)
    assert curves.deviation[0] == pytest.approx(values.std(), rel=1e-9)
    assert (curves.minimum[0] - 1e9, curves.maximum[0] - 1e9) == pytest.approx(
        (values.min(), values.max())
    )


# Gaps


def drawn_across(curve: Curve, gap: float) -> bool:
    """Returns whether a line crosses a moment."""
    time, values = curve.line()
    joined = np.isfinite(values[1:]) & np.isfinite(values[:-1])
    return bool(np.any(joined & (time[:-1] < gap) & (time[1:] > gap)))


@given(SEEDS, st.sets(st.integers(1, 9_999), max_size=40), st.integers(0, 10_000))
def test_no_line_crosses_a_gap(seed: int, gaps: set[int], cut: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.arange(10_000) / 100
    breaks = np.zeros(10_000, bool)
    breaks[list(gaps)] = True
    curves = Curves(("x",))
    values = rng.normal(size=(10_000, 1))
    for part in (slice(0, cut), slice(cut, None)):
        curves.add(time[part], values[part], breaks[part])
    (curve,) = curves.curves
    assert curves.width > 0
    for row in gaps:
        assert not drawn_across(curve, float(time[row]) - 0.005)
    lines = np.diff(curve.piece) == 0
    assert drawn_across(curve, 50.0001) or not lines[np.searchsorted(curve.time, 50.0001) - 1]


def test_a_nan_is_a_gap() -> None:
    values = np.array([[1.0, 1], [2, 2], [np.nan, 3], [4, np.inf], [5, 5]])
    curves = Curves(("x", "y"))
    curves.add(np.arange(5.0), values, np.zeros(5, bool))
    curves.add(np.arange(5.0, 7), np.array([[6.0, 6], [7, 7]]), np.zeros(2, bool))
    x, y = curves.curves
    np.testing.assert_array_equal(x.line()[1], [1, 2, np.nan, 4, 5, 6, 7])
    np.testing.assert_array_equal(y.line()[1], [1, 2, 3, np.nan, 5, 6, 7])
    assert curves.missing == 2
    assert curves.count.tolist() == [6, 6]
    assert curves.maximum.tolist() == [7, 7]


def test_a_column_of_nan_is_empty() -> None:
    curves = Curves(("x",))
    curves.add(np.arange(3.0), np.full((3, 1), np.nan), np.zeros(3, bool))
    assert (len(curves.curves[0].time), curves.missing) == (0, 3)
    assert len(curves.curves[0].isolated()) == 0


def test_isolated_points_are_found() -> None:
    curves = Curves(("x",))
    curves.add(np.arange(5.0), np.arange(5.0)[:, None], np.array([0, 1, 1, 0, 1], bool))
    assert curves.curves[0].isolated().tolist() == [0, 1, 4]


# Steps


def test_regular_rows_have_no_gap() -> None:
    steps = Steps()
    ticks = np.round(np.arange(16_000) / 1600, 4)  # 1,600 Hz on a clock of 0.1 ms
    for part in np.array_split(ticks, 7):
        assert not steps.breaks(part).any()
    assert (steps.gaps, steps.irregular, steps.rows) == (0, 0, 16_000)


@pytest.mark.parametrize("cuts", [[], [500], [499, 501], [3, 502, 900]])
def test_a_lost_row_is_a_gap(cuts: list[int]) -> None:
    time = np.delete(np.arange(1000) / 100, 500)
    steps = Steps()
    parts = np.split(time, cuts)
    breaks = np.concatenate([steps.breaks(part) for part in parts])
    assert np.flatnonzero(breaks).tolist() == [500]
    assert steps.gaps == 1


def test_a_change_of_rate_is_not_a_gap() -> None:
    time = np.concatenate((np.arange(1000) / 100, 10 + np.arange(1000) / 25))
    steps = Steps()
    # Except for the block in which the rate changes.
    assert np.flatnonzero(steps.breaks(time)).max(initial=0) < 1024 + 256
    assert steps.usual == pytest.approx(0.04)


def test_time_that_goes_back_is_a_gap() -> None:
    time = np.concatenate((np.arange(100) / 100, np.arange(100) / 100))
    assert np.flatnonzero(Steps().breaks(time)).tolist() == [100]


def test_jitter_is_reported() -> None:
    time = np.arange(1000) / 100
    time[::2] += 0.002
    steps = Steps()
    assert not steps.breaks(time).any()
    # Steps of 8 and 12 ms alternate, so half of them are irregular.
    assert steps.irregular in (499, 500)


def test_rows_that_share_a_stamp() -> None:
    assert not Steps().breaks(np.repeat(np.arange(100.0), 4)).any()


# Bands


def test_bands_that_touch_are_one() -> None:
    bands = Bands()
    bands.add([0, 1], [1, 2], [5, 6])
    bands.add([2, 4], [3, 5], [7, 8])
    assert (bands.start.tolist(), bands.end.tolist()) == ([0, 4], [3, 5])
    assert bands.weight.tolist() == [18, 8]


def test_a_band_within_another_does_not_end_it() -> None:
    bands = Bands()
    bands.add([0, 1, 5], [9, 2, 6], [1, 1, 1])
    assert (bands.start.tolist(), bands.end.tolist()) == ([0], [9])


def test_the_number_of_bands_is_bounded() -> None:
    bands = Bands()
    start = np.arange(100_000) / 10
    for part in np.array_split(start, 10):
        bands.add(part, part + 0.01, np.ones(len(part)))
    assert 1 <= len(bands) <= BINS
    assert bands.weight.sum() == 100_000
    assert (bands.start[0], bands.end[-1]) == (0, start[-1] + 0.01)
    assert np.all(bands.start[1:] > bands.end[:-1])
