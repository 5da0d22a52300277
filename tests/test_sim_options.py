"""Options of virtual devices: as text, in the name of a port, and changed while a server runs."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import serial

import xbus
from streams import frame
from test_sim_serve import Clock, Fake, exchange, on_pty, on_tcp, open_port, step_until
from xbus import Faults, SimulatedDevice
from xbus.protocol.configuration import Firmware
from xbus.sim import Server, serving
from xbus.sim.options import OPTIONS, device_of, parse_options

#: Acceleration, and a quantity that no IMU has.
ACCELERATION, LAT_LON = 0x4020, 0x5040

# As text


def test_every_option_reaches_the_device() -> None:
    device = device_of(
        "sim:MTi-680G?device_id=0x80001234&firmware=1.2.3&baudrate=460800&fault=flip=0.1&fault=burst=1"
        "&noise=2&seed=5&strict_outputs=false&time_to_fix=0&trajectory=sail&utc=2026-11-28T12:00:00%2B02:00"
    )
    assert device.product.name == "MTi-680G"
    assert device.identity.device_id == 0x80001234
    assert device.identity.firmware == Firmware(1, 2, 3)
    assert device.baudrate == 460800
    assert device.faults == Faults(flip=0.1, burst=1, seed=5)
    device.faults = None
    device.advance(2)
    log = xbus.read_log(device.read())
    assert "lat_lon" in log  # the fix is there at once
    assert device._unit.utc - np.datetime64("2026-11-28T10:00:00") < np.timedelta64(3, "s")


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ("nosie=1", f"has no option nosie; its options are {', '.join(OPTIONS)}"),
        ("=1", "has no option ; its options are"),
        ("noise=1&noise=2", "noise is given twice"),
        ("noise", "noise must be a number, 0 or more, not ''"),
        ("noise=-1", "noise must be a number"),
        ("noise=nan", "noise must be a number"),
        ("seed=-1", "seed must be a whole number"),
        ("seed=1.5", "seed must be a whole number"),
        ("device_id=xyz", "device_id must be a hexadecimal number"),
        ("device_id=10000000000000000", "device_id must be a hexadecimal number"),
        ("firmware=1.2", "firmware must be MAJOR.MINOR.REVISION"),
        ("firmware=1.2.256", "firmware must be MAJOR.MINOR.REVISION"),
        ("time_to_fix=inf", "time_to_fix must be seconds"),
        ("strict_outputs=no", "strict_outputs must be true or false"),
        ("utc=1990-01-01", "utc must be a date and time from 1999"),
        ("utc=noon", "utc must be a date and time"),
        ("trajectory=loop", "no trajectory is called 'loop'"),
        ("baudrate=12345", "does not support 12,345 baud"),
        ("fault=flop=1", "'flop=1' is not a fault"),
    ],
)
def test_what_is_wrong_is_named(query: str, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        device_of(f"sim:MTi-630?{query}")


def test_a_device_is_connected_with_options() -> None:
    with xbus.connect("sim:MTi-300?device_id=0370ABCD&baudrate=921600") as device:
        with device.configure():
            pass
        assert device.device_id == 0x0370ABCD
        assert device.link.baudrate == 921600


def test_the_page_lists_every_option() -> None:
    page = (Path(__file__).parent.parent / "docs" / "howto" / "ci.md").read_text()
    listed = page.partition("They are ")[2].partition(".")[0]
    assert re.findall(r"`(\w+)`", listed) == list(OPTIONS)


def test_no_options() -> None:
    assert parse_options([]) == {}
    assert device_of("sim:mti-3?").product.name == "MTi-3"


# Output configurations


def answer_to_outputs(device: SimulatedDevice, payload: str) -> bytes:
    device.advance(0.1)
    device.write(frame(0x30))
    device.read()
    device.write(frame(0xC0, bytes.fromhex(payload)))
    return device.read()


def test_strict_outputs_refuse_the_whole_list() -> None:
    device = SimulatedDevice("MTi-630")
    before = device.settings.output_configuration
    assert answer_to_outputs(device, "4020 0064 5040 0064") == frame(0x42, b"\x21")
    assert device.settings.output_configuration == before


@pytest.mark.parametrize("unsupported", ["5040", "402C", "FFF0"])
def test_other_devices_drop_what_they_do_not_support(unsupported: str) -> None:
    device = SimulatedDevice("MTi-630", strict_outputs=False)
    accepted = bytes.fromhex("4020 0064 1020 FFFF")
    reply = answer_to_outputs(device, f"4020 0064 {unsupported} 0064 1020 FFFF")
    assert reply == frame(0xC1, accepted)
    assert [output.data_id for output in device.settings.output_configuration] == [0x4020, 0x1020]


def test_nothing_is_left() -> None:
    device = SimulatedDevice("MTi-630", strict_outputs=False)
    assert answer_to_outputs(device, "5040 0064") == frame(0xC1, bytes(4))


# Faults


def seconds(device: SimulatedDevice, count: float) -> xbus.Log:
    device.advance(count)
    return xbus.read_log(device.read())


def test_faults_are_switched_on_and_off() -> None:
    device = SimulatedDevice("MTi-630")
    assert device.faults is None
    seconds(device, 1)
    assert len(seconds(device, 5).damage) == 0
    device.faults = Faults(flip=1e-3)
    assert len(seconds(device, 5).damage) > 10
    device.faults = None
    assert len(seconds(device, 5).damage) == 0


@pytest.mark.parametrize("baudrate", [None, 115200])
def test_bytes_that_a_fault_held_back_arrive_when_the_fault_ends(baudrate: int | None) -> None:
    device, sound = (SimulatedDevice("MTi-630", baudrate=baudrate) for _ in range(2))
    for item in (device, sound):
        item.advance(1)
        item.read()
    device.faults = Faults(stall=(device.time, 100))
    device.advance(2)
    assert device.read() == b""
    device.faults = None
    device.advance(1)
    sound.advance(3)
    assert device.read() == sound.read()


def test_a_plug_that_a_fault_pulled_is_back_when_the_fault_ends() -> None:
    device = SimulatedDevice("MTi-630")
    device.advance(1)
    device.faults = Faults(unplug=(0, None))
    assert not device.plugged
    device.faults = None
    assert device.plugged


def test_a_device_in_many_threads() -> None:
    """Threads that switch faults do not disturb the thread that moves the device on."""
    device = SimulatedDevice("MTi-630")
    device.advance(1)
    device.read()
    failures: list[BaseException] = []
    done = threading.Event()

    def switch() -> None:
        try:
            while not done.is_set():
                device.faults = Faults(burst=0.016)
                device.trigger(2)
                device.faults = None
                device.connect_antenna(False)
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=switch) for _ in range(3)]
    for thread in threads:
        thread.start()
    received = b""
    for _ in range(500):
        device.advance(0.01)
        received += device.read()
    done.set()
    for thread in threads:
        thread.join()
    log = xbus.read_log(received)
    assert not failures
    assert len(log) > 450
    assert len(log.damage) == 0
    assert log.stats.lost_samples == 0


# Servers


@pytest.mark.parametrize("on", [on_pty, on_tcp])
def test_device_time_may_run_faster(on: Callable[..., Server]) -> None:
    clock = Clock()
    with on(Fake(), clock=clock, speed=20) as server:
        clock.now += 0.5
        server.step(0)
        clock.now += 5
        server.step(0)
        device: object = server.device
        assert isinstance(device, Fake)
        assert device.steps == [10, 20]


def test_the_speed_may_change() -> None:
    clock, speeds = Clock(), iter([2, 10, 0.5])
    with on_tcp(Fake(), clock=clock, speed=lambda: next(speeds)) as server:
        for _ in range(3):
            clock.now += 0.5
            server.step(0)
        device: object = server.device
        assert isinstance(device, Fake)
        assert device.steps == [1, 5, 0.25]


@pytest.mark.parametrize("speed", [0, -1, float("nan"), float("inf")])
def test_no_speed(speed: float) -> None:
    with pytest.raises(ValueError, match="speed must be a factor above 0"):
        on_pty(Fake(), speed=speed)


def test_a_client_reads_a_faster_device_without_loss() -> None:
    device = SimulatedDevice("MTi-630")
    with serving(device, speed=10) as port, xbus.connect(port) as client:
        before = device.time
        client.discard()  # samples that a busy machine has let wait
        samples = [client.read_sample() for _ in range(300)]
        assert device.time - before > 2.9
    assert np.diff([sample["sample_time_fine"] for sample in samples]).tolist() == [100] * 299


def test_a_link_leads_to_the_served_port(tmp_path: Path) -> None:
    link = tmp_path / "mti"
    with serving(SimulatedDevice("MTi-3"), link=link) as port:
        assert port == str(link)
        assert link.is_symlink()
    with (
        pytest.raises(ValueError, match="link needs a pseudo-terminal"),
        serving(SimulatedDevice("MTi-3"), tcp=True, link=link),
    ):
        pass


def test_an_idle_client_is_disconnected_and_the_next_one_gets_in() -> None:
    clock = Clock()
    with on_tcp(Fake(), clock=clock, idle_timeout=10) as server:
        with open_port(server) as client:
            assert exchange(server, client, b"here") == b"here"
            clock.now += 9
            assert exchange(server, client, b"still") == b"still"
            clock.now += 9
            server.step(0)
            assert server.has_client
            clock.now += 2
            server.step(0)
            assert not server.has_client
            with pytest.raises(serial.SerialException):
                client.read(1)
        with open_port(server) as client:
            assert exchange(server, client, b"next") == b"next"


def test_a_client_who_only_reads_is_not_idle() -> None:
    clock = Clock()
    device = Fake()
    with on_tcp(device, clock=clock, idle_timeout=10) as server, open_port(server) as client:
        exchange(server, client, b"here")
        for _ in range(5):
            clock.now += 9
            device.sends = b"sample"
            server.step(0)
            assert client.read(6) == b"sample"
        assert server.has_client


def test_a_client_who_never_reads_is_idle() -> None:
    clock = Clock()
    device = Fake()
    with on_tcp(device, clock=clock, idle_timeout=10) as server, open_port(server) as client:
        exchange(server, client, b"here")

        def send() -> bool:
            clock.now += 1
            device.sends = bytes(1 << 20)
            return not server.has_client

        step_until(server, send)


def test_a_flood_of_bytes_leaves_the_device_answering() -> None:
    device = SimulatedDevice("MTi-630")
    with on_tcp(device) as server, open_port(server) as client:
        flood = threading.Thread(target=client.write, args=(b"\xfa" * 8_000_000,))
        flood.start()
        step_until(server, lambda: not flood.is_alive())
        step_until(server, lambda: device.time > 1)
        client.write(frame(0x30))
        step_until(server, lambda: device.state.value == "config")
        flood.join()
