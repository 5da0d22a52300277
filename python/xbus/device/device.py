"""A device: a session, the link to it, and a clock."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator, Iterable, Iterator, Sequence
from dataclasses import replace
from types import TracebackType
from typing import TYPE_CHECKING, Any

import serial

from xbus.device.blocks import Blocks
from xbus.device.channel import Channel
from xbus.device.commands import Commands
from xbus.device.link import open_link
from xbus.device.output_configuration import (
    OutputConfiguration,
    check_outputs_fit,
    parse_output_configuration,
)
from xbus.device.ports import find_ports
from xbus.device.recording import Recording, configuration_frame
from xbus.device.sample import Sample
from xbus.device.session import Notice, Reply, Session
from xbus.device.settings import Applied, Settings, apply_plan, plan_settings, read_settings
from xbus.device.stats import LiveStats, by_name, live_stats
from xbus.device.string_output import BARE, check_strings_fit, plan_strings
from xbus.errors import DeviceError, StateError, XbusError, XbusTimeout
from xbus.protocol.configuration import Firmware
from xbus.protocol.ids import MessageId
from xbus.protocol.keys import Key
from xbus.protocol.products import Support, product_of_code, support
from xbus.protocol.tables import Product
from xbus.protocol.values import (
    ErrorCode,
    HardwareVersion,
    Output,
    PortConfig,
    PortProtocol,
    State,
    StringType,
    baud_code,
)
from xbus.rtk.forward import Forwarder
from xbus.wire.codec import encode_frame
from xbus.wire.link import Link
from xbus.wire.strings import String, mask_of

if TYPE_CHECKING:
    from xbus.sim.device import SimulatedDevice

__all__ = ["Device", "connect", "restore_communication"]

#: The order in which the vendor's software tries baud rates.
BAUDRATES = (115_200, 2_000_000, 921_600, 460_800, 230_400, 57_600, 38_400, 19_200, 9_600)
#: The rate of a restored device (section 7.2).
DEFAULT_BAUDRATE = 115_200

#: How long a device that measures may be silent, in seconds: the slowest rate is 1 Hz.
SILENCE = 5.0
#: Rates are told over so many seconds at least.
RATE_SPAN = 0.5
#: Bytes a second at 4 Mbaud, and the longest queue at that, in seconds: a gigabyte.
FASTEST, LONGEST_QUEUE = 400_000, 2500
#: How long a restart may take, until WakeUp. A USB port has to appear again.
RESTART = 5.0


class Device:
    """A device behind a port; made by `connect`.

    Iterating gives its samples as they come. Samples that come while a command waits for its answer are
    kept and given later.

    Attributes:
        device_id: Device identifier; None until identity has been read, which the first `configure` does.
        product_code: Product code, or None.
        firmware: Firmware revision, or None.
        hardware_version: Version of the hardware, or None.
        output_configuration: Output configuration in effect as last acknowledged, or None.

    >>> import xbus
    >>> with xbus.connect("sim:MTi-630") as device:
    ...     with device.configure() as cfg:
    ...         _ = cfg.set_output_configuration({"sample_time_fine": None, "acceleration": 100})
    ...     sample = next(iter(device))
    >>> list(sample), device.product.name
    (['sample_time_fine', 'acceleration'], 'MTi-630')
    """

    def __init__(
        self, link: Link, *, bid: int = 0xFF, reconnect: bool = False, strings: int = 0
    ) -> None:
        self._channel = Channel(link, Session(bid=bid, strings=strings), reconnect=reconnect)
        self.commands = Commands(self._channel)
        self.device_id: int | None = None
        self.product_code: str | None = None
        self.firmware: Firmware | None = None
        self.hardware_version: HardwareVersion | None = None
        self.output_configuration: tuple[Output, ...] | None = None
        self._outdated = 0
        #: When packets and strings were counted for the rates, and how many there were; and the rates.
        self._counted: tuple[float, dict[str, int]] = (link.clock(), {})
        self._rates: dict[str, float] = {}

    # What is known

    @property
    def link(self) -> Link:
        """What carries the bytes."""
        return self._channel.link

    @link.setter
    def link(self, link: Link) -> None:
        self._channel.link = link

    @property
    def session(self) -> Session:
        """What is known of the device."""
        return self._channel.session

    @property
    def notices(self) -> Sequence[Notice]:
        """Messages that nobody asked for, the latest 100: errors and warnings among them."""
        return self._channel.notices

    @property
    def lost_samples(self) -> int:
        """Samples that nobody read before a million others came, or before a new measurement began."""
        return self._channel.lost_samples + self._outdated

    def find(self, baudrates: Iterable[int]) -> None:
        """Listens and asks at one baud rate after the other, and stays at the first where something is heard.

        Raises:
            XbusTimeout: Nothing was heard at any of them.
        """
        self._channel.find(baudrates)

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

    # Commands

    def command(self, name: str, value: Any = None) -> Reply:
        """Sends a command by the manual's name and waits for its answer.

        Args:
            name: Name of the message, as in `xbus.protocol.tables.MESSAGES`.
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
        return self._channel.command(name, value)

    # State

    @contextlib.contextmanager
    def configure(
        self,
        output_configuration: OutputConfiguration | None = None,
        *,
        check_baudrate: bool = True,
    ) -> Iterator[Device]:
        """Config State for the length of a ``with`` block; then the state that the device was found in.

        The first time the identity of the device is read, too.

        Args:
            output_configuration: Output configuration to set, as `set_output_configuration` takes it.
            check_baudrate: See there.
        """
        if self.state == State.UNKNOWN:
            self._channel.find_state()
        found = self.state
        try:
            if found != State.CONFIG:
                self.go_to_config()
            self._identify()
            if output_configuration is not None:
                self.set_output_configuration(output_configuration, check_baudrate=check_baudrate)
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
        self._channel.device_id = self.device_id = self.commands.req_did()
        with contextlib.suppress(DeviceError):
            self.product_code = self.commands.req_product_code()
        with contextlib.suppress(DeviceError):
            self.firmware = self.commands.req_fw_rev()
        with contextlib.suppress(DeviceError):
            self.hardware_version = self.commands.req_hardware_version()
        if self.product_code is not None and (product := product_of_code(self.product_code)):
            self.session.identify(support(product, self.hardware_version))
            self._channel.timing.wrap = product.fine_wrap

    def go_to_config(self) -> None:
        """GoToConfig (0x30): enters Config State, or confirms it.

        A device that sends a lot, or has just woken up, may miss the message, so it is repeated every 0.2 s
        for 2 s.
        """
        self.command("GoToConfig")

    def go_to_measurement(self) -> None:
        """GoToMeasurement (0x10): enters Measurement State; what was measured before and not read is gone."""
        channel = self._channel
        self._outdated += len(channel.samples)
        channel.lost_strings += len(channel.strings)
        channel.samples.clear()
        channel.strings.clear()
        self.command("GoToMeasurement")

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
        if not self._channel.wait_for(self._is_waking, timeout, "WakeUpAck", reopen=True):
            raise XbusTimeout(
                f"no WakeUp from {self.link.name} within {timeout:g} s", "WakeUpAck", timeout
            )
        self.command("WakeUpAck")

    def _is_waking(self) -> bool:
        return self.state == State.WAKEUP

    # Output

    def set_output_configuration(
        self, output_configuration: OutputConfiguration, *, check_baudrate: bool = True
    ) -> tuple[Output, ...]:
        """SetOutputConfiguration (0xC0): what is measured, and how often.

        String output, which would overrule it, is switched off first.

        Args:
            output_configuration: Rates in Hz by quantity, such as
                ``{"acceleration": 400, ("quaternion", "NED", "Fp1632"): 100}``, with None for the highest
                rate or, for time stamps and status, every message; or a list of `Output`.
            check_baudrate: Whether the baud rate has to carry it; False where the port is no serial line.

        Returns:
            The lines in effect, as the device acknowledges them, which `Device.output_configuration` keeps.

        Raises:
            ValueError: More than 32 lines, a rate that the product cannot do, or more than the baud rate
                carries.
        """
        lines = parse_output_configuration(output_configuration)
        self.session.check_state("SetOutputConfiguration")
        self._identify()
        if (known := self.session.support) is not None:
            self.session.validate("SetOutputConfiguration", lines)
            if check_baudrate and self.link.is_line:
                check_outputs_fit(lines, known, self.link.baudrate)
            if known.string_types and self._strings_on():
                self.set_strings(())
        self.output_configuration = tuple(self.command("SetOutputConfiguration", lines).value)
        return self.output_configuration

    def _strings_on(self) -> StringType:
        """The strings that are on; firmware that does not know the question has none."""
        try:
            return self.commands.req_string_output_type().types
        except DeviceError as error:
            if error.code != ErrorCode.MESSAGE:
                raise
            return StringType(0)

    def set_strings(
        self,
        strings: Iterable[StringType | str],
        frequency: float | None = None,
        *,
        check_baudrate: bool = True,
    ) -> float | None:
        """Switches to string outputs, which take the place of MTData2; or, with none of them, back.

        On the 10- and 100-series SetPeriod and SetOutputSkipFactor make the rate, 115200 / (period (skip
        factor + 1)) with a period from 225 to 1152 (Tables 18 and 19); on the 600-series it goes with the
        types.

        Args:
            strings: Names, or `StringType` flags: ``["HEHDT", "GPGGA"]``.
            frequency: Hz; None: only when they are asked for, by `req_data`, which the 600-series cannot.
            check_baudrate: Whether the baud rate has to carry it; False where the port is no serial line.

        Returns:
            The rate in Hz; None where they come when they are asked for, or never.

        Raises:
            ValueError: A string or rate that the product cannot do, or more than the baud rate carries;
                nothing was sent.

        >>> import xbus
        >>> device = xbus.connect("sim:MTi-630")
        >>> with device.configure() as cfg:
        ...     cfg.set_strings(["HEHDT", "HEROT"], 100)
        100
        """
        self.session.check_state("SetStringOutputType")
        self._identify()
        plan = plan_strings(strings, frequency, self.session.support)
        if check_baudrate and self.link.is_line and self.session.support is not None:
            check_strings_fit(plan, self.session.support, self.link.baudrate)
        for name, value in plan.messages:
            self.session.validate(name, value)
        if plan.period is not None:
            self.commands.set_period(plan.period)
        if plan.skip_factor is not None:
            self.commands.set_output_skip_factor(plan.skip_factor)
        self.commands.set_string_output_type(plan.output.types, plan.output.frequency)
        return plan.frequency

    # Settings

    def settings(self) -> Settings:
        """All settings, read in Config State; the state is restored.

        What the product or its firmware does not have is None.

        >>> import xbus
        >>> xbus.connect("sim:MTi-3").settings().filter_profile
        'General'
        """
        with self.configure():
            return read_settings(self)

    def apply(
        self, settings: Settings, *, dry_run: bool = False, check_baudrate: bool = True
    ) -> Applied:
        """Sets what differs, each setting checked before anything is sent, and read back.

        What is None stays as it is. Ports come last and, like the CAN transceiver, take effect at the
        next reset. The state is restored.

        Args:
            settings: What the device is to have.
            dry_run: Whether to say only what would be set.
            check_baudrate: See `set_output_configuration`.

        Returns:
            What was set, and what the device has made of it where that is something else.

        Raises:
            ValueError: Something cannot be applied: a line for each, with key and reason. Nothing was sent.
            ApplyError: The device refused one, or is gone: what was applied and what not.

        >>> import xbus
        >>> device = xbus.connect("sim:MTi-630")
        >>> applied = device.apply(xbus.Settings(location_id=7))
        >>> print(applied.changes[0])
        - location_id = 0
        + location_id = 7
        """
        with self.configure():
            plan = plan_settings(self, settings, check_baudrate=check_baudrate)
            if plan.problems:
                raise ValueError("\n".join(plan.problems))
            return Applied(plan.changes) if dry_run else apply_plan(self, plan)

    # Corrections

    def forward_gnss(self, chunks: Iterable[bytes]) -> Forwarder:
        """Hands RTCM 3 corrections to the GNSS receiver with ForwardGnssData (0xE2), until there are no more.

        Read samples meanwhile: in another thread, or in the generator that makes the chunks.

        Args:
            chunks: Bytes, in pieces of any size; what is no RTCM 3 frame is not sent. A
                `xbus.device.Caster` gives them until it is closed.

        Returns:
            What counted the messages and bytes; see `Forwarder.forward` for what it raises.
        """
        forwarder = Forwarder(self)
        forwarder.forward(chunks)
        return forwarder

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
            ports = self.commands.req_port_config()
            self.commands.set_port_config(_at(it, code) for it in ports)
        else:
            self.command("SetBaudrate", code)
        self.command("Reset")
        self.link.baudrate = baudrate
        try:
            self.wake_up()
            self.commands.req_did()
        except XbusTimeout as timeout:
            self.link.baudrate = old
            if self._channel.find_state():
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
            self._channel.send(b"\xde", "restore_communication")
            self._channel.receive(0.0003, "restore_communication")
        self.command("WakeUpAck")

    def come_back(self) -> bool:
        """Tries once whether a device that was lost is there again, and brings it into the state it had then.

        For programs that go on without `connect`'s ``reconnect``. It takes a tenth of a second, and longer
        where something is there that does not answer; another device than before is left as it is.

        Returns:
            Whether it is there. `Device.notices` has the gap then.
        """
        return self._channel.come_back()

    # Samples

    def read_sample(self, timeout: float = SILENCE) -> Sample:
        """The next sample.

        Args:
            timeout: Seconds to wait for it.

        Raises:
            StateError: The device is in Config State, where it sends none.
            XbusTimeout: None came.
            Disconnected: The port is gone; what had come was given before.
        """
        self._channel.wait_for_samples(1, timeout)
        return self._channel.samples.popleft()

    def __iter__(self) -> Iterator[Sample]:
        while True:
            yield self.read_sample()

    def read_string(self, timeout: float = SILENCE) -> String:
        """The next string output: see `set_strings`.

        Samples and strings that come between each other are kept, and given each by its own call.

        Args:
            timeout: Seconds to wait for it.

        Raises:
            StateError: The device is in Config State, where it sends none.
            XbusTimeout: None came.
            Disconnected: The port is gone; what had come was given before.

        >>> import xbus
        >>> device = xbus.connect("sim:MTi-30")
        >>> with device.configure() as cfg:
        ...     rate = cfg.set_strings(["HCMTW"], 50)
        >>> device.read_string()
        <String $HCMTW,25.0,C*1F>
        """
        self._channel.wait_for_strings(timeout)
        return self._channel.strings.popleft()

    @property
    def lost_strings(self) -> int:
        """Strings that nobody read before 100,000 others came, or before a new measurement began."""
        return self._channel.lost_strings

    async def __aiter__(self) -> AsyncIterator[Sample]:
        waiting = self._channel.samples
        while True:
            if not waiting:
                await asyncio.to_thread(self._channel.wait_for_samples, 1, SILENCE)
            while waiting:  # a thread for each would cost more than the samples
                yield waiting.popleft()

    def blocks(
        self,
        *,
        seconds: float | None = None,
        samples: int | None = None,
        quantities: Iterable[Key] | None = None,
        timeout: float = SILENCE,
    ) -> Blocks:
        """Samples as they come, in blocks: each is a `Log` whose columns are arrays. Also for ``async for``.

        Times and counters go on from block to block, and `Log.host_time` is there; `Column.sample` and
        `Log.first_sample` count from the beginning of the first.

        Args:
            seconds: What comes in so many seconds is a block; or
            samples: so many samples are one.
            quantities: Names of the quantities to keep, or (name, coordinates); all of them if None.
            timeout: Seconds to wait for a sample.

        Raises:
            TypeError: Neither or both of seconds and samples.
            ValueError: A block of nothing, or a quantity that does not exist.
            XbusTimeout: Nothing came.
            Disconnected: The port is gone.

        >>> import xbus
        >>> device = xbus.connect("sim:MTi-630")
        >>> block = next(device.blocks(samples=50))
        >>> block["quaternion"].values.shape
        (50, 4)
        """
        return Blocks(
            self._channel,
            self.device_id,
            seconds=seconds,
            samples=samples,
            quantities=quantities,
            timeout=timeout,
        )

    @property
    def stats(self) -> LiveStats:
        """What was counted of the stream since the port was opened; asking costs microseconds."""
        counted = self.link.acquisition.stats()
        now, counts = self.link.clock(), by_name(counted["quantities"]) | counted["strings"]
        then, before = self._counted
        if now - then >= RATE_SPAN:
            self._rates = {
                name: (count - before.get(name, 0)) / (now - then) for name, count in counts.items()
            }
            self._counted = now, counts
        channel = self._channel
        unread, waiting = len(channel.samples), channel.waiting_bytes
        return live_stats(counted, self._rates, unread, channel.lost_samples, waiting)

    def record(
        self,
        path: str | os.PathLike[str],
        *,
        flush: float = 0.5,
        fsync: bool = False,
        rotate_bytes: int | None = None,
        rotate_seconds: float | None = None,
        times: bool = True,
        overwrite: bool = False,
    ) -> Recording:
        """Begins to record every byte that comes, until the recording is stopped.

        A thread writes, whatever the program does meanwhile. The file begins with Configuration, with
        date and time filled in, and EmtsData, as MT Manager's files do; a device that measures is in
        Config State for a moment to give them. After a crash it is readable up to the last flush. Where the
        port is lost and comes back, as with ``reconnect``, it goes on.

        Args:
            path: The first file; where it is rotated, ``log.mtb`` is followed by ``log-0001.mtb``, or by the
                next number that is free.
            flush: Most seconds until what has come is written.
            fsync: Whether the disk must have it each time, so that it survives a power cut.
            rotate_bytes: Begin another file when one has so many bytes.
            rotate_seconds: The same by time.
            times: Whether to write ``path + ".times"`` beside it, with the times at which the bytes came.
            overwrite: Whether a file that is there and not empty may be replaced.

        Raises:
            FileExistsError: It is there, and may not be overwritten.
            OSError: The file cannot be made.
            RuntimeError: A recording is under way.
            ValueError: A number makes no sense.
            XbusError: The device did not give what the file begins with.

        >>> import xbus, tempfile
        >>> device = xbus.connect("sim:MTi-630")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with device.record(f"{folder}/log.mtb"):
        ...         block = next(device.blocks(samples=100))
        ...     log = xbus.read_log(f"{folder}/log.mtb")
        >>> len(log) >= 100, log.product_code
        (True, 'MTi-630-8A1G6')
        """
        with self.configure():
            head = configuration_frame(self.command("ReqConfiguration").payload)
            # Not every device gives them, and files are readable without.
            with contextlib.suppress(DeviceError, StateError, XbusTimeout):
                strings = self.command("ReqStringOutputType")
                if strings.value.types & BARE:  # it tells them from noise, whoever reads the file
                    head += encode_frame(MessageId.ReqStringOutputTypeAck, strings.payload)
            with contextlib.suppress(DeviceError, StateError, XbusTimeout):
                head += encode_frame(MessageId.EmtsData, self.commands.req_emts())
            self.link.acquisition.record(
                path,
                head,
                flush,
                fsync,
                rotate_bytes,
                rotate_seconds,
                times,
                overwrite=overwrite,
            )
        return Recording(self.link.acquisition)

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
    reconnect: bool = False,
    queue_seconds: float = 60.0,
    strings: Iterable[StringType | str] = (),
) -> Device:
    """Opens the port of a device, and finds out in which state it is without changing it.

    It listens first, and asks only if nothing is heard.

    Args:
        port: Name of a serial port, a pyserial URL (``socket://host:port``, ``rfc2217://...``), a
            pyserial object, ``"sim:MTi-630"`` or a `SimulatedDevice`; None: the one port of this machine
            that says Xsens.
        baudrate: Bits per second; None: the rates that devices use are tried one after the other.
        bid: Bus identifier of the device; 0xFF and 1 are the same one.
        reconnect: Whether a device that is unplugged while its samples are read is waited for, and
            brought back into Measurement State; `Device.notices` has the gap then. It is known by its
            identifier once that has been read. Otherwise `Disconnected` is raised at once.
        queue_seconds: How long a program may read nothing and lose nothing, at 4 Mbaud; at a slower rate
            it is longer. What is older than that is dropped and counted then.
        strings: Strings to look for that nothing but their length tells from noise: ``["EM1000"]``. All
            others are found, and EM1000 too once the device was asked whether it is on.

    Raises:
        XbusTimeout: Nothing was heard.
        OSError: The port cannot be opened.
        ValueError: No port was named, and not just one says Xsens; or no string has that name.

    >>> import xbus
    >>> xbus.connect("sim:MTi-680G")
    <Device sim:MTi-680G at 115200 baud, product not read yet, measurement>
    """
    if not 0 < queue_seconds <= LONGEST_QUEUE:
        raise ValueError(f"queue_seconds must be from 0 to {LONGEST_QUEUE}, not {queue_seconds}")
    bound, mask = int(queue_seconds * FASTEST), mask_of(strings)
    port = _only_port() if port is None else port
    link = open_link(port, baudrate or DEFAULT_BAUDRATE, bound, mask)
    device = Device(link, bid=bid, reconnect=reconnect, strings=mask)
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
