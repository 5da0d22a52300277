"""A device: a session, the link to it, and a clock."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace
from types import TracebackType
from typing import TYPE_CHECKING, Any, NoReturn

import serial

from xbus.configuration import Firmware
from xbus.device.commands import Commands
from xbus.device.link import Link, open_link
from xbus.device.output import Outputs, check_fits, outputs_of
from xbus.device.ports import find_ports
from xbus.device.sample import Sample
from xbus.device.session import PROBE, Event, Notice, Refusal, Reply, Session
from xbus.errors import DeviceError, Disconnected, StateError, XbusError, XbusTimeout
from xbus.protocol.messages import ROWS
from xbus.protocol.products import Support, product_of_code, support
from xbus.protocol.values import HardwareVersion, Output, PortConfig, PortProtocol, State, baud_code
from xbus.tables import Product

if TYPE_CHECKING:
    from xbus.sim.device import SimulatedDevice

__all__ = ["Device", "connect", "restore_communication"]

#: The order in which the vendor's software tries baud rates.
BAUDRATES = (115_200, 2_000_000, 921_600, 460_800, 230_400, 57_600, 38_400, 19_200, 9_600)
#: The rate of a restored device (section 7.2).
DEFAULT_BAUDRATE = 115_200

#: Seconds to wait for the answer to a command, as the vendor's software does.
TIMEOUTS = {
    "SetBaudrate": 1.0,
    "RestoreFactoryDef": 2.0,
    "RunSelftest": 3.0,
    "IccCommand": 3.5,
    "ReqConfiguration": 5.0,
    "ReqEmts": 10.0,
}
TIMEOUT = 0.5
#: The 1-series takes about 0.9 s to write a setting to its memory.
TIMEOUT_SLOW = 2.0
#: GoToConfig may be missed while the device sends a lot, or has just woken up: once in 0.2 s, for 2 s.
CONFIG_TRIES, CONFIG_TIMEOUT = 10, 0.2
#: How long to listen for a device before asking, and how long for its answer.
LISTEN, ANSWER = 0.25, 0.35
#: How long after WakeUp it takes until samples come, if nobody answers it: 0.5 s (section 4), and some more.
WAKING = 1.5
#: How long a restart may take, until WakeUp. A USB port has to appear again.
RESTART = 5.0
#: Silence after which what is incomplete counts as damage.
QUIET = 0.1
#: Samples that are kept for who does not read them: a minute at 1 kHz.
KEPT = 60_000


class Device(Commands):
    """A device behind a port; made by `connect`.

    Iterating gives its samples as they come. Samples that come while a command waits for its answer are
    kept and given later.

    Attributes:
        session: What is known of the device.
        link: What carries the bytes.
        device_id: Device identifier; None until identity has been read, which the first `configure` does.
        product_code: Product code, or None.
        firmware: Firmware revision, or None.
        hardware: Version of the hardware, or None.
        outputs: Output configuration in effect as last acknowledged, or None.
        notices: Messages that nobody asked for, the latest 100: errors and warnings among them.
        lost_samples: Samples that nobody read before 60,000 others came, or before a new measurement began.

    >>> import xbus
    >>> with xbus.connect("sim:MTi-630") as device:
    ...     with device.configure() as cfg:
    ...         _ = cfg.set_output_configuration({"sample_time_fine": None, "acceleration": 100})
    ...     sample = next(iter(device))
    >>> list(sample), device.product.name
    (['sample_time_fine', 'acceleration'], 'MTi-630')
    """

    def __init__(self, link: Link, *, bid: int = 0xFF) -> None:
        self.link = link
        self.session = Session(bid=bid)
        self.device_id: int | None = None
        self.product_code: str | None = None
        self.firmware: Firmware | None = None
        self.hardware: HardwareVersion | None = None
        self.outputs: tuple[Output, ...] | None = None
        self.notices: deque[Notice] = deque(maxlen=100)
        self.lost_samples = 0
        self._samples: deque[Sample] = deque()
        self._events: deque[Event] = deque()
        self._heard_at = link.clock()
        self._broken = False

    # What is known

    @property
    def state(self) -> State:
        """State of the device, as far as it is known."""
        return self.session.state

    @property
    def support(self) -> Support | None:
        """What its product supports; None until identity has been read."""
        return self.session.support

    @property
    def product(self) -> Product | None:
        """The product; None until identity has been read, and where the manual does not describe it."""
        return self.session.support.product if self.session.support else None

    def __repr__(self) -> str:
        name = self.product_code or (self.product.name if self.product else "product not read yet")
        return f"<Device {self.link.name} at {self.link.baudrate} baud, {name}, {self.state}>"

    def find(self, baudrates: Iterable[int]) -> None:
        """Listens and asks at one baud rate after the other, and stays at the first where something is heard.

        Raises:
            XbusTimeout: Nothing was heard at any of them.
        """
        begun, tried = self.link.clock(), []
        for rate in baudrates:
            self.link.baudrate = rate
            if self._find_state():
                return
            tried.append(str(rate))
        raise XbusTimeout(
            f"nothing was heard on {self.link.name} at {', '.join(tried)} baud; is the device powered and"
            " connected, and does no other program (ModemManager?) use the port? restore_communication()"
            " brings back one that nobody can talk to",
            None,
            self.link.clock() - begun,
        )

    # Carrying bytes

    def _receive(self, timeout: float, command: str | None = None) -> None:
        """Takes in what has come, waiting for it no longer than so many seconds."""
        try:
            data = self.link.read(timeout)
        except OSError as error:
            self._lost(error, command)
        if data:
            self._heard_at = self.link.clock()
            events = self.session.receive(data)
        elif self.link.clock() - self._heard_at >= QUIET:
            events = self.session.quiet()
        else:
            events = []
        self._take(events)

    def _take(self, events: Iterable[Event]) -> None:
        for event in events:
            if isinstance(event, Sample):
                if len(self._samples) >= KEPT:
                    self._samples.popleft()
                    self.lost_samples += 1
                self._samples.append(event)
            elif isinstance(event, Notice):
                self.notices.append(event)
            else:
                self._events.append(event)

    def _send(self, data: bytes, command: str) -> None:
        try:
            self.link.write(data)
        except OSError as error:
            self._lost(error, command)

    def _lost(self, error: OSError, command: str | None) -> NoReturn:
        self._take(self.session.quiet())
        self.session.forget()
        self._broken = True
        what = f"while {command} was under way" if command else "while listening"
        raise Disconnected(
            f"{self.link.name} is gone, {what}: {error}; the next command tries to open it again",
            command,
        ) from error

    def _mend(self, command: str) -> None:
        """Opens the port again if it was lost."""
        if self._broken:
            try:
                self.link.reopen()
            except OSError as error:
                self._lost(error, command)
            self._broken = False

    # Commands

    def command(self, name: str, value: Any = None) -> Reply:
        """Sends a command by the manual's name and waits for its answer.

        Args:
            name: Name of the message, as in `xbus.tables.MESSAGES`.
            value: What it says, of the type of its layout; None where it carries nothing.

        Raises:
            StateError: Asked too early, or of the wrong product; nothing was sent.
            ValueError: No such command, or a value that does not fit; nothing was sent.
            DeviceError: The device answered Error.
            DecodeError: Its answer cannot be read.
            XbusTimeout: No answer came.
            Disconnected: The port is gone.

        >>> import xbus
        >>> device = xbus.connect("sim:MTi-300")
        >>> device.go_to_config()
        >>> device.command("ReqDID").payload.hex()
        '037003f8'
        """
        self._mend(name)
        if self.state == State.UNKNOWN and name not in ("GoToConfig", "Reset", PROBE):
            self._find_state()
        timeout, tries = self._patience(name)
        for _ in range(tries):
            frame = self.session.request(name, value)
            try:
                self._send(frame, name)
                if ROWS[name].reply is None:
                    return Reply(name, None, b"")
                if (answer := self._answer(name, timeout)) is not None:
                    break
            finally:
                self.session.abandon()  # after Ctrl-C, too: other commands would wait for ever
        else:
            waited = timeout * tries
            raise XbusTimeout(
                f"no answer to {name} from {self.link.name} within {waited:g} s; is the device powered, and"
                f" at {self.link.baudrate} baud?",
                name,
                waited,
            )
        if isinstance(answer, Refusal):
            raise answer.error
        return answer

    def _patience(self, name: str) -> tuple[float, int]:
        """How long to wait for an answer, and how often to ask."""
        if name == "GoToConfig":
            return CONFIG_TIMEOUT, CONFIG_TRIES
        slow = self.product is None or self.product.series == "1-series"
        return TIMEOUTS.get(name, TIMEOUT_SLOW if slow else TIMEOUT), 1

    def _answer(self, name: str, timeout: float) -> Reply | Refusal | None:
        """The answer to the pending command, or None if there is none in time."""
        until = self.link.clock() + timeout
        while True:
            while self._events:
                event = self._events.popleft()
                if isinstance(event, (Reply, Refusal)) and event.command == name:
                    return event
            left = until - self.link.clock()
            if left <= 0:
                return None
            self._receive(min(left, QUIET), name)

    # State

    def _listen(self, seconds: float) -> bool:
        """Whether anything that makes sense comes within so many seconds."""
        until = self.link.clock() + seconds
        notices = len(self.notices)
        while (left := until - self.link.clock()) > 0:
            self._receive(left)
            if self._samples or len(self.notices) > notices or self.state != State.UNKNOWN:
                return True
        return False

    def _find_state(self) -> bool:
        """Finds out the state without changing it: listens, then asks. Whether anything was heard."""
        heard = self._listen(LISTEN)
        if self.state == State.WAKEUP:
            # It goes on by itself, to Measurement State or, if told so, to Config State.
            until = self.link.clock() + WAKING
            while self.state == State.WAKEUP and (left := until - self.link.clock()) > 0:
                self._receive(left)
            if self.state == State.WAKEUP:
                self.session.forget()
        if self.state == State.UNKNOWN:
            self._send(self.session.request(PROBE), PROBE)
            answer = self._answer(PROBE, ANSWER)
            self.session.abandon()
            heard = heard or answer is not None or self.state != State.UNKNOWN
        return heard

    @contextlib.contextmanager
    def configure(
        self, output: Outputs | None = None, *, check_baudrate: bool = True
    ) -> Iterator[Device]:
        """Config State for the length of a ``with`` block; then the state that the device was found in.

        The first time the identity of the device is read, too.

        Args:
            output: Output configuration to set, as `set_output_configuration` takes it.
            check_baudrate: See there.
        """
        if self.state == State.UNKNOWN:
            self._mend("GoToConfig")
            self._find_state()
        found = self.state
        if found != State.CONFIG:
            self.go_to_config()
        try:
            self._identify()
            if output is not None:
                self.set_output_configuration(output, check_baudrate=check_baudrate)
            yield self
        except BaseException:
            # What went wrong inside matters more than that the way back is barred as well.
            with contextlib.suppress(XbusError):
                self._restore(found)
            raise
        self._restore(found)

    def _restore(self, found: State) -> None:
        if found == State.MEASUREMENT and self.state != State.MEASUREMENT:
            if self.state != State.CONFIG:
                self.go_to_config()
            self.go_to_measurement()

    def _identify(self) -> None:
        """Reads who it is, once. Very old firmware does not know all of these requests."""
        if self.session.support is not None or self.state != State.CONFIG:
            return
        self.device_id = self.req_did()
        with contextlib.suppress(DeviceError):
            self.product_code = self.req_product_code()
        with contextlib.suppress(DeviceError):
            self.firmware = self.req_fw_rev()
        with contextlib.suppress(DeviceError):
            self.hardware = self.req_hardware_version()
        if self.product_code is not None and (product := product_of_code(self.product_code)):
            self.session.identify(support(product, self.hardware))

    def go_to_measurement(self) -> None:
        """GoToMeasurement (0x10): enters Measurement State; what was measured before and not read is gone."""
        self.lost_samples += len(self._samples)
        self._samples.clear()
        super().go_to_measurement()

    def reset(self, *, config: bool = False) -> None:
        """Reset (0x40): starts the device anew. It wakes up, and goes to Measurement State by itself.

        Args:
            config: Whether to wait for WakeUp and lead it to Config State instead.
        """
        self.command("Reset")
        if config:
            self.wake_up()

    def wake_up(self, timeout: float = RESTART) -> None:
        """Waits for WakeUp (0x3E) and answers it with WakeUpAck: the device goes to Config State (section 4).

        Raises:
            XbusTimeout: It did not come.
        """
        until = self.link.clock() + timeout
        while self.state != State.WAKEUP:
            if (left := until - self.link.clock()) <= 0:
                raise XbusTimeout(
                    f"no WakeUp from {self.link.name} within {timeout:g} s", "WakeUpAck", timeout
                )
            self._receive(min(left, QUIET), "WakeUpAck")
        self.command("WakeUpAck")

    # Output

    def set_output_configuration(
        self, outputs: Outputs, *, check_baudrate: bool = True
    ) -> tuple[Output, ...]:
        """SetOutputConfiguration (0xC0): what is measured, and how often.

        String output, which would overrule it, is switched off first.

        Args:
            outputs: Rates in Hz by quantity, ``{"acceleration": 400, ("quaternion", "NED", "Fp1632"):
                100}``, None for the highest rate and for what comes with every message; or lines as the
                message has them.
            check_baudrate: Whether the baud rate has to carry it; False where the port is no serial line.

        Returns:
            The lines in effect, as the device acknowledges them, which `Device.outputs` keeps.

        Raises:
            ValueError: More than 32 lines, a rate that the product cannot do, or more than the baud rate
                carries.
        """
        lines = outputs_of(outputs)
        self.session.check_state("SetOutputConfiguration")
        self._identify()
        if (known := self.session.support) is not None:
            self.session.validate("SetOutputConfiguration", lines)
            if check_baudrate and self.link.is_line:
                check_fits(lines, known, self.link.baudrate)
            if known.string_types and self.req_string_output_type().types:
                self.set_string_output_type(0, 0 if known.product.series == "600-series" else None)
        self.outputs = tuple(self._ask("SetOutputConfiguration", lines))
        return self.outputs

    # Baud rate

    def set_baudrate(self, baudrate: int) -> None:
        """Changes the baud rate of both sides: sets it, resets the device, and follows it to the new rate.

        The device is in Config State afterwards. On the 600-series, which has SetPortConfig for it, the
        rate of each port that speaks Xbus is set; on the others SetBaudrate.

        Raises:
            ValueError: The product cannot talk at that rate.
            XbusTimeout: It did not come back; the message says whether it still talks at the old rate.
        """
        code = baud_code(baudrate)
        self.session.check_state("SetBaudrate")
        self._identify()
        self.session.validate("SetBaudrate", code)
        old = self.link.baudrate
        if self.support is not None and "SetPortConfig" in self.support.messages:
            ports = self.req_port_config()
            self.set_port_config(_at(it, code) for it in ports)
        else:
            self.command("SetBaudrate", code)
        self.command("Reset")
        self.link.baudrate = baudrate
        try:
            self.wake_up()
            self.req_did()
        except XbusTimeout as timeout:
            self.link.baudrate = old
            if self._find_state():
                text = f"the device did not change to {baudrate} baud: it still talks at {old}"
            else:
                self.link.baudrate = baudrate
                text = f"the device came back neither at {baudrate} nor at {old} baud; power it off and on"
            raise XbusTimeout(text, "SetBaudrate", timeout.waited) from timeout

    def restore_communication(self, timeout: float = 30.0) -> None:
        """Brings back a device that nobody can talk to, by the procedure of section 7.2.

        Call it, and power the device off and on while it runs. Output configuration, baud rate (115200) and
        synchronization have their defaults then (Table 41), and the device is in Config State. It does
        not work over the USB port of the device itself, where plugging in anew is enough.

        Args:
            timeout: Seconds to wait for the device.

        Raises:
            XbusTimeout: It did not wake up.
        """
        self._mend("restore_communication")
        self.session.forget()
        self.link.baudrate = DEFAULT_BAUDRATE
        until = self.link.clock() + timeout
        while self.state != State.WAKEUP:
            if self.link.clock() > until:
                raise XbusTimeout(
                    f"no device woke up within {timeout:g} s; it must be powered off and on meanwhile",
                    "restore_communication",
                    timeout,
                )
            # 0.1 to 0.5 ms between two bytes, which is the time that this waits for an answer.
            self._send(b"\xde", "restore_communication")
            self._receive(0.0003, "restore_communication")
        self.command("WakeUpAck")

    # Samples

    def read_sample(self, timeout: float = 5.0) -> Sample:
        """The next sample.

        Args:
            timeout: Seconds to wait for it.

        Raises:
            StateError: The device is in Config State, where it sends none.
            XbusTimeout: None came.
            Disconnected: The port is gone; what had come was given before.
        """
        until = self.link.clock() + timeout
        while not self._samples:
            if self.state == State.CONFIG:
                raise StateError(
                    "the device is in Config State and measures nothing; go_to_measurement() changes that",
                    "read_sample",
                    self.state,
                )
            if (left := until - self.link.clock()) <= 0:
                raise XbusTimeout(
                    f"no sample from {self.link.name} within {timeout:g} s", None, timeout
                )
            self._mend("read_sample")
            self._receive(left)
        return self._samples.popleft()

    def __iter__(self) -> Iterator[Sample]:
        while True:
            yield self.read_sample()

    # End

    def close(self) -> None:
        """Closes the port; the device is left in the state that it is in."""
        self.link.close()

    def __enter__(self) -> Device:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def connect(
    port: str | serial.SerialBase | SimulatedDevice | None = None,
    baudrate: int | None = None,
    *,
    bid: int = 0xFF,
) -> Device:
    """Opens the port of a device, and finds out in which state it is without changing it.

    It listens first, and asks only if nothing is heard.

    Args:
        port: Name of a serial port, a pyserial URL (``socket://host:port``, ``rfc2217://...``), a
            pyserial object, ``"sim:MTi-630"`` or a `SimulatedDevice`; None: the one port of this machine
            that says Xsens.
        baudrate: Bits per second; None: the rates that devices use are tried one after the other.
        bid: Bus identifier of the device; 0xFF and 1 are the same one.

    Raises:
        XbusTimeout: Nothing was heard.
        OSError: The port cannot be opened.
        ValueError: No port was named, and not just one says Xsens.

    >>> import xbus
    >>> xbus.connect("sim:MTi-680G")
    <Device sim:MTi-680G at 115200 baud, product not read yet, measurement>
    """
    link = open_link(_only_port() if port is None else port, baudrate or DEFAULT_BAUDRATE)
    device = Device(link, bid=bid)
    rates = BAUDRATES if link.is_line else (link.baudrate,)
    try:
        device.find((baudrate,) if baudrate else rates)
    except BaseException:
        device.close()
        raise
    return device


def restore_communication(
    port: str | serial.SerialBase | SimulatedDevice, timeout: float = 30.0, *, bid: int = 0xFF
) -> Device:
    """Opens the port of a device that does not answer, and restores it: see `Device.restore_communication`.

    Args:
        port: As for `connect`.
        timeout: Seconds to wait until somebody has powered the device off and on.
        bid: As for `connect`.

    Raises:
        XbusTimeout: It did not wake up.
        OSError: The port cannot be opened.
    """
    device = Device(open_link(port, DEFAULT_BAUDRATE), bid=bid)
    try:
        device.restore_communication(timeout)
    except BaseException:
        device.close()
        raise
    return device


def _only_port() -> str:
    ports = find_ports()
    likely = [it.device for it in ports if it.likely]
    if len(likely) == 1:
        return likely[0]
    names = ", ".join(likely or [it.device for it in ports]) or "none"
    which = "several ports say Xsens" if likely else "no port says Xsens"
    raise ValueError(f"{which}; name one of: {names} (a virtual device is at 'sim:MTi-630')")


def _at(port: PortConfig, code: int) -> PortConfig:
    return replace(port, baud_code=code) if port.protocol == PortProtocol.XBUS else port
