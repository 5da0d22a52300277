"""Curves of recent samples: few points, every extreme, every gap."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from xbus.studio.curves import thin
from xbus.studio.history import SPAN, History, Series


def plain_columns(time: Any, values: Any, step: Any) -> Any:
    """The rows of each column of pixels, one after the other."""
    columns: dict[int, list[Any]] = {}
    for row, at in enumerate(time):
        columns.setdefault(math.floor(at / step), []).append(values[row])
    return list(columns.values())


@given(
    hnp.arrays(np.float64, st.integers(30, 300), elements=st.floats(0.01, 1.0)),
    st.floats(5.0, 50.0),
    st.integers(1, 3),
    st.randoms(use_true_random=False),
)
def test_a_curve_has_the_first_the_extremes_and_the_last_of_each_column(
    periods: Any, step: Any, fields: Any, random: Any
) -> None:
    time = np.cumsum(np.sort(periods)[::-1])  # a gap has no place here: periods fall slowly
    values = np.array([[random.uniform(-1, 1) for _ in range(fields)] for _ in time], np.float64)
    curve = thin(time, values, step)
    points = curve.values[:, ~np.isnan(curve.values[0])]
    columns = plain_columns(time, values, step)
    if len(time) <= 4 * (time[-1] - time[0]) / step:
        assert np.array_equal(points.T, values)
        return
    assert points.shape == (fields, 4 * len(columns))
    for place, rows in enumerate(columns):
        for field in range(fields):
            numbers = [row[field] for row in rows]
            drawn = points[field, 4 * place : 4 * place + 4].tolist()
            low, high = min(numbers), max(numbers)
            in_order = [low, high] if numbers.index(low) <= numbers.index(high) else [high, low]
            assert drawn == [numbers[0], *in_order, numbers[-1]]
    assert (np.diff(curve.time) >= 0).all()


@pytest.mark.parametrize("step", [0.001, 0.5, 3.0])
def test_a_gap_is_a_point_without_a_number(step: Any) -> None:
    time = np.concatenate([np.arange(0, 10, 0.1), np.arange(20, 30, 0.1)])
    curve = thin(time, np.ones((200, 2), np.float64), step)
    gap = np.isnan(curve.values)
    assert gap.sum(axis=1).tolist() == [1, 1]
    assert curve.time[gap[0]] == [20]


def test_a_gap_is_seen_across_two_messages() -> None:
    time = np.concatenate([np.arange(0, 10, 0.1), [20.0, 20.1]])
    curve = thin(time, np.ones((102, 1), np.float64), 0.5, skip=100)
    assert np.isnan(curve.values[0]).tolist() == [True, False, False]


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_few_rows(rows: Any) -> None:
    curve = thin(np.arange(float(rows)), np.zeros((rows, 1), np.float64), 10.0)
    assert curve.time.tolist() == list(range(rows))


def test_a_series_keeps_the_last_minutes() -> None:
    series = Series("acceleration", "m/s2", ("x", "y", "z"), rows=5000)
    for begin in range(0, 1000, 2):
        time = begin + np.arange(0, 2, 0.01)
        series.add(time, np.repeat(time[:, None], 3, axis=1).astype(np.float64))
    assert len(series.time) == 5000
    assert series.time[-1] == pytest.approx(999.99)
    assert np.array_equal(series.values[:, 2], series.time.astype(np.float64))
    slow = Series("temperature", "degC", ("temperature",))
    for at in range(1000):
        slow.add(np.array([float(at)]), np.zeros((1, 1), np.float64))
    assert slow.time[0] == 999 - SPAN


def test_rows_that_go_back_or_have_no_time_are_left_out() -> None:
    series = Series("acceleration", "m/s2", ("x",))
    series.add(np.array([1.0, 2.0, 1.5, np.nan, 3.0]), np.arange(5, dtype=np.float64)[:, None])
    series.add(np.array([2.5, 3.0, 4.0]), np.array([[5], [6], [7]], np.float64))
    assert series.time.tolist() == [1, 2, 3, 4]
    assert series.values.ravel().tolist() == [0, 1, 4, 7]


def test_numbers_keep_their_digits() -> None:
    """The seventh decimal of a latitude is a centimetre."""
    history = History()
    series = Series("lat_lon", "deg", ("lat", "lon"))
    history.add_rows(series, np.array([1.0]), np.array([[52.2407219, 6.8370321]]))
    curve = history.curve("lat_lon", 0.0, 2.0, 0.1)
    assert curve is not None
    assert curve.values.ravel().tolist() == [52.2407219, 6.8370321]


def test_a_column_is_sent_when_it_is_complete() -> None:
    series = Series("acceleration", "m/s2", ("x",))
    assert series.end_of_columns(0.5) == -np.inf
    series.add(np.arange(0, 1.23, 0.01), np.zeros((123, 1), np.float64))
    assert series.end_of_columns(0.5) == 1.0
    # Columns that are narrower than a period are complete with their row.
    assert series.end_of_columns(0.001) == pytest.approx(1.22)
