"""Spectra of a report: the values are those of scipy, whatever the parts."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from xbus.report.spectrum import COLUMNS, ROWS, Spectrum

signal = pytest.importorskip("scipy.signal")

RATE = 400.0


def noise(rows: int, seed: int = 1) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Returns times at 400 Hz, and three axes of noise with 50 Hz in it."""
    time = np.arange(rows) / RATE
    values = np.random.default_rng(seed).normal(size=(rows, 3))
    return time, values + np.sin(2 * np.pi * 50 * time)[:, None]


def spectrum_of(
    time: npt.NDArray[np.float64],
    values: npt.NDArray[np.float64],
    cuts: list[int] | None = None,
    gaps: tuple[int, ...] = (),
) -> Spectrum:
    spectrum = Spectrum()
    breaks = np.zeros(len(time), bool)
    breaks[list(gaps)] = True
    for part in np.split(np.arange(len(time)), cuts or []):
        spectrum.add(time[part], values[part], breaks[part])
    return spectrum


def test_the_density_is_that_of_scipy() -> None:
    time, values = noise(20_000)
    spectrum = spectrum_of(time, values)
    frequency, density = spectrum.density()
    theirs, expected = signal.welch(values, fs=RATE, nperseg=1024, axis=0)
    assert spectrum.size == 1024
    assert frequency == pytest.approx(theirs[1:])
    assert density == pytest.approx(expected[1:])


def test_the_spectrogram_adds_up_to_the_density() -> None:
    time, values = noise(60_000)
    spectrum = spectrum_of(time, values)
    edges, frequency, density = spectrum.over_time()
    assert density.shape == (len(frequency), len(edges) - 1)
    assert len(frequency) == ROWS
    assert np.diff(edges) == pytest.approx(2)
    assert np.nanmean(density) == pytest.approx(spectrum.density()[1].sum(axis=1).mean(), rel=0.02)
    # Each of the rows has two frequencies.
    assert float(frequency[np.nanmean(density, axis=1).argmax()]) == pytest.approx(50, abs=0.8)


ROWS_OF_5000 = st.integers(1, 4999)


@settings(max_examples=30)
@given(*(st.lists(ROWS_OF_5000, max_size=size) for size in (6, 3, 2)))
def test_parts_do_not_matter(cuts: list[int], gaps: list[int], missing: list[int]) -> None:
    time, values = noise(5000)
    values[missing] = np.nan
    whole = spectrum_of(time, values, gaps=tuple(gaps))
    parts = spectrum_of(time, values, sorted(cuts), tuple(gaps))
    assert (parts.size, parts.segments) == (whole.size, whole.segments)
    if whole.segments:
        np.testing.assert_allclose(parts.density()[1], whole.density()[1])
        np.testing.assert_allclose(parts.over_time()[2], whole.over_time()[2])


def test_no_segment_crosses_a_gap() -> None:
    time, values = noise(1024 + 1023)
    assert spectrum_of(time, values, gaps=(1024,)).segments == 1
    values[1500] = np.nan
    assert spectrum_of(time, values, gaps=(1024,)).segments == 1
    values[1000] = np.inf
    assert spectrum_of(time, values).segments == 0
    assert spectrum_of(time, values).density()[0].tolist() == []


def test_a_gap_is_visible_in_the_spectrogram() -> None:
    time, values = noise(8000)
    time[4000:] += 20
    _, _, density = spectrum_of(time, values, gaps=(4000,)).over_time()
    empty = np.isnan(density[0])
    assert not empty[[0, -1]].any()
    assert 9 <= np.count_nonzero(empty) <= 11


def test_segments_of_another_rate_are_left_out() -> None:
    time, values = noise(6000)
    time[3000:] = time[3000] + np.arange(3000) / 100
    spectrum = spectrum_of(time, values, gaps=(3000,))
    assert (spectrum.segments, spectrum.left_out) == (4, 4)
    assert spectrum.rate == pytest.approx(RATE)


def test_long_recordings_are_bounded() -> None:
    spectrum = Spectrum()
    for minute in range(40):
        time, values = noise(24_000, minute)
        spectrum.add(time + 60 * minute, values, np.zeros(24_000, bool))
    edges, frequency, density = spectrum.over_time()
    assert (len(edges) - 1) <= COLUMNS
    assert len(frequency) <= ROWS
    assert edges[-1] == pytest.approx(2400, abs=np.diff(edges)[0])
    assert np.isfinite(density).all()


def test_gaps_everywhere() -> None:
    time, values = noise(100_000)
    values[::2] = np.nan
    assert spectrum_of(time, values, [50_000]).segments == 0


def test_too_few_rows() -> None:
    assert spectrum_of(*noise(63)).segments == 0
    assert spectrum_of(np.zeros(500), np.zeros((500, 3))).segments == 0
