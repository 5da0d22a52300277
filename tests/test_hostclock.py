"""`HostClock`: device time on the clock of the host, against simulated transports whose truth is known."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xbus import HostClock

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

#: Seconds since 1970 at which the recordings begin, and the least delay of their transport.
BEGIN, LEAST = 1_790_000_000, 1.2e-3


# ---------------------------------------------------------------------------------------------
# Transports
# ---------------------------------------------------------------------------------------------


def ns(seconds: Floats) -> Ints:
    """Seconds since the beginning to ns since 1970."""
    return BEGIN * 10**9 + np.rint(seconds * 1e9).astype(np.int64)


def sent(
    rate: float, seconds: float, drift: float = 12e-6, begin: float = 77.7
) -> tuple[Floats, Floats]:
    """Device times of samples, and when they were sent on the host's clock."""
    time = begin + np.arange(int(rate * seconds)) / rate
    return time, 0.1 + (time - begin) * (1 + drift)


def read_at(host: Floats, reads: Floats) -> Floats:
    """Returns arrivals: the time of the first read after each sample."""
    return reads[np.searchsorted(reads, host + LEAST)]


def bursts(host: Floats, rng: np.random.Generator) -> Floats:
    """Arrivals from an adapter with a timer of 16 ms that restarts when the computer has answered."""
    return read_at(host, np.cumsum(0.016 + rng.exponential(0.3e-3, int(host[-1] / 0.016) + 100)))


def jittery(host: Floats, rng: np.random.Generator) -> Floats:
    """Arrivals every 16 ms of the host's own clock, a millisecond sooner or later."""
    count = int(host[-1] / 0.016) + 100
    return read_at(host, np.arange(count) * 0.016 + rng.uniform(0, 1e-3, count))


def frames_of_usb(host: Floats, rng: np.random.Generator) -> Floats:
    """Arrivals at every millisecond of the host's clock, against which 1 kHz beats slowly."""
    count = int(host[-1] / 1e-3) + 100
    return read_at(host, np.arange(count) * 1e-3 + rng.uniform(0, 20e-6, count))


def heavy(host: Floats, rng: np.random.Generator) -> Floats:
    """Arrivals over a busy network: delays are mostly short and sometimes very long; order is kept."""
    return np.maximum.accumulate(host + LEAST + 2e-3 * rng.pareto(1.5, len(host)).clip(0, 500))


def prompt(host: Floats, rng: np.random.Generator) -> Floats:
    """Arrivals with the least delay."""
    return np.maximum.accumulate(host + LEAST + rng.exponential(50e-6, len(host)))


Transport = Callable[[Floats, np.random.Generator], Floats]


# ---------------------------------------------------------------------------------------------
# Accuracy
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("transport", [bursts, jittery, prompt])
@pytest.mark.parametrize("rate", [1000, 2000, 3600])
def test_accuracy_after_a_minute(transport: Transport, rate: int, seed: int) -> None:
    """Offset within 0.2 ms of the least delay, drift within 0.1 ppm of the truth."""
    clock = HostClock()
    time, host = sent(rate, 60)
    arrival = transport(host, np.random.default_rng(seed))
    host_times = clock.update(time, ns(arrival)) - BEGIN
    assert abs(clock.drift - 12) < 0.1
    assert abs(clock.offset - BEGIN - (host[-1] - time[-1]) - LEAST) < 0.2e-3
    assert np.abs(host_times - host - LEAST)[-rate:].max() < 0.05e-3
    assert clock.residual == pytest.approx(np.mean((arrival - host - LEAST)[-10 * rate :]), rel=0.1)


@pytest.mark.parametrize("transport", [bursts, jittery, heavy])
@pytest.mark.parametrize("rate", [100, 400])
def test_accuracy_of_slow_devices(transport: Transport, rate: int) -> None:
    """Few samples arrive without a delay, so the accuracy needs five minutes instead of one."""
    clock = HostClock()
    time, host = sent(rate, 300)
    arrival = transport(host, np.random.default_rng(1))
    host_times = clock.update(time, ns(arrival)) - BEGIN
    assert abs(clock.drift - 12) < 0.1
    assert np.abs(host_times - host - LEAST)[60 * rate :].max() < 0.5e-3
    assert np.abs(host_times - host - LEAST)[240 * rate :].max() < 0.1e-3


