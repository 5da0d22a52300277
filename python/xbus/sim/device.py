"""A virtual MTi, as a host sees it."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np

from xbus import _core
from xbus.protocol.configuration import Firmware
from xbus.protocol.ids import MessageId
from xbus.protocol.messages import encode
from xbus.protocol.products import (
    DEFAULT_BAUDRATE,
    FactoryIdentity,
    find_product,
    product_of_code,
    support,
)
from xbus.protocol.tables import Product
from xbus.protocol.values import (
    DeviceErrorInfo,
    ErrorCode,
    HardwareVersion,
    State,
    SyncLine,
    baud_code,
)
from xbus.sim.board import World
from xbus.sim.can_bus import CanBus
from xbus.sim.can_stream import CanFrame
from xbus.sim.clock import SECOND, Clock
from xbus.sim.commands import answer
from xbus.sim.faults import Faults
from xbus.sim.framing import Framer, Request
from xbus.sim.line import Line
from xbus.sim.memory import UnitSettings, factory_settings
from xbus.sim.motion import Trajectory
from xbus.sim.replay import Replay
from xbus.sim.sensors import UTC
from xbus.sim.trajectories import trajectory as find_trajectory
from xbus.sim.unit import Unit

__all__ = ["SimulatedDevice"]

#: Seconds from power-up to WakeUp, and from WakeUp to the next state if the host sends nothing (section 4).
BOOT_TIME, WAKE_UP_TIME = 0.06, 0.5
#: The byte of "restore communication" (section 7.2), and the number of them that the booting device needs.
RESTORE, RESTORE_COUNT = 0xDE, 8
#: Seconds without another byte after which an incomplete frame is dropped.
FRAME_TIMEOUT = 0.1
#: Shortest time in seconds between two Error messages about lost samples.
ERROR_PAUSE = 1.0


_P = ParamSpec("_P")
_R = TypeVar("_R")


def _locked(
    method: Callable[Concatenate[SimulatedDevice, _P], _R],
) -> Callable[Concatenate[SimulatedDevice, _P], _R]:
    """Makes a method thread-safe, because a server and its user call the device in different threads."""

    @functools.wraps(method)
    def locked(self: SimulatedDevice, /, *args: _P.args, **kwargs: _P.kwargs) -> _R:
        with self._lock:
            return method(self, *args, **kwargs)

    return locked


class SimulatedDevice:
    """A virtual MTi, to develop and test programs without hardware.

    The device accepts bytes with `write` and returns bytes with `read`. Its time advances only with
    `advance`, so equal calls return equal bytes. It does not sleep and has no threads. Time starts at
    power-up. After 60 ms the device sends WakeUp, and half a second later it starts to measure, unless the
    host requests Config (section 4).

    The device answers every message of its product in the states that the manual allows. Otherwise it
    replies with an Error: code 4 for a message or state, 33 for a value, 32 for a baud rate, 3 for a period.
    Settings persist as in the manual: through `Reset` and power cycles, for the lifetime of the object.

    All methods may be called from any thread, even while a server runs the device.

    Args:
        product: ``"MTi-680G"``, 680, or a row of `xbus.protocol.tables.PRODUCTS`.
        trajectory: The motion: still, turn, tumble, walk, drive, fly, sail; or a `xbus.sim.Trajectory` such
            as `xbus.sim.SampledTrajectory`. It continues through resets.
        seed: Seed of everything random.
        noise: Strength of the sensor noise: 0 is none, 1 is about that of a data sheet.
        baudrate: Bits per second of a serial line. The host must use the same rate, and samples that exceed
            it are lost. None: like USB, any rate works and bytes arrive at once.
        faults: Faults of the line.
        device_id: Device identifier: 4 bytes, on the 600-series 8 bytes.
        product_code: Product code.
        firmware: Firmware revision.
        hardware: Hardware version, which determines the highest rates (Tables 23 and 24). None: a published
            version, with the rates of the manual.
        utc: UTC when the device is created: the calendar starts with it at each power-up, and the GNSS
            receiver delivers it later.
        time_to_fix: Seconds from power-up to the first GNSS fix.
        bus_id: Bus identifier in effect with the option flag EnableConfigurableBusId.
        replay: A recording to send instead of computed samples. Its identity is used if its product matches.
        strict_outputs: Whether one unsupported data identifier makes the device refuse a whole output
            configuration. If False, the device accepts the supported ones and drops the others; the
            acknowledgement lists what is in effect.
        can: Where an MTi-600 sends CAN: a bus of python-can, such as ``virtual:drive`` (in this process),
            ``udp_multicast:239.74.163.2`` or ``socketcan:vcan0``, or a function that is called with the
            frames. It sends once `set_can_output_configuration` has switched CAN on.

    Attributes:
        product: The product.
        sent: Number of messages sent.
        lost: Number of samples lost because the line was too slow.

    Raises:
        ImportError: ``can`` needs the extra ``can``.
        OSError: The CAN bus cannot be opened.
        ValueError: The product or trajectory does not exist, the product does not support the baud rate or
            CAN, or no device can have the identifier.

    Example:
        >>> import xbus
        >>> device = xbus.SimulatedDevice("MTi-630", trajectory="still")
        >>> device.advance(0.1)
        >>> device.read().hex(" ").upper()
        'FA FF 3E 00 C3'
        >>> device.write(xbus.encode_frame(xbus.MessageId.GoToConfig))
        >>> device.read().hex(" ").upper(), device.state.value
        ('FA FF 31 00 D0', 'config')
    """

    def __init__(
        self,
        product: str | int | Product,
        *,
        trajectory: str | Trajectory = "walk",
        seed: int = 0,
        noise: float = 0.0,
        baudrate: int | None = None,
        faults: Faults | None = None,
        device_id: int | None = None,
        product_code: str | None = None,
        firmware: Firmware | None = None,
        hardware: HardwareVersion | None = None,
        utc: np.datetime64 = UTC,
        time_to_fix: float = 3.0,
        bus_id: int = 1,
        replay: Replay | None = None,
        strict_outputs: bool = True,
        can: str | Callable[[Sequence[CanFrame]], object] | None = None,
    ) -> None:
        self.product = find_product(product)
        supported = support(self.product, hardware)
        settings = factory_settings(supported)
        if baudrate is not None:
            if baudrate not in supported.baudrates:
                rates = ", ".join(f"{rate:,}" for rate in supported.baudrates)
                raise ValueError(
                    f"the {self.product.name} does not support {baudrate:,} baud; use one of {rates}"
                )
            settings = settings.with_baud_code(baud_code(baudrate))
        identity = supported.identity
        if (
            replay is not None
            and product_of_code(replay.identity.product_code or "") == self.product
        ):
            identity = _with_known(
                identity,
                device_id=replay.identity.device_id,
                product_code=replay.identity.product_code,
                firmware=replay.identity.firmware,
            )
        identity = _with_known(
            identity,
            device_id=device_id,
            product_code=product_code,
            firmware=firmware,
            hardware=hardware,
        )
        if (wide := identity.device_id >> 31) and not wide & 1:
            raise ValueError(
                f"0x{identity.device_id:X} is not a device identifier: beyond four bytes, bit 31 must be set"
            )
        if can is not None and "SetCanConfig" not in supported.messages:
            raise ValueError(f"the {self.product.name} has no CAN; only MTi-600 devices have")
        self._can = CanBus(can) if isinstance(can, str) else can
        self.sent = self.lost = 0
        self._frame_timeout_at = 0
        self._lock = threading.RLock()
        self._clock = Clock()
        self._line = Line(baudrate, faults, seed)
        self._has_plug = True
        self._unit = Unit(
            self._clock,
            World(
                find_trajectory(trajectory), noise, seed, utc.astype("M8[ns]"), time_to_fix, replay
            ),
            supported,
            identity,
            settings,
            bus_id=bus_id,
            strict_outputs=strict_outputs,
            send=self._send,
            restart=self._restart,
        )
        self._start()

    # State

    @property
    def identity(self) -> FactoryIdentity:
        """Device identifier, product code, firmware and hardware version."""
        return self._unit.identity

    @property
    def time(self) -> float:
        """Seconds since the device was created."""
        return self._clock.now / SECOND

    @property
    def state(self) -> State:
        """The current state (section 4)."""
        return self._unit.state

    @property
    def is_booting(self) -> bool:
        """Whether the device has not sent WakeUp yet since its last start."""
        return self._is_booting

    @property
    def settings(self) -> UnitSettings:
        """The settings in use."""
        return self._unit.settings

    @property
    def is_serial(self) -> bool:
        """Whether the device has a serial line, on which the host must use the device's baud rate."""
        return self._line.rate is not None

    @property
    def baudrate(self) -> int:
        """Bits per second of the line; on USB the baud rate setting."""
        return self._line.rate or self.settings.baudrate

    @property
    def plugged(self) -> bool:
        """Whether the plug is in."""
        return self._has_plug and self._line.is_plugged(self._clock.now)

    @property
    def faults(self) -> Faults | None:
        """The faults of the line, or None.

        They can be replaced at any time, even while a server runs the device. Their times are those of
        `time`. Bytes that the old faults held back arrive at once.

        Example:
            >>> import xbus
            >>> device = xbus.SimulatedDevice("MTi-630", baudrate=115200)
            >>> device.faults = xbus.Faults(stall=(device.time, 2))
            >>> device.advance(1)
            >>> waiting = device.read()
            >>> device.faults = None
            >>> waiting, len(device.read()) > 0
            (b'', True)
        """
        return self._line.faults

    @faults.setter
    @_locked
    def faults(self, faults: Faults | None) -> None:
        self._line.change_faults(faults, self._clock.now)

    # The host's side

    @_locked
    def write(self, data: bytes, baudrate: int | None = None) -> None:
        """Sends bytes from the host to the device.

        Args:
            data: Bytes, cut anywhere. While the plug is out they are lost.
            baudrate: The rate of the host's port; None: the device's rate. On a serial line with another
                rate the device receives noise.
        """
        if not self.plugged:
            return
        # The boot loader uses the default rate, whatever the settings.
        own = DEFAULT_BAUDRATE if self._is_booting and self.is_serial else self._line.rate
        data = self._line.receive(data, baudrate, own) if self.is_serial else data
        if self._is_booting:
            self._restores += data.count(RESTORE)
            return
        for request in self._framer.feed(data):
            self._answer(request)
        until = self._clock.now + round(FRAME_TIMEOUT * SECOND)
        if self._framer.is_waiting and until != self._frame_timeout_at:
            self._frame_timeout_at = until
            self._clock.at(until, self._drop_incomplete_frame)

    @_locked
    def read(self, baudrate: int | None = None) -> bytes:
        """Returns the bytes that have arrived at the host since the last call.

        Args:
            baudrate: The rate of the host's port; None: the device's rate. On a serial line with another
                rate the host receives noise.
        """
        self._line.collect(self._clock.now)
        if not self.plugged:
            self._line.discard()
        return self._line.read(baudrate)

    @_locked
    def advance(self, dt: float) -> None:
        """Advances the device's time.

        Args:
            dt: Seconds, rounded to nanoseconds. The number of calls for a duration has no effect.

        Raises:
            ValueError: ``dt`` is negative.
        """
        if dt < 0:
            raise ValueError(f"dt must be 0 seconds or more, not {dt}")
        end = self._clock.now + round(dt * SECOND)
        while (due := self._clock.next_time()) is not None and due <= end:
            self._measure(due)
            self._clock.run_next()
        self._measure(end)
        self._line.collect(end)
        if not self.plugged:
            self._line.discard()

    # The hardware

    @_locked
    def trigger(self, line: SyncLine | int, *, rising: bool = True) -> None:
        """Creates an edge at a sync input.

        Args:
            line: The line (Table 12).
            rising: Whether the edge is rising or falling.
        """
        if self._unit.measurement is not None:
            self._unit.measurement.edge(line, rising=rising)

    @_locked
    def connect_antenna(self, connected: bool) -> None:
        """Connects or disconnects the GNSS antenna.

        Without the antenna the fix is lost, and the filter mode is coasting for a minute (Table 27). With the
        antenna there is a fix again after ``time_to_fix``.

        Args:
            connected: Whether the antenna is connected.
        """
        if self.product.kind == "GNSS/INS":
            self._unit.receiver.connect_antenna(connected)

    @_locked
    def power_cycle(self) -> None:
        """Switches the power off and on: settings that are not stored are lost."""
        self._start()

    @_locked
    def unplug(self) -> None:
        """Pulls the plug of the data line: bytes in both directions, and bytes not yet read, are lost.

        The device keeps its power. For a device with power from the plug, call `power_cycle` as well.
        """
        self._has_plug = False
        self._line.discard()

    @_locked
    def plug(self) -> None:
        """Inserts the plug of the data line."""
        self._has_plug = True

    # The device's side

    def _start(self) -> None:
        """Powers up."""
        self._clock.clear()
        self._line.restart(self._line.rate, self._clock.now)
        self._unit.power_up()
        self._framer = Framer()
        self._is_booting, self._restores = True, 0
        self._is_restarting = False
        self._error_at: int | None = None
        self._clock.after(BOOT_TIME, self._wake_up)

    def _wake_up(self) -> None:
        self._is_booting = False
        if self._restores >= RESTORE_COUNT:
            self._unit.restore_communication()
        self._line.restart(self.settings.baudrate if self.is_serial else None, self._clock.now)
        self._unit.send_message(MessageId.WakeUp)
        self._clock.after(WAKE_UP_TIME, self._unit.leave_wake_up)

    def _restart(self) -> None:
        self._is_restarting = True

    def _answer(self, request: Request) -> None:
        bid = self._unit.replies_as(request.bid)
        if bid is None or self._is_restarting or self._is_booting:
            return
        if (reply := answer(self._unit, request)) is not None:
            self._send(_core.encode_frame(bid, *reply))
        if self._is_restarting:
            # The reply leaves at the old rate before the restart.
            self._clock.at(max(self._line.idle_at, self._clock.now), self._start)

    def _drop_incomplete_frame(self) -> None:
        """Drops an incomplete frame, so that the next request is not taken for the rest of it."""
        if self._clock.now < self._frame_timeout_at:
            return
        for request in self._framer.flush():
            self._answer(request)

    def _send(self, frame: bytes) -> None:
        self.sent += 1
        self._line.send(frame, self._clock.now)

    def _measure(self, until: int) -> None:
        """Advances the clock, and sends the samples that are due meanwhile."""
        measurement = self._unit.measurement
        frames = measurement.take(until) if measurement is not None else []
        if measurement is not None and self._can is not None:
            self._can(measurement.take_can(until))
        if self._line.is_immediate:
            self.sent += len(frames)
            self._line.send(b"".join([frame for _, frame in frames]), until)
        else:
            for time, frame in frames:
                self._clock.now = round(time * SECOND)
                self._send_sample(frame)
        self._clock.now = until

    def _send_sample(self, frame: bytes) -> None:
        """Sends a sample if the line has room for it; otherwise it is lost, but counted by the counter."""
        now = self._clock.now
        if self._line.has_room(len(frame), now):
            self._send(frame)
            return
        self.lost += 1
        if self._error_at is None or now - self._error_at >= ERROR_PAUSE * SECOND:
            self._error_at = now
            self._unit.send_message(
                MessageId.Error, encode("Error", DeviceErrorInfo(ErrorCode.DATA_OVERFLOW))
            )


def _with_known(identity: FactoryIdentity, **fields: Any) -> FactoryIdentity:
    """Returns a copy of the identity with the fields that are not None."""
    known = {name: value for name, value in fields.items() if value is not None}
    return replace(identity, **known)
