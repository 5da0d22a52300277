"""A virtual device and the vendor's software: its requests, step by step, and the replies it requires."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable
from typing import Any, Protocol

import pytest
import serial

from xbus import MessageId, Sample, Scanner, SimulatedDevice, encode_frame
from xbus.protocol import EVERY, Output, State, decode, encode
from xbus.protocol.ids import DataId
from xbus.protocol.products import Support, support
from xbus.protocol.tables import PRODUCTS, QUANTITIES
from xbus.sim import serving
from xbus.wire.message import Message

BAUDRATE = 115_200
#: Time-outs in seconds: of GoToConfig during the scan and later, and of most other requests.
SCAN_TIMEOUT, CONFIG_TIMEOUT, TIMEOUT = 0.1, 0.2, 0.5
TIMEOUTS = {MessageId.ReqConfiguration: 5.0, MessageId.ReqEmts: 10.0}
#: Seconds and bytes of one read.
STEP, PIECE = 0.005, 1 << 12


class Port(Protocol):
    """An open port."""

    def write(self, data: bytes, /) -> Any: ...
    def read(self, size: int, /) -> bytes: ...


class PortInProcess:
    """A port of a device in this process, whose time advances during a read."""

    def __init__(self, device: SimulatedDevice) -> None:
        self.device = device
        device.read()  # lost: the port was not open

    def write(self, data: bytes) -> None:
        self.device.write(data, baudrate=BAUDRATE)

    def read(self, size: int) -> bytes:
        self.device.advance(STEP)
        return self.device.read(baudrate=BAUDRATE)


class Host:
    """The software at the port. Each request must get one reply, from the bus identifier of the request.

    Args:
        port: An open port.
        patience: By how much it waits longer: real time is not for tests.
    """

    def __init__(self, port: Port, patience: int = 1) -> None:
        self.port, self.patience = port, patience
        self.samples: list[Sample] = []
        self._scanner = Scanner()
        self._is_in_step = False
        self._silence = 0

    def ask(self, mid: MessageId, data: bytes = b"", timeout: float | None = None) -> bytes | None:
        """Returns the payload of the reply; None for Error."""
        self.port.write(encode_frame(mid, data))
        timeout = TIMEOUTS.get(mid, TIMEOUT) if timeout is None else timeout
        for _ in range(round(timeout / STEP) * self.patience):
            if answers := self.read():
                (answer,) = answers
                assert answer.bid == 0xFF
                assert answer.mid in (mid + 1, MessageId.Error), mid
                return None if answer.mid == MessageId.Error else answer.payload
        raise AssertionError(f"no answer to {mid.name} within {timeout} s")

    def must(self, mid: MessageId, data: bytes = b"", timeout: float | None = None) -> bytes:
        """Returns the payload of the reply, which must not be Error."""
        answer = self.ask(mid, data, timeout)
        assert answer is not None, mid
        return answer

    def go_to_config(self, data: bytes = b"") -> None:
        assert self.must(MessageId.GoToConfig, data, SCAN_TIMEOUT) == b""

    def read(self) -> list[Message]:
        """Returns the messages of one read that are not samples."""
        data = self.port.read(PIECE)
        self._silence = 0 if data else self._silence + 1
        found = self._scanner.feed(data) if self._silence < 4 else self._scanner.close()
        messages = [message for message in found if isinstance(message, Message)]
        # A port that is opened during a measurement starts in the middle of a sample.
        assert len(messages) == len(found) or not self._is_in_step, found
        self._is_in_step |= bool(messages)
        self.samples += [
            Sample(message.payload) for message in messages if message.mid == MessageId.MTData2
        ]
        return [message for message in messages if message.mid != MessageId.MTData2]


def scan(host: Host) -> None:
    """Finds the device and reads its identity."""
    host.go_to_config()
    assert len(host.must(MessageId.ReqDID)) in (4, 8)


def initialise(host: Host, known: Support) -> None:
    """Reads everything that the software needs before a program can use the device."""
    host.go_to_config()
    # The thirty bytes complete a frame that the device may wait for.
    host.go_to_config(bytes(30))
    device_id = host.must(MessageId.ReqDID)
    assert device_id == encode("DeviceID", known.identity.device_id)
    code = host.must(MessageId.ReqProductCode)
    assert (len(code), code.decode().split(" ")[0]) == (20, known.identity.product_code)
    assert len(host.must(MessageId.ReqHardwareVersion)) == 2
    assert len(host.must(MessageId.ReqFWRev)) == 11
    high, low = device_id[:-4], device_id[-4:]
    assert host.must(MessageId.InitBus) == low

    configuration = host.must(MessageId.ReqConfiguration, b"\x00\xff")
    assert configuration == host.must(MessageId.ReqConfiguration)
    assert len(configuration) == 118
    assert configuration[96:98] == b"\x00\x01"
    # An identifier of eight bytes has its low half first.
    assert configuration[:4] == configuration[98:102] == low
    if high:
        assert configuration[4:8] == configuration[102:106] == high
    assert tuple(configuration[112:115]) == known.identity.firmware[:3]

    outputs = host.must(MessageId.ReqOutputConfiguration)
    assert len(outputs) % 4 == 0
    assert decode("ReqOutputConfigurationAck", outputs) == known.output_configuration
    assert len(host.must(MessageId.ReqEmts, b"\x00\xff")) > 0
    assert len(host.must(MessageId.ReqOptionFlags)) == 4
    assert len(host.must(MessageId.ReqSyncSettings)) % 12 == 0
    profiles = host.ask(MessageId.ReqAvailableFilterProfiles)
    profile = host.ask(MessageId.ReqFilterProfile)
    if not known.filter_profiles:
        assert (profiles, profile) == (None, None)
        return
    assert profiles is not None
    assert len(profiles) % 22 == 0
    # A label ends at its first space.
    slots = [profiles[start : start + 22] for start in range(0, len(profiles), 22)]
    labels = [slot[2:].decode().split(" ", 1)[0] for slot in slots if slot[0] and b" " in slot]
    assert labels == [profile.label for profile in known.filter_profiles]
    assert profile is not None


#: Requested at 0 Hz: with every sample.
WITH_EVERY_SAMPLE = (DataId.PacketCounter, DataId.SampleTimeFine, DataId.StatusWord)


def configure(host: Host, *measured: Output) -> None:
    """The reply must have every line of the output configuration."""
    asked = [*(Output(data_id, 0) for data_id in WITH_EVERY_SAMPLE), *measured]
    answer = host.must(MessageId.SetOutputConfiguration, encode("SetOutputConfiguration", asked))
    assert len(answer) == 4 * len(asked)
    outputs = decode("SetOutputConfigurationAck", answer)
    assert outputs == tuple(
        output._replace(frequency=output.frequency or EVERY) for output in asked
    )
    assert host.must(MessageId.ReqOutputConfiguration) == answer


def measure(host: Host, known: Support, count: int) -> None:
    """Receives samples without a gap, while the gyroscope biases are estimated."""
    assert host.must(MessageId.GoToMeasurement) == b""
    answer = host.ask(MessageId.SetNoRotation, b"\x00\x06")
    assert answer == (b"" if "SetNoRotation" in known.messages else None)
    for _ in range(1000 * host.patience):
        if len(host.samples) >= count:
            break
        assert host.read() == []
    assert [sample["packet_counter"] for sample in host.samples] == list(range(len(host.samples)))
    first = int(host.samples[0]["sample_time_fine"])
    times = [int(sample["sample_time_fine"]) - first for sample in host.samples]
    assert times == list(range(0, 100 * len(times), 100))
    assert len(times) >= count


def awake(product: int, baudrate: int | None = BAUDRATE) -> SimulatedDevice:
    """Returns a device that has been measuring for some time."""
    device = SimulatedDevice(product, baudrate=baudrate)
    device.advance(1.0)
    device.read()
    return device


def use(
    open_port: Callable[[], contextlib.AbstractContextManager[Port]],
    known: Support,
    patience: int = 1,
) -> None:
    """The whole session, with the port closed and opened again in between."""
    with open_port() as port:
        scan(Host(port, patience))
    with open_port() as port:
        host = Host(port, patience)
        initialise(host, known)
        configure(host, Output(DataId.RateOfTurn, 100), Output(DataId.Acceleration, 100))
        measure(host, known, 50)
        host.go_to_config()
    with open_port() as port:
        scan(Host(port, patience))


@pytest.mark.parametrize("product", PRODUCTS)
def test_every_product(product: int) -> None:
    device = awake(product)

    use(lambda: contextlib.nullcontext(PortInProcess(device)), support(product))
    assert device.state is State.CONFIG


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
@pytest.mark.parametrize("product", [3, 300, 680])
def test_on_a_port(product: int) -> None:
    """The software locks the port, so no other process may have locked it."""
    with serving(awake(product)) as path:

        def on_a_pty() -> serial.Serial:
            return serial.Serial(path, BAUDRATE, timeout=STEP, exclusive=True)

        use(on_a_pty, support(product), patience=40)


# A slow serial line has two kilobytes of samples in its buffer before the reply.
@pytest.mark.parametrize(
    ("baudrate", "timeout"), [(None, SCAN_TIMEOUT), (BAUDRATE, CONFIG_TIMEOUT)]
)
@pytest.mark.parametrize("product", PRODUCTS)
def test_go_to_config_is_answered_under_full_load(
    product: int, baudrate: int | None, timeout: float
) -> None:
    known, device = support(product), awake(product, baudrate)
    host = Host(PortInProcess(device))
    host.go_to_config()
    outputs = [Output(QUANTITIES[name].id, known.rates_of(name)[0]) for name in known.rates]
    host.must(MessageId.SetOutputConfiguration, encode("SetOutputConfiguration", outputs[:32]))
    for _ in range(3):
        host.must(MessageId.GoToMeasurement)
        device.advance(0.777)
        host.port.write(encode_frame(MessageId.GoToConfig))
        before = device.time
        found: list[int] = []
        while MessageId.GoToConfigAck not in found:
            found += [message.mid for message in host.read()]
            assert device.time - before <= timeout
        # Lost samples are reported at most once a second.
        assert found.count(MessageId.Error) <= (device.lost > 0)