@pytest.mark.parametrize("rate", [100, 1000])
def test_beating_clocks(rate: int) -> None:
    """A reader at nearly the rate of the samples receives one without delay only every 83 s."""
    clock = HostClock()
    time, host = sent(rate, 900)
    arrival = frames_of_usb(host, np.random.default_rng(1))
    host_times = clock.update(time, ns(arrival)) - BEGIN
    assert np.abs(host_times - host - LEAST).max() < 1.1e-3
    assert np.abs(host_times - host - LEAST)[600 * rate :].max() < 0.05e-3


def test_drift_changes_are_followed() -> None:
    """The drift of a device that warms up falls from 12 to 10 ppm in ten minutes."""
    clock = HostClock()
    rate = 400
    time, host = sent(rate, 1800, drift=0)
    drift = np.clip(12e-6 - 2e-6 * (time - 77.7) / 600, 10e-6, None)
    host = host + np.cumsum(drift) / rate
    host_times = clock.update(time, ns(bursts(host, np.random.default_rng(1)))) - BEGIN
    assert np.abs(host_times - host - LEAST)[60 * rate :].max() < 0.4e-3
    assert abs(clock.drift - 10) < 0.01


def test_delay_changes_are_followed() -> None:
    """A slower connection is followed once the window contains only slow samples."""
    clock = HostClock()
    time, host = sent(100, 1500)
    later = np.where(time > 300, 5e-3, 0)
    host_times = clock.update(time, ns(prompt(host, np.random.default_rng(1)) + later)) - BEGIN
    off = host_times - host - LEAST
    assert np.abs(off[(time > 100) & (time < 400)]).max() < 0.2e-3
    assert np.abs(off[time > 1200] - 5e-3).max() < 0.2e-3
    assert clock.steps == []


# ---------------------------------------------------------------------------------------------
# Comparison with a plain algorithm
# ---------------------------------------------------------------------------------------------


def plain_host_times(time: Floats, arrival: Ints) -> Floats:
    """Computes host times from all points for every sample. The times must rise, without steps."""
    x, y = time - time[0], (arrival - arrival[0]) / 1e9 - (time - time[0])
    host_times: list[float] = []
    drift = 0.0
    for now in range(len(x)):
        minute = np.floor(x[: now + 1] / 60)
        window = np.flatnonzero(minute >= minute[-1] - 10)
        px, py = x[window], y[window]

        def height(at: float, px: Floats = px, py: Floats = py) -> float:
            """Returns the lowest of all chords at this time."""
            left, right = px <= at, px >= at
            i, j = np.meshgrid(np.flatnonzero(left), np.flatnonzero(right), indexing="ij")
            span = np.where(px[j] > px[i], px[j] - px[i], 1)
            return float(np.min(py[i] + (py[j] - py[i]) * (at - px[i]) / span))

        span = px[-1] - px[0]
        if span >= 10:
            low, high = px[0] + 0.3 * span, px[0] + 0.7 * span
            drift = float(np.clip((height(high) - height(low)) / (high - low), -200e-6, 200e-6))
        line = np.min(py - drift * px) + drift * x[now]
        host_times.append(max(x[now] + line, host_times[-1] if host_times else -np.inf))
    host: Floats = np.array(host_times) + arrival[0] / 1e9
    return host


@given(st.integers(0, 2**32), st.sampled_from((0.05, 1.0, 20.0)), st.sampled_from((0, 1e-3, 9e-3)))
def test_matches_the_plain_algorithm(seed: int, step: float, wait: float) -> None:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.1, 1, 100) * step)
    arrival = ns(
        time * (1 + rng.uniform(-250e-6, 250e-6)) + rng.uniform(0, wait, 100) + rng.uniform(0, 1e-5)
    )
    arrival = np.maximum.accumulate(arrival)
    clock = HostClock()
    assert clock.update(time, arrival) == pytest.approx(
        plain_host_times(time, arrival), abs=1e-6, rel=0
    )
    assert clock.fits == 1


