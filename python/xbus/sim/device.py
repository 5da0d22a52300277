"""A virtual MTi: what a host sees of it."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np

from xbus import _core
from xbus.protocol.configuration import Firmware
from xbus.protocol.ids import MessageId
from xbus.protocol.messages import encode
from xbus.protocol.products import Identity, find_product, product_of_code, support
from xbus.protocol.tables import Product
from xbus.protocol.values import (
    DeviceErrorInfo,
    ErrorCode,
    HardwareVersion,
    State,
    SyncLine,
    baud_code,
)
from xbus.sim.clock import SECOND, Clock
from xbus.sim.faults import Faults
from xbus.sim.framing import Framer, Request
from xbus.sim.line import Line
from xbus.sim.memory import DEFAULT_BAUDRATE, UnitSettings, factory_settings
from xbus.sim.motion import Trajectory
from xbus.sim.replay import Replay
from xbus.sim.sensors import UTC
from xbus.sim.trajectories import trajectory as find_trajectory
from xbus.sim.unit import Unit, World

__all__ = ["SimulatedDevice"]

#: Seconds from power-up to WakeUp, and from there until the device goes on by itself (section 4).
BOOT_TIME, WAKE_UP_TIME = 0.06, 0.5
#: The byte of "restore communication" (7.2), and how many of them it takes while the device boots.
RESTORE, RESTORE_COUNT = 0xDE, 8
#: Seconds without another byte until a frame that has begun is given up.
PATIENCE = 0.1
#: Seconds at least between two Error messages about lost samples.
ERROR_PAUSE = 1.0


_P = ParamSpec("_P")
_R = TypeVar("_R")


def _locked(
    method: Callable[Concatenate[SimulatedDevice, _P], _R],
) -> Callable[Concatenate[SimulatedDevice, _P], _R]:
    """Makes a method wait while another thread, such as that of a server, is in one."""

    @functools.wraps(method)
    def locked(self: SimulatedDevice, /, *args: _P.args, **kwargs: _P.kwargs) -> _R:
        with self._lock:
            return method(self, *args, **kwargs)

    return locked


class SimulatedDevice:
    """A virtual MTi, for programs that talk to one and have none.

    It takes bytes and gives bytes. Its time goes on by `advance` alone, so the same calls always give the
    same bytes; nothing sleeps, and no thread runs. Time begins with power-up: 60 ms later it sends WakeUp,
    and half a second after that it measures, if nobody wants anything else (section 4).

    It answers every message that the product knows, in the states in which the manual allows it, and else
    with an Error: code 4 for a message or state, 33 for a value, 32 for a baud rate, 3 for a period. Settings
    last as the manual says: over `Reset` and power cycles, but not longer than the object.

    All methods may be called from any thread, also while a server runs the device.

    Args:
        product: Which one: ``"MTi-680G"``, 680, or a row of `xbus.protocol.tables.PRODUCTS`.
        trajectory: How it moves: still, turn, tumble, walk, drive, fly, sail; or what has ``origin`` and
            ``at(time)``, such as `xbus.sim.motion.SampledTrajectory`. It goes on over resets.
        seed: Of all that is left to chance.
        noise: Of the sensors: 1 is about that of a data sheet.
        baudrate: Bits per second of a serial line: the host must talk at the same rate, and what does not
            fit through is lost. None: as USB, at any rate and all at once.
        faults: What is wrong with the line.
        device_id: Device identifier, of 4 bytes, on the 600-series 8.
        product_code: Product code.
        firmware: Firmware revision.
        hardware: Hardware version, on which high rates depend (Tables 23 and 24). By default it is one
            that was seen, and the rates are the manual's.
        utc: UTC when the device is made: what its calendar says at each power-up, and the receiver later.
        time_to_fix: Seconds from power-up to the first GNSS fix.
        bus_id: The bus identifier that the option flag EnableConfigurableBusId turns on.
        replay: A recording, to send instead of samples of its own.
        strict_outputs: Whether one unsupported data identifier makes the device refuse a whole output
            configuration. If False, the device accepts the supported ones and drops the others; the
            acknowledgement lists what is in effect.

    Attributes:
        product: Which one it is.
        sent: How many messages it has sent.
        lost: How many samples were lost because the line was too slow.

    Raises:
        ValueError: No such product or trajectory, or it cannot talk at that rate.

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
    ) -> None:
        self.product = find_product(product)
        supported = support(self.product, hardware)
        settings = factory_settings(supported)
        if baudrate is not None:
            if baudrate not in supported.baudrates:
                rates = ", ".join(f"{it:,}" for it in supported.baudrates)
                raise ValueError(
                    f"the {self.product.name} does not talk at {baudrate:,} baud; it does at {rates}"
                )
            settings = settings.with_baud_code(baud_code(baudrate))
        identity = supported.identity
        if (
            replay is not None
            and product_of_code(replay.identity.product_code or "") == self.product
        ):
            identity = _told(
                identity,
                device_id=replay.identity.device_id,
                product_code=replay.identity.product_code,
                firmware=replay.identity.firmware,
            )
        identity = _told(
            identity,
            device_id=device_id,
            product_code=product_code,
            firmware=firmware,
            hardware=hardware,
        )
        self.sent = self.lost = 0
        self._gives_up_at = 0
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

    # What it is

    @property
    def identity(self) -> Identity:
        """What it calls itself."""
        return self._unit.identity

    @property
    def time(self) -> float:
        """Seconds since it was made."""
        return self._clock.now / SECOND

    @property
    def state(self) -> State:
        """The state in which it is (section 4)."""
        return self._unit.state

    @property
    def settings(self) -> UnitSettings:
        """The settings in use."""
        return self._unit.settings

    @property
    def is_serial(self) -> bool:
        """Whether baud rates mean something."""
        return self._line.rate is not None

    @property
    def baudrate(self) -> int:
        """Bits per second at which it talks; on USB what a serial port would be set to."""
        return self._line.rate or self.settings.baudrate

    @property
    def plugged(self) -> bool:
        """Whether the plug is in."""
        return self._has_plug and self._line.is_plugged(self._clock.now)

    @property
    def faults(self) -> Faults | None:
        """The faults of the line, or None.

        Assign others at any time, also while a server runs the device. Times in them are those of `time`.
        Bytes that the old faults held back arrive at once.

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

    # What a host does

    @_locked
    def write(self, data: bytes, baudrate: int | None = None) -> None:
        """Takes bytes from the host.

        Args:
            data: Any piece of what it sends. Nothing gets through while the plug is out.
            baudrate: The rate that the host's port is set to; None: the right one. At another one than the
                device's it hears noise, on a serial line.
        """
        if not self.plugged:
            return
        # The boot loader listens at the rate that all can find.
        own = DEFAULT_BAUDRATE if self._is_booting and self.is_serial else self._line.rate
        data = self._line.heard(data, baudrate, own) if self.is_serial else data
        if self._is_booting:
            self._restores += data.count(RESTORE)
            return
        for request in self._framer.feed(data):
            self._answer(request)
        until = self._clock.now + round(PATIENCE * SECOND)
        if self._framer.is_waiting and until != self._gives_up_at:
            self._gives_up_at = until
            self._clock.at(until, self._lose_patience)

    @_locked
    def read(self, baudrate: int | None = None) -> bytes:
        """All bytes that have come to the host and were not read.

        Args:
            baudrate: The rate that the host's port is set to; None: the right one. At another one than the
                device's it hears noise, on a serial line.
        """
        self._line.collect(self._clock.now)
        if not self.plugged:
            self._line.lose()
        return self._line.read(baudrate)

    @_locked
    def advance(self, dt: float) -> None:
        """Moves time on.

        Args:
            dt: Seconds, counted in whole nanoseconds; how time is cut into calls changes nothing.

        Raises:
            ValueError: Time cannot go back.
        """
        if dt < 0:
            raise ValueError(f"time goes on, and not by {dt} s")
        end = self._clock.now + round(dt * SECOND)
        while (due := self._clock.next()) is not None and due <= end:
            self._measure(due)
            self._clock.run()
        self._measure(end)
        self._line.collect(end)
        if not self.plugged:
            self._line.lose()

    # What hands do

    @_locked
    def trigger(self, line: SyncLine | int, *, rising: bool = True) -> None:
        """An edge at a sync input.

        Args:
            line: Which one (Table 12).
            rising: Which edge.
        """
        if self._unit.measurement is not None:
            self._unit.measurement.edge(line, rising=rising)

    @_locked
    def connect_antenna(self, connected: bool) -> None:
        """Takes the GNSS antenna off, or puts it on: the fix is lost, or comes again after a while.

        For a minute after the loss the filter mode says that it is coasting (Table 27).
        """
        if self.product.kind == "GNSS/INS":
            self._unit.receiver.connect_antenna(connected)

    @_locked
    def power_cycle(self) -> None:
        """Takes power away, and gives it back: settings that are not stored are lost."""
        self._start()

    @_locked
    def unplug(self) -> None:
        """Pulls the plug of the data line: nothing gets through, and what nobody has read is lost.

        Power comes from elsewhere; for a device that is fed by its plug call `power_cycle` as well.
        """
        self._has_plug = False
        self._line.lose()

    @_locked
    def plug(self) -> None:
        """Puts the plug in."""
        self._has_plug = True

    # What happens inside

    def _start(self) -> None:
        """Power-up."""
        self._clock.forget()
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
        self._unit.say(MessageId.WakeUp)
        self._clock.after(WAKE_UP_TIME, self._unit.leave_wake_up)

    def _restart(self) -> None:
        self._is_restarting = True

    def _answer(self, request: Request) -> None:
        bid = self._unit.replies_as(request.bid)
        if bid is None or self._is_restarting or self._is_booting:
            return
        if (reply := self._unit.answer(request)) is not None:
            self._send(_core.encode_frame(bid, *reply))
        if self._is_restarting:
            # The reply has to get out at the old rate.
            self._clock.at(max(self._line.idle_at, self._clock.now), self._start)

    def _lose_patience(self) -> None:
        """Gives up what has begun like a frame and does not go on: it must not swallow the next request."""
        if self._clock.now < self._gives_up_at:
            return
        for request in self._framer.flush():
            self._answer(request)

    def _send(self, frame: bytes) -> None:
        self.sent += 1
        self._line.send(frame, self._clock.now)

    def _measure(self, until: int) -> None:
        """Moves the clock on, with what is sent meanwhile."""
        measurement = self._unit.measurement
        frames = measurement.take(until) if measurement is not None else []
        if self._line.is_simple:
            self.sent += len(frames)
            self._line.send(b"".join([it for _, it in frames]), until)
        else:
            for time, frame in frames:
                self._clock.now = round(time * SECOND)
                self._send_sample(frame)
        self._clock.now = until

    def _send_sample(self, frame: bytes) -> None:
        """Sends a sample if the line can take it; else it is lost, and its number is missing."""
        now = self._clock.now
        if self._line.has_room(len(frame), now):
            self._send(frame)
            return
        self.lost += 1
        if self._error_at is None or now - self._error_at >= ERROR_PAUSE * SECOND:
            self._error_at = now
            self._unit.say(
                MessageId.Error, encode("Error", DeviceErrorInfo(ErrorCode.DATA_OVERFLOW))
            )


def _told(identity: Identity, **told: Any) -> Identity:
    """The identity, with what is told otherwise."""
    return replace(identity, **{name: it for name, it in told.items() if it is not None})
