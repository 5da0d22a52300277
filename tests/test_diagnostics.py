"""What messages say about a port from which no samples come, and what they recommend."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import xbus
from conftest import AlteredDevice
from streams import frame
from test_cli import run, sentence, start
from xbus import SimulatedDevice, XbusTimeout
from xbus.protocol import State
from xbus.sim import serving

posix = pytest.mark.skipif(os.name != "posix", reason="needs pseudo-terminals")

UNLISTED = 0x08


def measuring(**options: object) -> AlteredDevice:
    """Returns a measuring device whose messages from power-up are gone."""
    device = AlteredDevice("MTi-630", **options)
    device.advance(1)
    device.read()
    return device


def legacy(mid: int = 0x32) -> AlteredDevice:
    """Returns a device that sends another message instead of each sample."""
    device = measuring()
    scanner = xbus.Scanner()

    def alter(data: bytes) -> bytes:
        messages = [item for item in scanner.feed(data) if isinstance(item, xbus.Message)]
        return b"".join(
            frame(mid, bytes(10)) if item.mid == 0x36 else frame(item.mid, item.payload)
            for item in messages
        )

    device.alter = alter
    return device


class DeafDevice(AlteredDevice):
    """A device that receives nothing, as behind a line with one wire."""

    def write(self, data: bytes, baudrate: int | None = None) -> None:
        self.written.append(data)


# The wrong baud rate


@contextmanager
def at_another_rate() -> Iterator[str]:
    """Yields the port of a device that measures at 921600 baud."""
    with serving(measuring(baudrate=921_600)) as port:
        yield port


WRONG_RATE = (
    r"[\d,]+ bytes arrived on {port} at 115200 baud, but no message; 115200 baud is probably not the rate of"
    r" the device: leave the baud rate out \(no --baudrate\), and xbus finds it"
)


@posix
@pytest.mark.parametrize("command", ["record", "monitor", "listen"])
def test_the_given_rate_is_wrong(tmp_path: Path, command: str) -> None:
    args = {
        "record": ["record", "-o", str(tmp_path / "log.mtb")],
        "monitor": ["monitor", "--once", "1"],
        "listen": ["monitor", "--once", "1", "--listen"],
    }[command]
    with at_another_rate() as port:
        result = run(*args, port, "--baudrate", "115200")
    if command == "listen":
        assert "no frame in" in result.stdout
        assert "try another baud rate" in result.stdout
    else:
        assert re.fullmatch(WRONG_RATE.format(port=port), sentence(result))


@posix
def test_connect_at_a_wrong_rate() -> None:
    with (
        at_another_rate() as port,
        pytest.raises(XbusTimeout, match=WRONG_RATE.format(port=port)),
    ):
        xbus.connect(port, 115_200)


@posix
def test_the_right_rate_is_found() -> None:
    with at_another_rate() as port, xbus.connect(port) as device:
        assert device.link.baudrate == 921_600


@posix
def test_no_rate_is_right(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("xbus.device.opening.BAUDRATES", (115_200, 9600))
    with at_another_rate() as port, pytest.raises(XbusTimeout) as caught:
        xbus.connect(port)
    assert re.fullmatch(
        rf"bytes arrived on {port}, but no message \([\d,]+ bytes at 115200, [\d,]+ bytes at 9600 baud\); the"
        rf" device probably uses another baud rate than 115200, 9600 baud, or is not an MTi; xbus restore"
        rf" {port} recovers a device that answers at no baud rate",
        str(caught.value),
    )


@posix
def test_a_recording_of_a_tapped_line_at_a_wrong_rate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("xbus.cli.recording_job.MAX_SILENCE", 0.5)
    with at_another_rate() as port:
        rate = ["--listen", "--baudrate", "115200", "--duration", "2"]
        result = run("record", port, "-o", str(tmp_path / "log.mtb"), *rate)
    assert result.exit_code == 0
    note, last = result.stderr.splitlines()
    assert re.fullmatch(
        r"xbus: no sample for 0\.5 s, but [\d,]+ bytes without a message; 115200 baud is probably not the"
        r" rate of the device: leave --baudrate out; the recording continues",
        note,
    )
    assert "0 samples, " in last


@posix
def test_dump_at_a_wrong_rate() -> None:
    """A line in each second counts the bytes; Ctrl-C prints totals and the probable cause."""
    with at_another_rate() as port, start("dump", "--follow", port) as child:
        assert child.stderr is not None
        lines = [child.stderr.readline().decode() for _ in range(2)]
        child.send_signal(signal.SIGINT)
        out, rest = child.communicate(timeout=10)
    numbers = [
        int(found[1].replace(",", ""))
        for line in lines
        if (found := re.fullmatch(r"xbus: ([\d,]+) bytes without a message so far\n", line))
    ]
    assert len(numbers) == 2
    assert 0 < numbers[0] < numbers[1]
    # At most one line in each second: the device sends about 4.3 kB/s.
    assert numbers[1] - numbers[0] > 2000
    assert child.returncode == 130
    assert re.search(
        r"0 samples, 0 other messages, [\d,]+ bytes damaged; 115200 baud is probably not the rate of the"
        r" device: xbus identify \S+ finds it, and --baudrate sets it\n$",
        rest.decode(),
    )
    assert b"Traceback" not in out + rest


@posix
def test_dump_prints_totals_at_the_end() -> None:
    sim = measuring(baudrate=921_600)
    with serving(sim) as port, start("dump", "--follow", port) as child:
        assert child.stderr is not None
        printed = child.stderr.readline()
        sim.unplug()
        printed += child.communicate(timeout=20)[1]
    assert child.returncode == 1
    assert " bytes damaged; 115200 baud is probably not the rate of the device" in printed.decode()
    assert (
        f"{port} is gone: unplugged, or closed on the other side; check the cable"
        in printed.decode()
    )


def test_a_connection_without_a_baud_rate() -> None:
    sim = measuring()
    sim.alter = lambda data: b"\xaa" * len(data)
    with serving(sim, tcp=True) as port, pytest.raises(XbusTimeout) as caught:
        xbus.connect(port)
    assert re.fullmatch(
        rf"[\d,]+ bytes arrived on {port}, but no message; what sends there is not an MTi",
        str(caught.value),
    )


def test_a_silent_device_at_a_given_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    sim = measuring()
    sim.alter = lambda _: b""
    with pytest.raises(XbusTimeout) as caught:
        xbus.connect(sim, 115_200)
    assert "nothing was heard on sim:MTi-630 at 115200 baud; check that " in str(caught.value)
    assert str(caught.value).endswith(
        "; without a baud rate (no --baudrate) xbus tries all that devices use"
    )
    with pytest.raises(XbusTimeout, match="xbus restore sim:MTi-630 recovers a device"):
        xbus.connect(sim)


# Devices that do not answer


def test_a_device_that_ignores_go_to_config() -> None:
    sim = DeafDevice("MTi-630")
    with xbus.connect(sim) as device, pytest.raises(XbusTimeout) as caught:
        device.go_to_config()
    assert re.fullmatch(
        r"no answer to GoToConfig from sim:MTi-630 within [\d.]+ s, but the device sends packet_counter"
        r" \(100 Hz\), sample_time_fine \(100 Hz\), .* \(100 Hz\); check the line to the device, or restart"
        r" it with xbus reset sim:MTi-630; xbus record --listen and xbus monitor --listen need no answer",
        str(caught.value),
    )


@posix
def test_a_recording_of_a_device_that_ignores_go_to_config(tmp_path: Path) -> None:
    path = tmp_path / "log.mtb"
    with serving(DeafDevice("MTi-630")) as port:
        printed = sentence(run("record", port, "-o", str(path)))
    assert printed.startswith(f"no answer to GoToConfig from {port} ")
    assert f"xbus reset {port}" in printed
    assert not path.exists()


def test_strings_of_a_device_that_ignores_go_to_config() -> None:
    sim = DeafDevice("MTi-630")
    with xbus.connect(SimulatedDevice("MTi-630")) as other, other.configure() as cfg:
        cfg.set_strings(["HEHDT"], 50)
    sentence_ = xbus.encode_string("HEHDT", {"heading": 12.5})
    sim.alter = lambda data: sentence_ if data else b""
    with (
        xbus.connect(sim) as device,
        pytest.raises(XbusTimeout, match=r"sends HEHDT \([\d.]+ Hz\);"),
    ):
        device.go_to_config()


def test_a_device_that_is_silent_after_go_to_config() -> None:
    sim = DeafDevice("MTi-630")
    with xbus.connect(sim) as device:
        sim.alter = lambda _: b""
        device.listen(3)
        with pytest.raises(
            XbusTimeout, match="check that the device is powered and uses 115200 baud"
        ):
            device.go_to_config()


# Legacy and unknown outputs


def test_legacy_output_shows_that_the_device_measures() -> None:
    session = xbus.Session()
    events = session.receive(frame(0x32, bytes(10)) * 3)
    before = session.state
    assert {getattr(event, "name", None) for event in events} == {"MTData"}
    session.request("GoToConfig")
    session.receive(frame(0x32, bytes(10)) + frame(0x31))
    session.receive(frame(0x32, bytes(10)) * 3)  # still on their way
    assert (before, session.state) == (State.MEASUREMENT, State.CONFIG)


@pytest.mark.parametrize(
    ("mid", "name"),
    [
        (
            0x32,
            "MTData (0x32), the legacy output, whose OutputMode and OutputSettings are not known",
        ),
        (UNLISTED, "message 0x08, which the manual does not list"),
    ],
)
def test_time_outs_name_what_arrives(mid: int, name: str) -> None:
    device = xbus.connect(legacy(mid))
    ending = re.escape(f"within 1 s; the device sends {name}")
    with pytest.raises(XbusTimeout, match=f"no sample from sim:MTi-630 {ending}"):
        device.read_sample(timeout=1)
    with pytest.raises(XbusTimeout, match=f"no data from sim:MTi-630 {ending}"):
        next(device.blocks(seconds=0.1, timeout=1))
    with pytest.raises(XbusTimeout, match=f"no sample from sim:MTi-630 {ending}"):
        next(device.blocks(samples=10, timeout=1))
    with pytest.raises(XbusTimeout, match=f"no string from sim:MTi-630 {ending}"):
        device.read_string(timeout=1)
    stats = device.stats
    assert stats.message_counts[mid] > 100
    assert stats.message_rates[mid] == pytest.approx(100, rel=0.02)


def test_time_outs_name_bytes_without_a_message() -> None:
    sim = measuring()
    device = xbus.connect(sim)
    device.read_sample()
    sim.alter = lambda data: b"\xaa" * len(data)
    with pytest.raises(XbusTimeout, match=r"[\d,]+ bytes without a message arrived: the baud rate"):
        list(device)


def test_legacy_output_does_not_replace_notices() -> None:
    sim = AlteredDevice("MTi-630")
    device = xbus.connect(sim)
    sim.alter = lambda data: frame(0x32, bytes(10)) * 5 if data else b""
    device.listen(1)
    assert device.stats.message_counts[0x32] > 200
    assert "WakeUp" in [notice.name for notice in device.notices]


def test_a_recording_of_legacy_output(
    tmp_path: Path, behind: Callable[[SimulatedDevice], str]
) -> None:
    path = tmp_path / "log.mtb"
    result = run("record", behind(legacy()), "-o", str(path), "--duration", "8")
    assert result.exit_code == 0
    note, last = result.stderr.splitlines()
    assert re.fullmatch(
        r"xbus: no sample for 5 s, but \d+ messages MTData \(0x32\), the legacy output, whose OutputMode and"
        r" OutputSettings are not known; --output or --config sets outputs that replace it; the recording"
        r" continues",
        note,
    )
    log = xbus.read_log(path)
    count = sum(message.name == "MTData" for message in log.messages)
    assert count > 50
    assert f": 8.0 s, 0 samples, {count} messages MTData (0x32), " in last
    shown = run("info", str(path)).stdout
    assert f"MTData {count}" in shown
    words = " ".join(shown.split())
    assert f"undecoded {count} messages MTData (0x32), " in words
    assert ": no OutputMode and OutputSettings for 10 bytes" in words


def test_the_monitor_names_legacy_output() -> None:
    with serving(legacy(), tcp=True) as port:
        shown = run("monitor", port, "--once", "2").stdout
    assert "Measurement State" in shown
    assert "the device sends MTData (0x32), the legacy output" in shown
    assert re.search(r"^MTData \(0x32\) +(9\d|10\d)\.\d .*not decoded$", shown, re.MULTILINE)


def test_a_replay_names_legacy_output(tmp_path: Path) -> None:
    path = tmp_path / "legacy.mtb"
    path.write_bytes(frame(0x32, bytes(10)) * 10 + xbus.encode_sample({"packet_counter": 1}))
    shown = run("monitor", str(path), "--once", "1").stdout
    assert "the device sends MTData (0x32)" in shown
