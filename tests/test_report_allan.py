"""The Allan deviation against allantools, and the values that are read from its curve."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xbus.report.allan import Longest, Stretch, allan_deviation, at_one_second, flicker_floor


def noise(kind: str, rows: int) -> npt.NDArray[np.float64]:
    white = np.random.default_rng(7).normal(size=rows)
    return {"white": white, "walk": np.cumsum(white), "offset": 9.81 + 1e-3 * white}[kind]


@pytest.mark.parametrize("rate", [0.5, 100.0, 400.0, 2000.0])
@pytest.mark.parametrize("kind", ["white", "walk", "offset"])
def test_against_allantools(kind: str, rate: float) -> None:
    allantools = pytest.importorskip("allantools")  # late: it imports much of scipy
    rows = noise(kind, 20_000)
    tau, deviation = allan_deviation(rows, rate)
    theirs = allantools.oadev(rows, rate=rate, data_type="freq", taus=tau)
    np.testing.assert_allclose(tau, theirs[0], rtol=1e-12)
    np.testing.assert_allclose(deviation, theirs[1], rtol=1e-9)


def test_times_are_spaced_evenly_up_to_a_ninth() -> None:
    tau, _ = allan_deviation(noise("white", 9000), 10)
    assert (tau[0], tau[-1]) == (0.1, 100)
    assert np.all(np.diff(tau) > 0)
    late = tau[tau > 2]
    assert np.diff(np.log10(late)) == pytest.approx(0.1, abs=0.03)


@pytest.mark.parametrize("sizes", [[0], [51], [-1, 3]])
def test_sizes_that_do_not_fit(sizes: list[int]) -> None:
    with pytest.raises(ValueError, match="1 to half of the 100 rows"):
        allan_deviation(np.zeros(100), 1, sizes)
    assert len(allan_deviation(np.zeros(100), 1, [1, 50])[0]) == 2


def test_no_rate() -> None:
    with pytest.raises(ValueError, match="rate must be positive"):
        allan_deviation(np.zeros(100), 0)


@pytest.mark.parametrize("rows", [0, 1, 8])
def test_too_few_rows(rows: int) -> None:
    assert [len(item) for item in allan_deviation(np.zeros(rows), 1)] == [0, 0]


# Values read from the curve


@pytest.mark.parametrize("rate", [50, 400, 2000])
def test_random_walk_of_white_noise(rate: int) -> None:
    """A density of 0.01 per root Hz is a random walk of 0.01 per root second."""
    rows = 0.01 * np.sqrt(rate) * noise("white", 300 * rate)
    read = at_one_second(*allan_deviation(rows, rate))
    assert read is not None
    value, slope = read
    assert value == pytest.approx(0.01, rel=0.1)
    assert slope == pytest.approx(-0.5, abs=0.1)


def test_a_second_out_of_reach() -> None:
    assert at_one_second(*allan_deviation(noise("white", 500), 100)) is None
    assert at_one_second(*allan_deviation(noise("white", 500), 0.5)) is None
    assert at_one_second(*allan_deviation(np.ones(5000), 100)) is None


def test_a_falling_deviation_has_no_floor() -> None:
    assert not flicker_floor(np.array([1.0, 2]), np.array([2.0, 1])).is_reached


# The longest stretch


@given(st.integers(1, 600), st.sets(st.integers(1, 599)), st.lists(st.integers(0, 600), max_size=5))
def test_the_longest_stretch(rows: int, gaps: set[int], cuts: list[int]) -> None:
    time, values = np.arange(rows) / 8, np.random.default_rng(3).normal(size=(rows, 2))
    breaks = np.zeros(rows, bool)
    breaks[[gap for gap in gaps if gap < rows]] = True
    longest = Longest(2)
    edges = [0, *sorted(cut for cut in cuts if cut < rows), rows]
    for start, end in pairwise(edges):
        longest.add(time[start:end], values[start:end], breaks[start:end])
    pieces = np.split(np.arange(rows), np.flatnonzero(breaks))
    best = max(pieces, key=len)
    assert longest.stretches == len(pieces)
    if len(best) > 1:
        assert longest.best.start == time[best[0]]
        assert longest.best.values.tolist() == values[best].tolist()
        assert longest.best.rate == 8


@pytest.mark.parametrize("cut", [0, 50, 51, 52, 53, 100])
def test_a_nan_ends_a_stretch(cut: int) -> None:
    time, values = np.arange(100.0), np.ones((100, 1))
    values[[51, 52]] = np.nan
    longest = Longest(1)
    for part in (slice(0, cut), slice(cut, None)):
        longest.add(time[part], values[part], np.zeros(len(time[part]), bool))
    assert (longest.best.start, longest.best.end, longest.best.rows) == (0, 50, 51)
    assert longest.stretches == 2


@given(st.lists(st.integers(1, 300), min_size=1, max_size=12), st.integers(4, 64))
def test_a_long_stretch_is_averaged(parts: list[int], most: int) -> None:
    """A long stretch holds means of equal numbers of rows, which have the deviation of longer times."""
    rows = np.random.default_rng(9).normal(size=(sum(parts), 1))
    stretch = Stretch(1)
    stretch.MAX_ROWS = most
    at = 0
    for size in parts:
        stretch.add(np.arange(at, at + size) / 4, rows[at : at + size])
        at += size
    assert len(stretch.values) <= most
    assert len(stretch.values) > most // 4 or stretch.size == 1
    whole = len(stretch.values) * stretch.size
    assert at - whole < 2 * stretch.size
    means = rows[:whole].reshape(-1, stretch.size).mean(axis=1)
    np.testing.assert_allclose(stretch.values[:, 0], means, rtol=1e-9, atol=1e-12)
    assert (stretch.rows, stretch.end) == (at, (at - 1) / 4)
    if at > 1:
        assert stretch.rate == pytest.approx(4 / stretch.size)
