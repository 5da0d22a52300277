"""What a virtual device does while it measures."""

from __future__ import annotations

import struct
from collections.abc import Callable
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING, Protocol

import numpy as np

from xbus.protocol.ids import DataId
from xbus.protocol.tables import QUANTITIES, STATUS_FLAGS
from xbus.protocol.values import (
    ON_DEMAND,
    PERIOD_TICKS,
    IccCommand,
    IccReply,
    ResetCode,
    SyncFunction,
    SyncLine,
)
from xbus.sim.clock import SECOND
from xbus.sim.procedures import icc_result, is_still, reset
from xbus.sim.stream import Stream
from xbus.sim.strings import StringStream
from xbus.sim.sync import delay_of, reference_period
from xbus.wire.codec import encode_sample

if TYPE_CHECKING:
    from xbus.sim.unit import Unit

__all__ = ["Measurement", "status_word"]

#: Momentary flags are looked at so often, in ns: no two messages with a status word are nearer.
STEP = SECOND // 2000
#: A tick of SampleTimeFine, in ns.
TICK = SECOND // 10_000
#: The no-rotation update in the status word.
NO_ROTATION_FINE, NO_ROTATION_FAILED, NO_ROTATION_RUNS = 0, 2, 3
#: The lines whose events come as data, on the 600-series.
TRIGGERS = {SyncLine.IN1: DataId.TriggerIn1, SyncLine.IN2: DataId.TriggerIn2}

_STATUS_BITS = {it.name: it.bit for it in STATUS_FLAGS}


def status_word(**fields: int) -> int:
    """A status word with these fields (Table 27)."""
    return sum(int(value) << _STATUS_BITS[name] for name, value in fields.items())


class Source(Protocol):
    """Where samples come from: a `Stream`, strings, or a recording."""

    def take(self, until: float, status: int) -> list[tuple[float, bytes]]:
        """The frames sent since the last call, and when."""

    def latest(self, now: float, status: int) -> list[bytes]:
        """The newest sample, or strings."""


