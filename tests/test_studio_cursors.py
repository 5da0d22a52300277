"""Cursors in the plots of the studio, and the statistics of the samples between them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import xbus
from xbus.protocol.tables import QUANTITIES
from xbus.studio.cursors import SHORTEST, Cursors
from xbus.studio.curves import thin_path
from xbus.studio.gaps import GAP, NEAR, find_gaps, lost_time
from xbus.studio.history import History, Series
from xbus.studio.statistics import difference, statistics_of
from xbus.studio.track import Track
from xbus.watch.model import Model

#: Numbers of which some are not finite.
NUMBERS = st.floats(-1e3, 1e3, width=32) | st.sampled_from([math.nan, math.inf, -math.inf])


def column_of_numpy(time: Any, column: Any) -> list[float]:
    """The statistics of one component by functions of numpy."""
    finite = np.isfinite(column)
    time, column = time[finite], column[finite]
    if not len(column):
        return [0] + [math.nan] * 6
    slope = 60 * np.polyfit(time - time[0], column, 1)[0] if len(column) > 1 else math.nan
    spread = np.ptp(column)
    return [len(column), np.mean(column), np.std(column), min(column), max(column), spread, slope]


@settings(max_examples=50)
@given(hnp.arrays(np.float64, st.tuples(st.integers(0, 40), st.integers(1, 4)), elements=NUMBERS))
def test_statistics_are_those_of_numpy(values: Any) -> None:
    time = np.array([1.8e9 + 0.01 * at**1.5 for at in range(len(values))])
    found = statistics_of(time, np.asarray(values, np.float64))
    expected = np.array([column_of_numpy(time, column) for column in values.T]).T
    for name, got, want in zip(found._fields, found, expected, strict=True):
        atol = 1e-3 if name == "slope" else 1e-9
        np.testing.assert_allclose(got, want, rtol=1e-6, atol=atol, err_msg=name)


def test_an_angle_that_jumps_by_a_turn_has_no_jump() -> None:
    """A device that turns by 1 degree per second, past 180 degrees, with a value that is missing."""
    time = 1.8e9 + np.arange(20.0)
    yaw = 170.0 + np.arange(20.0)
    jumping = (yaw + 180) % 360 - 180
    jumping[5] = np.nan
    found = statistics_of(time, jumping[:, None], wraps=True)
    assert found.number.tolist() == [19]
    assert (found.minimum.tolist(), found.maximum.tolist()) == ([170], [189])
    assert found.slope[0] == pytest.approx(60)
    assert found.mean[0] == pytest.approx((yaw.sum() - 175) / 19)
    assert difference(jumping[:1], jumping[-1:], wraps=True).tolist() == [19]
    assert difference(jumping[:1], jumping[-1:]).tolist() == [-341]


def plain_gaps(time: Any) -> list[tuple[int, float]]:
    """The row after each gap, and the usual period there, by the definition."""
    periods = np.diff(time).tolist()
    found = []
    for at, period in enumerate(periods):
        sides = periods[max(at - NEAR, 0) : at], periods[at + 1 : at + 1 + NEAR]
        medians = [float(np.median(side)) for side in sides if side]
        if medians and period > GAP * max(medians):
            found.append((at + 1, max(medians)))
    return found


@settings(max_examples=50)
@given(st.lists(st.sampled_from([0.0005, 0.01, 0.011, 0.25, 1.0, 7.0]), max_size=60))
def test_gaps_are_those_of_the_definition(periods: Any) -> None:
    time = 1000.0 + np.cumsum([0.0, *periods])
    found = find_gaps(time)
    assert [*zip(found.rows.tolist(), found.usual.tolist(), strict=True)] == plain_gaps(time)


@settings(max_examples=50)
@given(
    st.lists(st.sampled_from([0.01, 0.011, 0.25, 7.0]), min_size=2, max_size=60),
    st.floats(-1, 12),
    st.floats(0, 20),
)
def test_lost_time_is_that_of_the_gaps(periods: Any, begin: Any, length: Any) -> None:
    time, end = np.cumsum([0.0, *periods]), begin + length
    expected = 0.0
    for row, usual in plain_gaps(time):
        expected += max(0.0, min(time[row], end) - max(time[row - 1] + usual, begin))
    last = float(np.median(periods[-NEAR:]))
    if end - time[-1] > GAP * last:
        expected += max(0.0, end - max(time[-1] + last, begin))
    assert lost_time(time, begin, end) == pytest.approx(expected)


def test_a_lower_rate_is_no_gap() -> None:
    time = np.concatenate([np.arange(0, 20, 0.01), np.arange(20, 40, 0.25)])
    assert find_gaps(time).rows.tolist() == []
    assert lost_time(np.delete(time, range(2010, 2020)), 0, 40) == pytest.approx(2.5)


def history_of(time: Any, values: Any, *, wraps: bool = False) -> History:
    history = History()
    fields = tuple("xyz"[: values.shape[1]])
    history.add_rows(Series("rate_of_turn", "rad/s", fields, wraps=wraps), time, values)
    return history


def selection(history: History, a: Any, b: Any) -> Any:
    return history.selection("rate_of_turn", a, b)


def test_a_selection_is_of_every_sample_between_the_cursors() -> None:
    time = 1.8e9 + np.arange(0, 60, 0.0005)
    values = np.random.default_rng(1).normal(5, 0.1, (len(time), 3))
    values[70_000, 1] = 100  # a spike of one sample
    history = history_of(time, values)
    a, b = float(time[100_000]), float(time[20_000]) + 0.0002  # B is before A
    found = selection(history, a, b)
    assert found.change is not None
    inside = values[20_001:100_001]
    assert found.statistics.number.tolist() == [len(inside)] * 3
    np.testing.assert_allclose(found.statistics.mean, inside.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(found.statistics.std, inside.std(axis=0), rtol=1e-12)
    assert found.statistics.maximum[1] == 100
    # At a cursor is the last sample at or before it, and not the nearest.
    assert found.a.values.tolist() == values[100_000].tolist()
    assert found.b.values.tolist() == values[20_000].tolist()
    assert found.change.tolist() == (values[20_000] - values[100_000]).tolist()
    assert found.lost == 0
    assert not found.a.is_old


def test_an_empty_selection() -> None:
    time = np.concatenate([np.arange(0, 10, 0.1), np.arange(20, 30, 0.1)])
    history = history_of(time, np.ones((200, 1)))
    found = selection(history, 12.0, 15.0)
    assert found.statistics.number.tolist() == [0]
    assert all(np.isnan(each).all() for each in found.statistics[1:])
    assert found.lost == pytest.approx(3)
    assert found.a.time == pytest.approx(9.9)
    assert (found.a.is_old, found.b.is_old) == (True, True)


def test_a_cursor_before_the_first_sample_or_without_the_other() -> None:
    history = history_of(np.arange(10.0), np.arange(10.0)[:, None])
    found = selection(history, -5.0, 4.5)
    assert (found.a, found.change, found.first) == (None, None, 0)
    assert found.statistics.number.tolist() == [5]
    alone = selection(history, None, 4.5)
    assert alone.b.values.tolist() == [4]
    assert (alone.a, alone.statistics, alone.lost) == (None, None, None)
    assert history.selection("acceleration", 1.0, 2.0) is None


def test_cursors_move_and_the_view_follows() -> None:
    view = Cursors(first=0, last=300, begin=290, end=300)
    view.move(1.0)  # no cursor is there yet
    assert view.times == {}
    view.choose("B")
    assert view.active == "B"
    assert view.times == {"B": pytest.approx(290 + 20 / 3)}
    view.choose("A", 292.0)
    for _ in range(10):
        view.move(-1.0)
    assert view.times["A"] == pytest.approx(282)
    assert [view.begin, view.end] == pytest.approx([282, 292])
    view.move(-1000.0)
    assert (view.times["A"], view.begin) == (0, 0)


@given(st.lists(st.sampled_from([0.5, 2.0, -0.3, 7.0, "A", "B"]), max_size=40))
def test_the_view_stays_inside_what_is_kept(steps: Any) -> None:
    view = Cursors(first=1.8e9, last=1.8e9 + 300, begin=1.8e9 + 290, end=1.8e9 + 300)
    for step in steps:
        if isinstance(step, str):
            view.choose("A" if step == "A" else "B")
        elif step in (0.5, 2.0):
            view.zoom(step)
        else:
            view.move(step)
        assert view.first <= view.begin < view.end <= view.last + 1e-6
        assert view.end - view.begin >= SHORTEST - 1e-6
        for time in view.times.values():
            assert view.first <= time <= view.last


def test_a_path_has_whole_rows_and_its_gaps() -> None:
    rng = np.random.default_rng(2)
    time = np.arange(0, 60, 0.01)
    values = np.cumsum(rng.normal(0, 1, (len(time), 2)), axis=0)
    values[3000:3100] = np.nan  # no fix
    kept = np.delete(np.arange(len(time)), range(4000, 4500))
    time, values = time[kept], values[kept]
    path = thin_path(time, values, 0.5)
    assert len(path.time) < 800
    rows = {tuple(row) for row in values[np.isfinite(values[:, 0])].tolist()}
    drawn = path.values[:, np.isfinite(path.values[0])]
    assert {tuple(row) for row in drawn.T.tolist()} <= rows
    for axis in range(2):
        assert drawn[axis].min() == np.nanmin(values[:, axis])
        assert drawn[axis].max() == np.nanmax(values[:, axis])
    gaps = path.time[np.isnan(path.values[0])]
    assert gaps.tolist() == [time[3000], time[4000]]
    # In two messages, the second one knows whether the first ended with a number.
    second = thin_path(time[2990:], values[2990:], 0.5, skip=10)
    assert np.isnan(second.values[:, 0]).all()


def samples(*rows: dict[str, Any]) -> xbus.Log:
    counted = ({"packet_counter": at, **row} for at, row in enumerate(rows))
    return xbus.read_log(b"".join(xbus.encode_sample(row) for row in counted))


FIXED, LOST = 0b110, 0b010


def test_a_track_is_in_metres_and_has_no_line_without_a_fix() -> None:
    places = [(52.0, 6.0), (52.001, 6.0), (0.0, 0.0), (52.0, 6.001), (np.nan, 6.0)]
    words = [FIXED, FIXED, FIXED, LOST, FIXED]
    block = samples(
        *(
            {"status_word": word, "lat_lon": list(at)}
            for word, at in zip(words, places, strict=True)
        )
    )
    track = Track()
    sample, metres = track.add(block, ["status_word", "lat_lon"])
    assert sample.tolist() == [0, 1, 2, 3, 4]
    assert metres[0].tolist() == pytest.approx([0, 0], abs=1e-6)
    assert metres[1].tolist() == pytest.approx([0, 111.26], abs=0.2)
    assert np.isnan(metres[2:]).all()
    assert (track.source, track.quantity, track.is_fixed) == ("filter", "lat_lon", False)
    assert track.latest["lat"] == pytest.approx(52.001, abs=1e-4)


def test_the_positions_of_the_filter_are_preferred_while_they_come() -> None:
    pvt = {"fixtype": 3, "flags": 1, "lat": 520000000, "lon": 60000000}
    names = [field.name for field in QUANTITIES["gnss_pvt_data"].fields]
    receiver = samples({"gnss_pvt_data": dict.fromkeys(names, 0) | pvt})
    track = Track()
    # This block has none of the filter, but others have.
    assert len(track.add(receiver, ["gnss_pvt_data", "lat_lon"])[0]) == 0
    assert (track.source, track.latest) == ("filter", None)
    sample, metres = track.add(receiver, ["gnss_pvt_data"])
    assert (sample.tolist(), track.source) == ([0], "gnss")
    assert metres.tolist() == [pytest.approx([0, 0], abs=1e-6)]
    assert len(track.add(samples({"temperature": 20.0}), ["temperature"])[0]) == 0
    assert track.source is None
    assert track.latest["lat"] == 52


def test_a_sample_out_of_range_is_counted_also_in_the_middle_of_a_block() -> None:
    model = Model("port")
    words = [0, 1 << 8 | 1 << 19, 1 << 8 | 1 << 13 | 1 << 19, 0]
    model.add_block(samples(*({"status_word": word} for word in words)), now=5.0)
    model.add_block(samples({"status_word": 1 << 13}, {"status_word": 0}), now=6.0)
    assert model.clipped == {"acc x": (2, 5.0), "gyr z": (2, 6.0)}
    model.add_block(samples({"status_word": 1 << 19}), now=7.0)
    assert model.clipped["a sensor"] == (1, 7.0)