# ---------------------------------------------------------------------------------------------
# Invariants
# ---------------------------------------------------------------------------------------------

#: Steps of device time (ms) and of arrivals (ms), and whether the sample leads.
SAMPLES = st.lists(
    st.tuples(
        st.sampled_from(
            (-100_000, -60, -5, 0, 1, 2, 5, 10, 10, 1000, 20_000, 700_000, float("nan"))
        ),
        st.sampled_from((0, 0, 1, 5, 16, 100, 1000, 15_000, 100_000)),
        st.booleans(),
    ),
    max_size=60,
)


def run_walk(
    samples: list[tuple[float, float, bool]],
) -> tuple[Floats, Ints, npt.NDArray[np.bool_]]:
    steps, waits, leads = (np.array(item) for item in zip(*samples, strict=True))
    time = 500 + np.cumsum(np.nan_to_num(steps)) / 1e3
    time[np.isnan(steps)] = np.nan
    return time, ns(np.cumsum(waits) / 1e3), leads.astype(bool)


@given(SAMPLES.filter(bool))
def test_host_times_rise_and_never_exceed_the_arrival(
    samples: list[tuple[float, float, bool]],
) -> None:
    time, arrival, leads = run_walk(samples)
    clock = HostClock()
    newest, last, fits = -np.inf, -np.inf, 0
    for at, (seconds, stamp) in enumerate(zip(time.tolist(), arrival.tolist(), strict=True)):
        host = clock.update(seconds, stamp, bool(leads[at]))
        if clock.fits != fits:
            newest, fits = -np.inf, clock.fits
        if leads[at] and seconds > newest:
            assert last <= host <= stamp / 1e9 + 1e-6
            newest, last = seconds, host
        elif not np.isnan(host):
            assert seconds > newest or host <= last


@given(SAMPLES.filter(bool), st.integers(1, 20))
def test_chunking_does_not_change_host_times(
    samples: list[tuple[float, float, bool]], size: int
) -> None:
    """Whole, one by one, in pieces, and by a copy."""
    time, arrival, leads = run_walk(samples)
    whole = HostClock()
    host_times = whole.update(time, arrival, leads)
    single, pieces = HostClock(), HostClock()
    one_by_one = [
        single.update(*item)
        for item in zip(time.tolist(), arrival.tolist(), leads.tolist(), strict=True)
    ]
    np.testing.assert_array_equal(host_times, one_by_one)
    for start in range(0, len(time), size):
        here = slice(start, start + size)
        pieces = pieces.copy()
        np.testing.assert_array_equal(
            pieces.update(time[here], arrival[here], leads[here]), host_times[here]
        )
    assert whole.steps == single.steps == pieces.steps
    np.testing.assert_array_equal(whole.host_time(time), pieces.host_time(time))


def test_past_times_keep_their_host_time() -> None:
    """Delayed samples therefore keep their order among the others."""
    clock = HostClock()
    time, host = sent(1000, 20)
    host_times = clock.update(time, ns(bursts(host, np.random.default_rng(1))))
    np.testing.assert_allclose(clock.host_time(time[-900:]), host_times[-900:], rtol=0, atol=1e-6)
    assert clock.host_time(float(time[-1])) == host_times[-1]
    middle = clock.host_time((time[-900:-1] + time[-899:]) / 2)
    assert np.all((host_times[-900:-1] <= middle) & (middle <= host_times[-899:]))
    assert clock.host_time(float(time[-1]) + 5) == pytest.approx(host_times[-1] + 5, abs=1e-3)


@pytest.mark.parametrize(
    "number", [float, int, np.float32, np.float64, np.int32, Fraction, np.array], ids=repr
)
def test_a_scalar_of_any_type_gives_a_float(number: Callable[[int], Any]) -> None:
    clock = HostClock()
    host_time = clock.update(number(1), 5_000_000_000)
    assert (type(host_time), host_time) == (float, 5.0)
    assert type(clock.host_time(number(1))) is float


