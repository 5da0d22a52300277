"""A device: typed commands, settings, samples, blocks and recordings over a link."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import count
from typing import Any

from xbus.can.ids import DeviceIds
from xbus.can.link import CanLink
from xbus.device.baudrate import change_baudrate, restart
from xbus.device.blocks import Blocks
from xbus.device.can_output import (
    CanConfiguration,
    can_baud_code,
    check_bus_load,
    parse_can_configuration,
)
from xbus.device.channel import Channel, Trace
from xbus.device.commands import Commands
from xbus.device.events import Notice, Reply
from xbus.device.mtdata_output import check_mtdata_fits, mtdata_outputs, plan_mtdata
from xbus.device.output_configuration import (
    OutputConfiguration,
    check_outputs_fit,
    parse_output_configuration,
)
from xbus.device.reader import Reader
from xbus.device.recording import Recording, heard_head, recording_head
from xbus.device.sample import Sample
from xbus.device.session import Session
from xbus.device.settings import Applied, Settings, apply_plan, plan_settings, read_settings
from xbus.device.stats import LiveStats, live_stats
from xbus.device.string_output import check_strings_fit, plan_strings
from xbus.errors import DecodeError, DeviceError, XbusTimeout
from xbus.log.identity import Identity
from xbus.protocol.configuration import Firmware
from xbus.protocol.keys import Key
from xbus.protocol.products import (
    DEFAULT_BAUDRATE,
    Support,
    legacy_product,
    product_of_code,
    support,
)
from xbus.protocol.tables import Product
from xbus.protocol.values import (
    CanConfig,
    CanOutput,
    ErrorCode,
    HardwareVersion,
    Output,
    State,
    StringType,
)
from xbus.rtk.forward import Forwarder
from xbus.wire.link import Link, line_rate
from xbus.wire.strings import String

__all__ = ["Device"]

#: Seconds without a sample after which reading gives up. The slowest output rate is 1 Hz.
SAMPLE_TIMEOUT = 5.0
#: Seconds until WakeUp after a reset. A USB port disappears meanwhile.
WAKE_UP_TIMEOUT = 5.0
#: Number of samples after which ``async for`` lets other tasks run, even if more samples wait.
SAMPLES_PER_TURN = 100
#: Pause between two bytes of the restore procedure, in seconds; the manual allows 0.1 to 0.5 ms.
RESTORE_PAUSE = 0.0003


class Device:
    """A device behind a port; made by `connect`.

    Iterating yields samples. Samples that arrive while a command waits for its answer are kept for later.

    Attributes:
        commands: The raw commands of the manual, one method per message.
        hardware_version: Hardware version; None until the first `configure` reads the identity.
        output_configuration: Output configuration that the device acknowledged last, or None.

    >>> import xbus
    >>> with xbus.connect("sim:MTi-630") as device:
    ...     with device.configure() as cfg:
    ...         outputs = cfg.set_output_configuration({"sample_time_fine": None, "acceleration": 100})
    ...     sample = next(iter(device))
    >>> list(sample), device.product.name
    (['sample_time_fine', 'acceleration'], 'MTi-630')
    """

    def __init__(self, link: Link, *, listen: bool = False, reconnect: bool = False) -> None:
        self._channel = Channel(link, listen=listen, reconnect=reconnect)
        self._reader = Reader(self._channel)
        self.commands = Commands(self._channel)
        self.hardware_version: HardwareVersion | None = None
        self.output_configuration: tuple[Output, ...] | None = None

    # Connection and state

    @property
    def link(self) -> Link:
        """The link to the device: a port, a bus, or a virtual device."""
        return self._channel.link

    @property
    def is_listening(self) -> bool:
        """Whether the port was opened only to listen, so that nothing is ever sent."""
        return self._channel.is_listening

    def trace(self, trace: Trace | None) -> None:
        """Makes an object follow the messages between host and device; None ends that."""
        self._channel.trace = trace

    @property
    def session(self) -> Session:
        """The protocol state, without port, clock or thread."""
        return self._channel.session

    @property
    def state(self) -> State:
        """The state of the device, if it is known."""
        return self._channel.state

    @property
    def support(self) -> Support | None:
        """What the product supports; None until the identity is read."""
        return self.session.support

    @property
    def product(self) -> Product | None:
        """The product; None until the identity is read, and for a product that is not in the manual."""
        return self.session.support.product if self.session.support else None

    @property
    def device_id(self) -> int | None:
        """Device identifier; None until the first `configure` reads the identity, or the device sends it."""
        return self._identity.device_id

    @property
    def product_code(self) -> str | None:
        """Product code, or None."""
        return self._identity.product_code

    @property
    def firmware(self) -> Firmware | None:
        """Firmware revision, or None."""
        return self._identity.firmware

    @property
    def _identity(self) -> Identity:
        self._channel.handle_events()
        return self._channel.identity

    @property
    def notices(self) -> Sequence[Notice]:
        """The latest 100 messages that answer no command, errors and warnings among them."""
        self._channel.handle_events()
        return self._channel.notices

    def find_baudrate(self, baudrates: Iterable[int | None], *, restart: bool = False) -> None:
        """Tries one baud rate after the other, and keeps the first at which it hears the device.

        Args:
            baudrates: The rates to try, in bits per second; None for a port that has none.
            restart: Whether to count nothing that arrives at the rates before: it is noise.

        Raises:
            XbusTimeout: Nothing was heard at any of them.
        """
        self._channel.find(baudrates, restart=restart)

    def try_reconnect(self) -> bool:
        """Tries once to reach a device that was lost, and restores the state that it had.

        For programs that do not use ``reconnect`` of `connect`. An attempt takes 0.1 s, or longer if
        something is there that does not answer. A device with another identifier is left as it is.

        Returns:
            Whether the device is back; `notices` then has the length of the gap.
        """
        return self._channel.try_reconnect()

    def close(self) -> None:
        """Closes the port, and ends all waits with Disconnected. The device stays in its state."""
        self._channel.connection.close()
        self._reader.close()

    def __enter__(self) -> Device:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        name = self.product_code or (self.product.name if self.product else "product not read yet")
        rate = "" if self.link.baudrate is None else f" at {self.link.baudrate} baud"
        return f"<Device {self.link.name}{rate}, {name}, {self.state}>"

    def command(self, name: str, value: Any = None) -> Reply:
        """Sends a command by the manual's name and returns its answer.

        Args:
            name: Name of the message, as in `xbus.protocol.tables.MESSAGES`.
            value: The content of the message, as `xbus.protocol.encode` takes it; None if it has none.

        Raises:
            StateError: The state or the product does not accept the command; nothing was sent.
            ValueError: There is no such command, or the value does not fit; nothing was sent.
            DeviceError: The device answered Error.
            DecodeError: The answer cannot be decoded.
            XbusTimeout: No answer came.
            Disconnected: The port is gone.

        >>> import xbus
        >>> device = xbus.connect("sim:MTi-300")
        >>> device.go_to_config()
        >>> device.command("ReqDID").payload.hex()
        '037003f8'
        """
        return self._channel.command(name, value)

    def send(self, data: bytes) -> None:
        """Sends bytes as they are. Messages that answer them are in `notices`.

        Raises:
            Disconnected: The port is gone.
        """
        self._channel.send(data, "send")

    def listen(self, seconds: float) -> None:
        """Handles the messages that arrive within some seconds. Samples and strings stay unread.

        Raises:
            Disconnected: The port is gone.
        """
        self._channel.wait_for(lambda: False, seconds)

    @contextlib.contextmanager
    def configure(
        self,
        output_configuration: OutputConfiguration | None = None,
        *,
        check_baudrate: bool = True,
    ) -> Iterator[Device]:
        """Enters Config State for a ``with`` block, then restores the state in which the device was found.

        Readers in other threads wait meanwhile. Several threads may configure a device at a time: the last
        one restores the state.

        The block receives the device itself: in ``with device.configure() as cfg``, `cfg` is a short name for
        `device`. The first call also reads the identity of the device.

        Args:
            output_configuration: Outputs to set, as `set_output_configuration` takes them.
            check_baudrate: As for `set_output_configuration`.

        >>> import xbus
        >>> device = xbus.connect("sim:MTi-630")
        >>> with device.configure({"acceleration": 100}) as cfg:
        ...     cfg.commands.set_location_id(7)
        >>> device.product_code
        'MTi-630-8A1G6'
        """
        with self._channel.configuring():
            self._identify()
            if output_configuration is not None:
                self.set_output_configuration(output_configuration, check_baudrate=check_baudrate)
            yield self

    def _identify(self) -> None:
        """Reads the identity, once. Very old firmware does not know all of these requests."""
        if self.session.support is not None or self.state != State.CONFIG:
            return
        # The channel keeps the answers.
        device_id = self.commands.req_did()
        for request in (self.commands.req_product_code, self.commands.req_fw_rev):
            with contextlib.suppress(DeviceError):
                request()
        with contextlib.suppress(DeviceError):
            self.hardware_version = self.commands.req_hardware_version()
        product = product_of_code(self.product_code or "")
        if product is None and self._lacks_mtdata2():
            product = legacy_product(device_id, self.product_code)
        if product is not None:
            self.session.identify(support(product, self.hardware_version))

    def _lacks_mtdata2(self) -> bool:
        """Returns whether the device does not know output configurations: it sends MTData."""
        try:
            self.commands.req_output_configuration()
        except DeviceError as error:
            return error.code == ErrorCode.MESSAGE
        return False

    def go_to_config(self) -> None:
        """GoToConfig (0x30): enters Config State, or confirms it.

        A device that sends a lot, or has just woken up, may miss the message, so it is repeated every 0.2 s
        for 2 s.
        """
        self.command("GoToConfig")

    def go_to_measurement(self) -> None:
        """GoToMeasurement (0x10): enters Measurement State.

        If settings have changed, samples and strings that were not read before are removed;
        `LiveStats.outdated` counts them.
        """
        self.command("GoToMeasurement")

    def reset(self, *, config: bool = False) -> None:
        """Reset (0x40): restarts the device. It wakes up, and goes to Measurement State by itself.

        Args:
            config: Whether to wait for WakeUp and enter Config State instead.
        """
        self.command("Reset")
        if config:
            self.wake_up()

    def wake_up(self, timeout: float = WAKE_UP_TIMEOUT) -> None:
        """Waits for WakeUp (0x3E) and answers it with WakeUpAck: the device enters Config State (section 4).

        Args:
            timeout: Seconds to wait.

        Raises:
            XbusTimeout: The message did not come.
        """
        if not self._channel.wait_for(self._is_waking, timeout, "WakeUpAck", reopen=True):
            raise XbusTimeout(
                f"no WakeUp from {self.link.name} within {timeout:g} s; power the device off and on; if it"
                f" still does not answer, xbus restore {self.link.name} recovers it",
                "WakeUpAck",
                timeout,
            )
        self.command("WakeUpAck")

    def _is_waking(self) -> bool:
        return self.state == State.WAKEUP

    def set_baudrate(self, baudrate: int) -> None:
        """Changes the baud rate of the device and of the port: sets it, resets the device, and follows it.

        The device is in Config State afterwards. On the 600-series, which has SetPortConfig for it, the
        rate of each port that speaks Xbus is set; on the others SetBaudrate.

        Args:
            baudrate: Bits per second.

        Raises:
            ValueError: The product does not have the rate, or the port is not a serial port.
            XbusTimeout: The device did not come back; the message says whether it still uses the old rate.
        """
        self.session.check_state("SetBaudrate")
        self._identify()
        change_baudrate(self, baudrate)

    def restore_factory_settings(self) -> None:
        """Restores the factory defaults (RestoreFactoryDef, section 7.1), and restarts the device with them.

        The baud rate becomes 115200, and the port follows. The device is in Config State afterwards. All
        settings are lost: `settings` reads them before.

        Raises:
            XbusTimeout: The device did not come back; the message says what to do.

        >>> import xbus
        >>> device = xbus.connect("sim:MTi-630")
        >>> with device.configure() as cfg:
        ...     cfg.commands.set_location_id(7)
        ...     cfg.restore_factory_settings()
        ...     cfg.commands.req_location_id()
        0
        """
        self.commands.restore_factory_def()
        self.output_configuration = None
        rate = None if self.link.baudrate is None else DEFAULT_BAUDRATE
        restart(self, rate, "RestoreFactoryDef")

    def restore_communication(self, timeout: float = 30.0) -> None:
        """Recovers a device that answers at no baud rate, with the procedure of section 7.2.

        Call it, and power the device off and on while it runs. Output configuration, baud rate (115200) and
        synchronization then have their defaults (Table 41), and the device is in Config State. The
        procedure does not work over the USB port of the device itself; there, plug it in again.

        Args:
            timeout: Seconds to wait for the device.

        Raises:
            XbusTimeout: No device woke up.
            ValueError: The port is not a serial port.
        """
        if self.link.baudrate is None:
            raise ValueError(
                f"{self.link.name} has no baud rate to restore; the procedure needs a serial line"
            )
        self._channel.forget_state()
        self.link.baudrate = DEFAULT_BAUDRATE
        until = self.link.clock() + timeout
        while self.state != State.WAKEUP:
            if self.link.clock() > until:
                raise XbusTimeout(
                    f"no device woke up within {timeout:g} s; power it off and on during the procedure",
                    "restore_communication",
                    timeout,
                )
            self._channel.send(b"\xde", "restore_communication")
            self._channel.wait_for(self._is_waking, RESTORE_PAUSE, "restore_communication")
        self.command("WakeUpAck")

    # Outputs

    def set_output_configuration(
        self, output_configuration: OutputConfiguration, *, check_baudrate: bool = True
    ) -> tuple[Output, ...]:
        """SetOutputConfiguration (0xC0): sets the outputs and their rates.

        Strings, which would replace the outputs, are switched off first.

        Legacy devices, which send MTData, get OutputMode, OutputSettings and a rate instead. They send all
        quantities at one rate, in one precision, and orientation and velocity in one of NWU (the default) and
        NED.

        Args:
            output_configuration: Rates in Hz by quantity, such as
                ``{"acceleration": 400, ("quaternion", "NED", "Fp1632"): 100}``, with None for the highest
                rate or, for time stamps and status, every message; or a list of `Output`.
            check_baudrate: Whether the baud rate must carry the outputs; False for a port without a rate.

        Returns:
            The outputs in effect, as the device acknowledges them; also in `output_configuration`.

        Raises:
            DecodeError: A legacy device sends messages of another length than its settings give.
            ValueError: More than 32 outputs, a rate that the product does not have, more data than the baud
                rate carries, or a choice that MTData cannot hold.
        """
        if not isinstance(output_configuration, Mapping):
            output_configuration = tuple(output_configuration)
        outputs = parse_output_configuration(output_configuration)
        self.session.check_state("SetOutputConfiguration")
        self._identify()
        if self.support is not None and self.support.is_legacy:
            return self._set_mtdata(
                output_configuration, self.support, check_baudrate=check_baudrate
            )
        if (known := self.session.support) is not None:
            self.session.validate("SetOutputConfiguration", outputs)
            if check_baudrate and (rate := line_rate(self.link)) is not None:
                check_outputs_fit(outputs, known, rate)
            if known.string_types and self._enabled_strings():
                self.set_strings(())
        self.output_configuration = tuple(self.command("SetOutputConfiguration", outputs).value)
        return self.output_configuration

    def _set_mtdata(
        self, configuration: OutputConfiguration, known: Support, *, check_baudrate: bool
    ) -> tuple[Output, ...]:
        """Sets OutputMode, OutputSettings and the rate of a legacy device."""
        plan = plan_mtdata(configuration, known)
        for name, value in plan.messages:
            self.session.validate(name, value)
        if check_baudrate and (rate := line_rate(self.link)) is not None:
            check_mtdata_fits(plan, known, rate)
        for name, value in plan.messages:
            self.command(name, value)
        # Firmware may not have all of the bits.
        mode, settings = self.commands.req_output_mode(), self.commands.req_output_settings()
        plan = replace(plan, mode=mode, settings=settings)
        if (length := self.commands.req_data_length()) != plan.size:
            raise DecodeError(
                f"the device sends {length} bytes of MTData, and output mode {mode:04X} and settings"
                f" {int(settings):08X} give {plan.size}: samples cannot be decoded",
                0,
                command="ReqDataLength",
            )
        self.output_configuration = mtdata_outputs(plan)
        return self.output_configuration

    def set_can_output_configuration(
        self,
        output_configuration: CanConfiguration,
        *,
        baudrate: int | None = None,
        ids: DeviceIds | None = None,
    ) -> tuple[CanOutput, ...]:
        """SetCanOutputConfig (0xE8) and SetCanConfig (0xE6): sets the outputs on the CAN bus.

        It also switches CAN on, or off without outputs. The bit rate takes effect at the next reset.

        Args:
            output_configuration: Rates in Hz by quantity or CAN message, such as
                ``{"sample_time_fine": None, "packet_counter": None, "acceleration": 100}``, with None for the
                highest rate or, for time stamps and status, every group; or a list of `CanOutput`.
            baudrate: Bits per second of the bus; None for the present setting, 250,000 in a new device.
            ids: CAN identifiers of the device, as in `xbus.read_can`; None for the default ones.

        Returns:
            The outputs in effect, as the device acknowledges them.

        Raises:
            ValueError: There is no such quantity, the product or CAN does not have it at this rate, or the
                outputs take more than all of the bus. Nothing was changed.
        """
        outputs = parse_can_configuration(output_configuration, ids)
        self.session.check_state("SetCanOutputConfig")
        self._identify()
        present = self.commands.req_can_config()
        self.session.validate("SetCanOutputConfig", outputs)
        code = present.baud_code if baudrate is None else can_baud_code(baudrate)
        check_bus_load(outputs, code)
        found = self.commands.set_can_output_config(outputs)
        self.commands.set_can_config(
            CanConfig(code, enabled=bool(outputs), reserved=present.reserved)
        )
        return found

    def _enabled_strings(self) -> StringType:
        """Returns the strings that the device sends; firmware that does not know the request sends none."""
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
        """Switches to strings, which replace MTData2; or back, without any.

        On the 10- and 100-series, SetPeriod and SetOutputSkipFactor define the rate: 115200 / (period (skip
        factor + 1)), with a period from 225 to 1152 (Tables 18 and 19). On the 600-series the message with
        the types has the rate.

        Args:
            strings: Names or `StringType` flags: ``["HEHDT", "GPGGA"]``.
            frequency: Rate in Hz. None: strings come only on request, by `commands.req_data`, which the
                600-series does not support.
            check_baudrate: Whether the baud rate must carry the strings; False for a port without a rate.

        Returns:
            The rate in Hz; None if strings come on request, or never.

        Raises:
            ValueError: The product does not have the string or rate, or the baud rate does not carry it;
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
        rate = line_rate(self.link) if check_baudrate else None
        if rate is not None and self.session.support is not None:
            check_strings_fit(plan, self.session.support, rate)
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
        """Returns all settings, read in Config State; the state is restored.

        A setting that the product or its firmware does not have is None.

        >>> import xbus
        >>> xbus.connect("sim:MTi-3").settings().filter_profile
        'General'
        """
        with self.configure():
            return read_settings(self)

    def apply(
        self,
        settings: Settings,
        *,
        dry_run: bool = False,
        check_baudrate: bool = True,
        force: bool = False,
    ) -> Applied:
        """Sets the settings that differ. All are checked before anything is sent, and each is read back.

        A setting that is None stays as it is. Ports come last and, like the CAN transceiver, take effect at
        the next reset. The state is restored.

        Args:
            settings: The settings that the device should have.
            dry_run: Whether to return what would be set, and set nothing.
            check_baudrate: As for `set_output_configuration`.
            force: Whether to accept settings of another product, and to leave out those that this device
                cannot have.

        Returns:
            What was set, and the settings for which the device took another value.

        Raises:
            ValueError: Something cannot be applied: one line each, with key and reason. Nothing was sent.
            ApplyError: The device refused a setting, or is gone: what was applied and what not.

        >>> import xbus
        >>> device = xbus.connect("sim:MTi-630")
        >>> applied = device.apply(xbus.Settings(location_id=7))
        >>> print(applied.changes[0])
        - location_id = 0
        + location_id = 7
        """
        with self.configure():
            plan = plan_settings(self, settings, check_baudrate=check_baudrate, force=force)
            if plan.problems:
                raise ValueError("\n".join(plan.problems))
            if dry_run:
                return Applied(plan.changes, skipped=plan.skipped)
            return apply_plan(self, plan)

    def forward_gnss(self, chunks: Iterable[bytes]) -> Forwarder:
        """Sends RTCM 3 corrections to the GNSS receiver with ForwardGnssData (0xE2), until `chunks` ends.

        Read samples meanwhile: in another thread, or in the generator that makes the chunks.

        Args:
            chunks: Bytes, in pieces of any size, such as an open `xbus.rtk.Caster`. Bytes outside RTCM 3
                frames are not sent.

        Returns:
            The counts of messages and bytes.

        Raises:
            XbusError: As `xbus.rtk.Forwarder.forward` does.
        """
        forwarder = Forwarder(self)
        forwarder.forward(chunks)
        return forwarder

    # Data

    def read_sample(self, timeout: float = SAMPLE_TIMEOUT) -> Sample:
        """Returns the next sample.

        Args:
            timeout: Seconds to wait for it.

        Raises:
            StateError: The device is in Config State, in which it sends no samples.
            XbusTimeout: No sample came.
            Disconnected: The port is gone, and all samples from before are read.
        """
        while (sample := self._reader.take_sample()) is None:
            self._reader.wait_for_samples(1, timeout)
        return sample

    def __iter__(self) -> Iterator[Sample]:
        reader = self._reader
        while True:
            while (sample := reader.take_sample()) is None:
                reader.wait_for_samples(1, SAMPLE_TIMEOUT)
            yield sample

    async def __aiter__(self) -> AsyncIterator[Sample]:
        reader = self._reader
        wait = partial(reader.wait_for_samples, 1, SAMPLE_TIMEOUT)
        for number in count(1):
            while (sample := reader.take_sample()) is None:
                await reader.wait_async(wait)
            yield sample
            if number % SAMPLES_PER_TURN == 0:
                await asyncio.sleep(0)

    def read_string(self, timeout: float = SAMPLE_TIMEOUT) -> String:
        """Returns the next string: see `set_strings`.

        Samples and strings have separate queues: reading one leaves the other.

        Args:
            timeout: Seconds to wait for it.

        Raises:
            StateError: The device is in Config State, in which it sends no strings.
            XbusTimeout: No string came.
            Disconnected: The port is gone, and all strings from before are read.

        >>> import xbus
        >>> device = xbus.connect("sim:MTi-30")
        >>> with device.configure() as cfg:
        ...     rate = cfg.set_strings(["HCMTW"], 50)
        >>> device.read_string()
        <String $HCMTW,25.0,C*1F>
        """
        while (string := self._reader.take_string()) is None:
            self._reader.wait_for_strings(timeout)
        return string

    def blocks(
        self,
        *,
        seconds: float | None = None,
        samples: int | None = None,
        quantities: Iterable[Key] | None = None,
        timeout: float = SAMPLE_TIMEOUT,
    ) -> Blocks:
        """Returns an iterator over blocks of samples: each is a `Log` with columns. Also for ``async for``.

        Times and counters continue from block to block. `Column.sample` and `Log.first_sample` count from the
        first block. `Log.host_time` is set.

        Args:
            seconds: Length of a block in seconds. Give either this or `samples`.
            samples: Length of a block in samples.
            quantities: Names of the quantities to keep, or (name, coordinates); None keeps all.
            timeout: Seconds to wait for a sample.

        Raises:
            TypeError: Neither or both of `seconds` and `samples` are given.
            ValueError: A block would be empty, or there is no such quantity.
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
            self._reader,
            seconds=seconds,
            samples=samples,
            quantities=quantities,
            timeout=timeout,
        )

    @property
    def findings(self) -> tuple[str, ...]:
        """Sentences that say what is unusual on a CAN bus, and what to do, like those of `xbus.can.Traffic`.

        Empty for a port that is no CAN bus.
        """
        return self.link.findings if isinstance(self.link, CanLink) else ()

    def discard(self) -> None:
        """Removes the unread samples and strings, for a program that only records.

        They do not count as dropped.
        """
        self._channel.handle_events()
        self.link.acquisition.clear_data()

    @property
    def stats(self) -> LiveStats:
        """The counts of the stream since the port was opened. Takes microseconds."""
        return live_stats(self.link.acquisition.stats(self.link.clock()), self._channel.outdated)

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
        """Starts to record every received byte, until the recording is stopped.

        A separate thread writes. The file starts with the device's Configuration, with date and time filled
        in, and EmtsData, as MT Manager's recordings do; a measuring device enters Config State for a moment
        to send them. If the port was opened only to listen, it starts with what the device has sent of these
        messages by itself. It ends with a whole frame; after a crash it is readable up to the last flush. The
        recording continues when a lost port comes back, as with ``reconnect``.

        A CAN bus is recorded as .asc, .blf, .log (candump), .trc, .csv or .mf4, which `xbus.read_can` reads:
        all frames, also those of other nodes. After a crash the text formats are readable up to the last
        flush, and .blf up to its last 16 KiB; an .mf4 file is written at the end.

        Args:
            path: The first file. With rotation, ``log-0001.mtb`` follows ``log.mtb``; a number that is in use
                is skipped.
            flush: Maximum seconds until received bytes are written.
            fsync: Whether to wait for the disk at each flush, so that a power cut loses nothing before it.
            rotate_bytes: Size in bytes at which the next file begins.
            rotate_seconds: Duration in seconds after which the next file begins.
            times: Whether to write ``path + ".times"`` with the arrival times of the bytes. Captures of CAN
                have them in any case.
            overwrite: Whether to replace an existing file that is not empty.

        Raises:
            FileExistsError: The file exists, and `overwrite` is False.
            OSError: The file cannot be created.
            RuntimeError: The device is already being recorded.
            ValueError: A number is out of range, or a CAN bus cannot be recorded in this format.
            XbusError: The device did not send its Configuration.

        >>> import xbus, tempfile
        >>> device = xbus.connect("sim:MTi-630")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with device.record(f"{folder}/log.mtb"):
        ...         device.listen(1)
        ...     log = xbus.read_log(f"{folder}/log.mtb")
        >>> len(log) > 90, log.product_code
        (True, 'MTi-630-8A1G6')
        """
        if isinstance(self.link, CanLink):
            options = {"rotate_bytes": rotate_bytes, "rotate_seconds": rotate_seconds}
            return Recording(
                self.link.record(path, flush=flush, fsync=fsync, overwrite=overwrite, **options)
            )
        is_listening = self._channel.is_listening
        with contextlib.nullcontext() if is_listening else self.configure():
            recorder = self.link.acquisition.record(
                path,
                heard_head(self._channel) if is_listening else recording_head(self._channel),
                flush,
                fsync,
                rotate_bytes,
                rotate_seconds,
                times,
                overwrite=overwrite,
            )
        return Recording(recorder)