class Measurement:
    """One stay in the Measurement State.

    Args:
        unit: The device.

    Attributes:
        rot_sensor: RotSensor in effect; orientation resets change it.
        rot_local: RotLocal in effect.
        icc_since: When the representative motion began, in ns; None where there is none.
    """

    def __init__(self, unit: Unit) -> None:
        settings = unit.settings
        self.rot_sensor = settings.rot_sensor.quaternion
        self.rot_local = settings.rot_local.quaternion
        self.icc_since: int | None = None
        self._updating_since: int | None = None
        self._unit = unit
        self._is_asked = any(
            it.function == SyncFunction.SEND_LATEST for it in settings.sync_settings
        )
        self._source = self._make_source()
        self._taken = unit.clock.now
        self._momentary = 0
        #: How a packet begins that tells the flags.
        self._marks = [
            struct.pack(">HB", it.data_id, QUANTITIES[it.quantity].size)
            for it in settings.output_configuration
            if it.quantity in ("status_word", "status_byte")
            and not settings.string_output_type.types
        ]
        self.mark("filter_input_start")

    def _make_source(self) -> Source:
        unit, now = self._unit, self._unit.clock.now / SECOND
        if unit.settings.string_output_type.types:
            # Strings overrule MTData2.
            return self._make_strings(now)
        if unit.world.replay is not None:
            return unit.world.replay.play(now)
        return Stream(
            unit.settings.output_configuration,
            sensors=unit.sensors(),
            base_rate=unit.support.rates["acceleration"],
            synchronous_hr=unit.product.series in ("10-series", "100-series"),
            fine_wrap=unit.product.fine_wrap,
            fine_start=-(unit.powered_at // TICK),
            start=now,
            bid=unit.bid,
            device_id=unit.identity.device_id,
            location_id=unit.settings.location_id,
        )

    def _make_strings(self, now: float) -> StringStream:
        settings, unit = self._unit.settings, self._unit
        rate: Fraction | None
        if settings.string_output_type.frequency is not None:
            rate = Fraction(settings.string_output_type.frequency)
        elif settings.output_skip_factor == ON_DEMAND:
            rate = None
        else:
            rate = Fraction(PERIOD_TICKS, settings.period * (settings.output_skip_factor + 1))
        self._is_asked = self._is_asked or rate is None
        return StringStream(settings.string_output_type.types, rate, unit.sensors(), now)

    # Samples

    def take(self, until: int) -> list[tuple[float, bytes]]:
        """The frames that are sent on their own up to a time in ns, and when, in seconds."""
        if self._is_asked:
            return []
        frames: list[tuple[float, bytes]] = []
        while self._momentary and self._taken < until:
            self._taken = min((self._taken // STEP + 1) * STEP, until)
            status = self._unit.status() | self._momentary
            frames += (new := self._source.take(self._taken / SECOND, status))
            self._told([frame for _, frame in new])
        if self._taken < until:
            self._taken = until
            frames += self._source.take(until / SECOND, self._unit.status())
        return frames

    def send_latest(self) -> None:
        """Sends the newest sample, if samples are sent when they are asked for."""
        if not self._is_asked:
            return
        status = self._unit.status() | self._momentary
        frames = self._source.latest(self._unit.clock.now / SECOND, status)
        self._told(frames)
        for frame in frames:
            self._unit.send(frame)

    def mark(self, flag: str) -> None:
        """Sets a flag of the status word in the next message that tells it."""
        if self._marks:
            self._momentary |= status_word(**{flag: 1})

    def _told(self, frames: list[bytes]) -> None:
        if any(mark in frame for mark in self._marks for frame in frames):
            self._momentary = 0

    def sensors_changed(self) -> None:
        """What is measured from now on is something else."""
        if isinstance(self._source, Stream | StringStream):
            self._source.sensors = self._unit.sensors()

    # Edges at the sync inputs

    def edge(self, line: int, *, rising: bool) -> None:
        """An edge at a line; each setting for which it counts acts after its delay."""
        for setting in self._unit.sync_inputs.edge(line, rising=rising):
            match setting.function:
                case SyncFunction.CLOCK_BIAS_ESTIMATION:
                    self._unit.sync_inputs.reference(setting, self._unit.clock.now)
                    # The flag falls where the next one is missed.
                    self._plan(2 * reference_period(setting), lambda: None)
                case SyncFunction.SEND_LATEST:
                    self._plan(delay_of(setting), self.send_latest)
                case SyncFunction.TRIGGER_INDICATION:
                    self._plan(delay_of(setting), partial(self._indicate, line, rising=rising))

    def _plan(self, delay: int, action: Callable[[], None]) -> None:
        """Does something after a delay in ns, if this measurement lasts so long."""

        def act() -> None:
            if self._unit.measurement is self:
                action()

        self._unit.clock.at(self._unit.clock.now + delay, act)

    def _indicate(self, line: int, *, rising: bool) -> None:
        if self._unit.product.series != "600-series":
            self.mark("sync_in_marker")
            return
        data_id = TRIGGERS[SyncLine(line)]
        if data_id in (it.data_id for it in self._unit.settings.output_configuration):
            microseconds = (self._unit.clock.now - self._unit.powered_at) // 1000
            trigger = {
                "line": line,
                "polarity": rising,
                "timestamp": microseconds % 2**32,
                "frame": 0,
            }
            # Without a packet counter, which does not count it either.
            self._unit.send(encode_sample({int(data_id): trigger}, bid=self._unit.bid))

    # Procedures

    def reset_orientation(self, code: ResetCode) -> None:
        """Resets the orientation (Table 33)."""
        now = np.array([self._unit.clock.now / SECOND])
        orientation = self._unit.world.trajectory.at(now).orientation[0]
        self.rot_sensor, self.rot_local = reset(code, orientation, self.rot_sensor, self.rot_local)
        self.sensors_changed()

    def update_no_rotation(self, seconds: int) -> None:
        """Begins a no-rotation update; it ends well if the device stands still."""
        start = self._unit.clock.now
        self._updating_since = start
        self._unit.no_rotation = NO_ROTATION_RUNS

        def end() -> None:
            if self._updating_since == start:
                still = is_still(self._unit.world.trajectory, start, self._unit.clock.now)
                self._unit.no_rotation = NO_ROTATION_FINE if still else NO_ROTATION_FAILED
                self._updating_since = None

        self._plan(seconds * SECOND, end)

    def icc(self, command: IccCommand) -> IccReply | None:
        """Does a command of in-run compass calibration (Table 36); None where it makes no sense now."""
        now = self._unit.clock.now
        match command:
            case IccCommand.START:
                self.icc_since = now
                return IccReply(command)
            case IccCommand.STATE:
                return IccReply(command, active=self.icc_since is not None)
            case IccCommand.STOP if self.icc_since is not None:
                since, self.icc_since = self.icc_since, None
                return IccReply(command, icc_result(self._unit.world.trajectory, since, now))
        return None

    def end(self) -> None:
        """Leaves off."""
        if self._updating_since is not None:
            self._unit.no_rotation = NO_ROTATION_FAILED