def test_before_the_first_sample() -> None:
    clock = HostClock()
    assert repr(clock) == "<HostClock without a sample>"
    values = [clock.offset, clock.drift, clock.residual, clock.since, clock.host_time(1.0)]
    assert np.isnan(values).all()
    assert np.isnan(
        [clock.update(float("nan"), 1), clock.update(float("inf"), 1), clock.update(3.0, 1, False)]
    ).all()
    assert clock.fits == 0
    assert clock.update(np.empty(0), np.empty(0, np.int64)).shape == (0,)


@pytest.mark.parametrize("arrival", [-(2**63), 2**63 - 1, 0])
@pytest.mark.parametrize("time", [-1e300, 0.0, 1e300])
def test_absurd_numbers(time: float, arrival: int) -> None:
    clock = HostClock()
    for item in (0, arrival, -(2**63), 2**63 - 1):
        clock.update(0.0, item)
        clock.update(time, item)
        clock.update(1.0, item)
    assert len(clock.steps) == clock.fits - 1


# ---------------------------------------------------------------------------------------------
# Steps
# ---------------------------------------------------------------------------------------------


def with_steps(device: float = 0, clock: float = 0, off: float = 0) -> tuple[Floats, Ints, Floats]:
    """Two minutes at 400 Hz; in the middle device time and the host's clock step, after a pause of `off`."""
    time, host = sent(400, 120)
    arrival = bursts(host, np.random.default_rng(1))
    half = len(time) // 2
    gap = np.where(np.arange(len(time)) < half, 0.0, 1.0)
    return time + gap * device, ns(arrival + gap * (clock + off)), host + gap * (clock + off)


STEPS = {
    # What happens: device time, host's clock, gap; the reason, and how many seconds it takes to see it.
    "reset": (-130, 0, 3, "device time went back", 0),
    "reset at once": (-10, 0, 0, "device time went back", 0),
    "host's clock set back": (0, -3600, 0, "arrivals became early", 0),
    "host's clock set back a little": (0, -0.05, 0, "arrivals became early", 0),
    "host's clock set ahead": (0, 86_400, 0, "arrivals became late", 10),
    "host's clock stood still": (1800, 0, 0, "arrivals became early", 0),
    "device's clock stood still": (0, 0, 1800, "arrivals became late", 10),
    "device's clock set ahead": (43_200, 0, 0, "arrivals became early", 0),
}


@pytest.mark.parametrize(
    ("device", "host_step", "off", "reason", "wait"), STEPS.values(), ids=STEPS
)
def test_steps(device: float, host_step: float, off: float, reason: str, wait: float) -> None:
    clock = HostClock()
    time, arrival, host = with_steps(device, host_step, off)
    host_times = clock.update(time, arrival) - BEGIN
    half = len(time) // 2
    assert [step.reason for step in clock.steps] == [reason]
    assert clock.fits == 2
    assert clock.steps[0].time == clock.since == pytest.approx(time[half] + wait, abs=0.05)
    assert clock.steps[0].host_time - BEGIN == pytest.approx(host[half] + wait, abs=0.05)
    settled = np.r_[20 * 400 : half, half + int(wait + 20) * 400 : len(time)]
    assert np.abs(host_times - host - LEAST)[settled].max() < 0.3e-3
    if host_step >= 0:
        assert np.diff(host_times).min() >= 0
    assert "1 steps" in repr(clock)


def test_a_gap_is_not_a_step() -> None:
    """The computer was suspended while its clock and the device continued."""
    clock = HostClock()
    time, arrival, host = with_steps(device=1800, off=1800)
    host_times = clock.update(time, arrival) - BEGIN
    assert clock.steps == []
    # The drift, known to 0.3 ppm by then, has not been seen for half an hour.
    assert np.abs(host_times - host - LEAST)[20 * 400 :].max() < 20e-3


