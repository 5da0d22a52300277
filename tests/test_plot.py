"""`Log.plot` and `Column.plot`: what is drawn, by matplotlib and by plotly."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings

import xbus
from conftest import OWN_CAPTURES, counter, damaged_streams, fine
from streams import frame, mtdata2, packet, real
from xbus.export.palette import COLOURS
from xbus.plots.panels import has_panels
from xbus.plots.plot import Plot, TimeAxis
from xbus.plots.thin import BINS

matplotlib = pytest.importorskip("matplotlib")
pytest.importorskip("plotly")
matplotlib.use("agg")

WALK, FIELD = OWN_CAPTURES / "walk.mtb", OWN_CAPTURES / "field.mtb"
WAKE_UP = frame(0x3E)
UTC = np.datetime64("2026-11-22T09:30:00", "ns")


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    yield
    matplotlib.pyplot.close("all")


def sample(row: int, *more: bytes, start: float = 0, bid: int = 0xFF) -> bytes:
    """Returns a sample at 100 Hz of a clock that starts at ``start`` s, with its row as temperature."""
    ticks = round(10_000 * start) + 100 * row
    return mtdata2(counter(row), fine(ticks), temperature(row), *more, bid=bid)


def temperature(value: float) -> bytes:
    return real(0x0810, value)


def utc(second: int) -> bytes:
    """Returns valid UTC, this long after `UTC`."""
    payload = (0).to_bytes(4, "big") + (2026).to_bytes(2, "big") + bytes([11, 22, 9, 30, second, 7])
    return packet(0x1010, payload)


def log_of(*parts: bytes) -> xbus.Log:
    return xbus.read_log(b"".join(parts))


def lines(axes: Any) -> dict[str, tuple[npt.NDArray[Any], npt.NDArray[Any]]]:
    """Returns times and values of the lines of a plot, by label."""
    return {
        line.get_label(): (np.asarray(line.get_xdata()), np.asarray(line.get_ydata()))
        for line in axes.lines
    }


def line(axes: Any) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    (found,) = lines(axes).values()
    return found


def test_the_values_are_drawn_at_their_times() -> None:
    log = xbus.read_log(WALK)
    axes = log["acceleration"].plot()
    assert (axes.get_ylabel(), axes.get_xlabel()) == ("acceleration, m/s2", "device time, s")
    assert list(lines(axes)) == ["x", "y", "z"]
    for at, (time, values) in enumerate(lines(axes).values()):
        assert time == pytest.approx(log["acceleration"].time, abs=1e-9)
        assert values.tolist() == log["acceleration"].values[:, at].tolist()


@pytest.mark.parametrize(
    ("keys", "labels"),
    [
        ("temperature", ["temperature, degC"]),
        (["acceleration", "temperature"], ["acceleration, m/s2", "temperature, degC"]),
        ([("euler_angles", "ENU")], ["euler_angles, deg"]),
        (("euler_angles", "NED"), ["euler_angles NED, deg"]),
        ("lat_lon", ["lat_lon\nlatitude, deg", "lat_lon\nlongitude, deg"]),
        ("gps_dop", ["gps_dop"]),
        ("rotation_matrix", ["rotation_matrix"]),
    ],
)
def test_keys(keys: Any, labels: list[str]) -> None:
    log = log_of(
        WALK.read_bytes(),
        xbus.encode_sample({"rotation_matrix": range(9)}),
        xbus.encode_sample({("euler_angles", "NED"): range(3)}),
        mtdata2(packet(0x8830, bytes(18))),
    )
    axes = log.plot(keys)
    assert [one.get_ylabel() for one in np.atleast_1d(axes)] == labels
    assert (np.ndim(axes) == 0) == (len(labels) == 1)
    figure = log.plot(keys, backend="plotly")
    shown = [axis.title.text.replace("<br>", "\n") for axis in figure.select_yaxes()]
    assert shown == labels


def test_all_quantities_with_a_plot() -> None:
    labels = [axes.get_ylabel() for axes in xbus.read_log(WALK).plot()]
    assert "gnss_pvt_data\nheight, m" in labels
    assert not any("counter" in text or "status" in text for text in labels)


def test_the_norm_of_the_magnetic_field() -> None:
    log = xbus.read_log(WALK)
    _, norm = lines(log["magnetic_field"].plot())["norm"]
    assert norm == pytest.approx(np.linalg.norm(log["magnetic_field"].values, axis=1))


#: Samples, and the expected times and values of temperature.
DRAWN: dict[str, tuple[bytes, list[float], list[float]]] = {
    "a gap": (
        b"".join(sample(row) for row in (0, 1, 2, 6, 7)),
        [0, 0.01, 0.02, np.nan, 0.06, 0.07],
        [0, 1, 2, np.nan, 6, 7],
    ),
    "a restart": (
        b"".join(sample(row, start=5) for row in range(3))
        + WAKE_UP
        + b"".join(sample(row, start=1) for row in range(2)),
        [5, 5.01, 5.02, np.nan, 5.03, 5.04],
        [0, 1, 2, np.nan, 0, 1],
    ),
    "no time stamps": (
        b"".join(mtdata2(counter(row), temperature(row)) for row in (7, 8, 9, 12, 13)),
        [7, 8, 9, np.nan, 12, 13],
        [7, 8, 9, np.nan, 12, 13],
    ),
    "no counter": (
        b"".join(mtdata2(temperature(row)) for row in range(3)),
        [0, 1, 2],
        [0, 1, 2],
    ),
    "NaN": (
        b"".join(
            mtdata2(counter(row), fine(100 * row), temperature(np.nan if row == 2 else row))
            for row in range(5)
        ),
        [0, 0.01, np.nan, 0.03, 0.04],
        [0, 1, np.nan, 3, 4],
    ),
}


@pytest.mark.parametrize("name", DRAWN)
@pytest.mark.parametrize("backend", ["matplotlib", "plotly"])
def test_no_line_crosses(name: str, backend: Any) -> None:
    data, times, values = DRAWN[name]
    found = xbus.read_log(data)["temperature"].plot(backend=backend)
    x, y = line(found) if backend == "matplotlib" else (found.data[0].x, found.data[0].y)
    np.testing.assert_allclose(x, times, atol=1e-9)
    np.testing.assert_array_equal(y, values)


def test_a_point_without_neighbours_is_a_dot() -> None:
    x, y = line(log_of(sample(3))["temperature"].plot())
    assert (x.tolist(), y.tolist()) == ([0.03], [3])
    (trace,) = log_of(sample(3)).plot("temperature", backend="plotly").data
    assert trace.mode == "markers"


def test_each_device_has_curves() -> None:
    rows = [sample(row, start=50 * bid, bid=bid) for row in range(5) for bid in (1, 2)]
    found = lines(log_of(*rows)["temperature"].plot())
    assert list(found) == ["temperature, BID 1", "temperature, BID 2"]
    for time, values in found.values():
        assert time == pytest.approx(50 + np.arange(5) / 100)
        assert values.tolist() == list(range(5))


def test_a_spike_of_a_long_log_is_drawn() -> None:
    rows = [sample(row) for row in range(9000)]
    rows[2000] = mtdata2(counter(2000), fine(200_000), temperature(9999))
    data = b"".join(rows)
    x, y = line(log_of(data)["temperature"].plot())
    assert len(x) <= 2 * BINS
    assert (y.max(), x[np.argmax(y)]) == (9999, pytest.approx(20))


# UTC


def test_utc() -> None:
    rows = [
        sample(row, *([utc(row // 100)] if row % 100 == 0 else []), start=5) for row in range(300)
    ]
    x, _ = line(log_of(*rows)["temperature"].plot(time="utc"))
    expected = UTC + np.arange(300) * np.timedelta64(10, "ms")
    assert np.abs(x - expected).max() < np.timedelta64(1, "us")
    figure = log_of(*rows)["temperature"].plot(time="utc", backend="plotly")
    assert np.abs(figure.data[0].x.astype("datetime64[ns]") - expected).max() < np.timedelta64(
        1, "us"
    )
    assert figure.layout.xaxis.title.text == "UTC"


def test_utc_of_a_restarted_device_shows_the_interruption() -> None:
    rows = [sample(0, utc(0)), sample(1), WAKE_UP, sample(0, utc(30)), sample(1)]
    x, y = line(log_of(*rows)["temperature"].plot(time="utc"))
    np.testing.assert_array_equal(y, [0, 1, np.nan, 0, 1])
    np.testing.assert_array_equal(x[[0, 3]], [UTC, UTC + np.timedelta64(30, "s")])


def test_a_run_without_utc_is_left_out() -> None:
    rows = [sample(0, utc(0)), sample(1), WAKE_UP, *map(sample, range(3))]
    with pytest.warns(UserWarning, match=r"^3 samples of runs without valid UTC not plotted$"):
        _, y = line(log_of(*rows)["temperature"].plot(time="utc"))
    assert y.tolist() == [0, 1]


# Axes, backends and errors


def test_axes_are_accepted() -> None:
    log = xbus.read_log(WALK)
    _, axes = matplotlib.pyplot.subplots(2)
    assert log["temperature"].plot(ax=axes[1]) is axes[1]
    assert len(axes[1].lines) == 1
    assert log.plot(["temperature", "acceleration"], ax=axes) is axes
    assert (len(axes[0].lines), len(axes[1].lines)) == (1, 4)


#: Calls, and what their errors contain.
WRONG: list[tuple[Callable[[xbus.Log], Any], type[Exception], str]] = [
    (lambda log: log.plot("status_word"), ValueError, "draw one of its flags: column.flags"),
    (lambda log: log.plot("packet_counter"), ValueError, "packet_counter has no plot"),
    (lambda log: log.plot("no"), KeyError, "no 'no' in this log"),
    (lambda log: log.plot("temperature", time="gps"), ValueError, "'device' or 'utc'"),  # type: ignore[arg-type]
    (lambda log: log.plot("temperature", backend="R"), ValueError, "'matplotlib' or 'plotly'"),  # type: ignore[arg-type]
    (lambda log: log.plot(["temperature", "quaternion"], ax=1), ValueError, "2 plots, but 1 Axes"),
    (lambda log: log.plot("temperature", ax=1, backend="plotly"), ValueError, "for matplotlib"),
    (lambda log: xbus.read_log(b"").plot(), ValueError, "nothing to plot"),
    (lambda log: log_of(sample(1)).plot(time="utc"), ValueError, "no valid UTC"),
]


@pytest.mark.parametrize(("call", "error", "text"), WRONG)
def test_errors(call: Callable[[xbus.Log], Any], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        call(xbus.read_log(WALK))


@pytest.mark.parametrize(
    ("backend", "module", "extra"),
    [("matplotlib", "matplotlib.pyplot", "plot"), ("plotly", "plotly.subplots", "report")],
)
def test_a_missing_extra(
    backend: Any, module: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=rf'pip install "xbus-mti\[{extra}\]"$'):
        xbus.read_log(WALK).plot("temperature", backend=backend)


@settings(max_examples=25)
@given(damaged_streams())
def test_any_stream_can_be_plotted(data: bytes) -> None:
    log = xbus.read_log(data)
    drawn = {re.split("[\n, ]", plot.label)[0] for plot in plots_of(log)}
    assert drawn == {column.name for column in log.values() if has_panels(column.name)}


def plots_of(log: xbus.Log) -> list[Plot]:
    """Returns the plots of a log, without drawing them, which is slow."""
    found: list[Plot] = []

    def draw(plots: list[Plot], axis: TimeAxis, **_: Any) -> None:
        found.extend(plots)
        for line in (line for plot in plots for line in plot.lines(axis)):
            assert len(line.time) == len(line.values)
            assert np.all(np.diff(line.time[np.isfinite(line.time)]) >= 0)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("xbus.log.plotting.draw", draw)
        with suppress(ValueError):  # nothing to plot
            log.plot()
    return found


# Colours

#: Linear RGB as people without one kind of cone see it (Machado, Oliveira and Fernandes 2009).
SIGHTS: dict[str, npt.ArrayLike] = {
    "all cones": np.eye(3),
    "no red": [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
    "no green": [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
    "no blue": [[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]],
}
TO_XYZ = np.array([[0.4339, 0.3762, 0.1899], [0.2126, 0.7152, 0.0722], [0.0178, 0.1095, 0.8728]])


def cielab(colour: str, sight: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Returns a colour in the space where distances are those that people see."""
    rgb = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)]) / 255
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    seen = TO_XYZ @ np.clip(np.asarray(sight) @ linear, 0, 1)
    x, y, z = np.where(seen > 0.008856, np.cbrt(seen), 7.787 * seen + 16 / 116)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


@pytest.mark.parametrize("sight", SIGHTS)
def test_colours_can_be_told_apart(sight: str) -> None:
    seen = [cielab(colour, SIGHTS[sight]) for colour in COLOURS]
    # 2.3 is a just noticeable difference.
    assert min(float(np.linalg.norm(a - b)) for a, b in combinations(seen, 2)) > 15
    # Black, white and the background of dark pages.
    for paper in ("#ffffff", "#000000", "#14181d"):
        assert all(abs(one[0] - cielab(paper, np.eye(3))[0]) > 25 for one in seen)