def test_a_late_start_is_not_a_step() -> None:
    """The first samples were in a buffer when the port was opened."""
    clock = HostClock()
    time, host = sent(400, 60)
    arrival = np.maximum(bursts(host, np.random.default_rng(1)), 3.0)
    host_times = clock.update(time, ns(arrival)) - BEGIN
    assert clock.steps == []
    assert clock.fits == 1
    assert np.abs(host_times - host - LEAST)[30 * 400 :].max() < 0.2e-3


@pytest.mark.parametrize("stall", [0.05, 1, 9])
def test_a_stall_is_not_a_step(stall: float) -> None:
    """The computer was busy; then all samples arrive at once, and still get correct times."""
    clock = HostClock()
    time, host = sent(400, 120)
    arrival = bursts(host, np.random.default_rng(1))
    arrival = np.where((host > 60) & (host < 60 + stall), np.maximum(arrival, 60 + stall), arrival)
    host_times = clock.update(time, ns(arrival)) - BEGIN
    assert clock.steps == []
    assert np.abs(host_times - host - LEAST)[50 * 400 :].max() < 0.1e-3


def test_a_minute_of_load_is_not_a_step() -> None:
    clock = HostClock()
    time, host = sent(400, 300)
    load = np.where((host > 180) & (host < 240), 0.08, 0)
    host_times = clock.update(time, ns(bursts(host, np.random.default_rng(1)) + load)) - BEGIN
    assert clock.steps == []
    assert np.abs(host_times - host - LEAST)[50 * 400 :].max() < 0.1e-3


@pytest.mark.parametrize("behind", [0.045, -0.4, 900, -900, 1e9])
def test_gnss_samples_do_not_change_the_fit(behind: float) -> None:
    """GNSS samples are delayed or, without a fix, have an arbitrary time and then no host time."""
    time, host = sent(400, 60)
    arrival = ns(bursts(host, np.random.default_rng(1)))
    alone, clock = HostClock(), HostClock()
    host_times = alone.update(time, arrival)
    gnss = np.arange(len(time)) % 100 == 50
    both = clock.update(time - np.where(gnss, behind, 0), arrival, ~gnss)
    assert clock.steps == []
    assert clock.drift == pytest.approx(12, abs=0.3)
    np.testing.assert_allclose(both[~gnss][8000:], host_times[~gnss][8000:], rtol=0, atol=0.2e-3)
    if abs(behind) > 1:
        assert np.isnan(both[gnss]).all()
    else:
        off = both[gnss] - BEGIN - (host[gnss] - behind) - LEAST
        assert np.abs(off[100:]).max() < 0.2e-3


def test_many_steps() -> None:
    """The last hundred steps are kept, and all are counted."""
    clock = HostClock()
    for boot in range(250):
        for tick in range(3):
            clock.update(tick + 100.0, (boot * 100 + tick) * 10**9)
        clock.update(0.0, (boot * 100 + 50) * 10**9)
    assert len(clock.steps) == 100
    assert clock.fits > 250


@pytest.mark.parametrize(
    ("device_time", "arrival", "leads"),
    [
        ("1", 5, True),
        (1.0, "5", True),
        (1.0, 5.5, True),
        (1.0, 5, "no"),
        (["1"], [5], True),
        (np.array([1.0]), np.array(["5"]), True),
        (np.array([1.0]), np.array([5.5]), True),
        (np.array([1.0]), np.array([5]), "no"),
        (None, 5, True),
        ([None], [5], True),
    ],
)
def test_wrong_types_are_refused(device_time: Any, arrival: Any, leads: Any) -> None:
    clock = HostClock()
    with pytest.raises(TypeError):
        clock.update(device_time, arrival, leads)
    assert clock.fits == 0


def test_text_is_not_a_device_time() -> None:
    clock = HostClock()
    clock.update(1.0, 5)
    for wrong in ("1", ["1"], None):
        with pytest.raises(TypeError):
            clock.host_time(wrong)  # type: ignore[call-overload]
