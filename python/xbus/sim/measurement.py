"""The Measurement State of a virtual device."""

from __future__ import annotations

import struct
from collections.abc import Callable
from fractions import Fraction
from functools import partial
from typing import Protocol

import numpy as np

from xbus.protocol.ids import DataId
from xbus.protocol.tables import QUANTITIES
from xbus.protocol.values import (
    ON_DEMAND,
    PERIOD_TICKS,
    IccCommand,
    IccReply,
    ResetCode,
    SyncFunction,
    SyncLine,
)
from xbus.sim.board import Board, status_word
from xbus.sim.can_stream import CanFrame, CanStream
from xbus.sim.clock import SECOND
from xbus.sim.mtdata import MtDataStream
from xbus.sim.procedures import icc_result, is_still, reset
from xbus.sim.stream import Stream
from xbus.sim.strings import StringStream
from xbus.sim.sync import delay_of, reference_period
from xbus.wire.codec import encode_sample

__all__ = ["Measurement"]

#: Shortest time in ns between two messages with a status word: a momentary flag is in one of them only.
SHORTEST_INTERVAL = SECOND // 2000
#: A tick of SampleTimeFine, in ns.
TICK = SECOND // 10_000
#: States of the no-rotation update in the status word.
NO_ROTATION_DONE, NO_ROTATION_FAILED, NO_ROTATION_RUNNING = 0, 2, 3
#: The lines whose events are sent as data, on the 600-series.
TRIGGERS = {SyncLine.IN1: DataId.TriggerIn1, SyncLine.IN2: DataId.TriggerIn2}
#: Quantities with status flags.
STATUS_QUANTITIES = ("status_word", "status_byte")


class Source(Protocol):
    """A source of samples: a `Stream`, MTData, strings, or a recording."""

    def take(self, until: float, status: int) -> list[tuple[float, bytes]]:
        """Returns the frames sent since the last call, each with its time."""

    def latest(self, now: float, status: int) -> list[bytes]:
        """Returns the newest sample, or strings."""


class Measurement:
    """One stay in the Measurement State.

    Args:
        board: The board of the device.
    """

    def __init__(self, board: Board) -> None:
        settings = board.settings
        self._board = board
        board.rotations = board.alignment
        self._has_ended = False
        self._updating_since: int | None = None
        #: Whether samples are sent on request only.
        self._on_request = any(
            setting.function == SyncFunction.SEND_LATEST for setting in settings.sync_settings
        )
        self._source = self._make_source()
        self._began = self._taken = board.clock.now
        #: The frames on CAN; made when they are first taken.
        self._can: CanStream | None = None
        #: Flags that are set in the next status word only.
        self._momentary = 0
        #: Headers of the packets with status flags.
        self._status_headers = [
            struct.pack(">HB", output.data_id, QUANTITIES[output.quantity].size)
            for output in settings.output_configuration
            if output.quantity in STATUS_QUANTITIES and not settings.string_output_type.types
        ]
        self.set_momentary_flag("filter_input_start")

    def _make_source(self) -> Source:
        board, now = self._board, self._board.clock.now / SECOND
        if board.settings.string_output_type.types:
            # Strings replace MTData2.
            return self._make_strings(now)
        if board.world.replay is not None:
            return board.world.replay.play(now)
        if board.sends_mtdata:
            return self._make_mtdata(now)
        return Stream(
            board.settings.output_configuration,
            sensors=board.sensors(),
            base_rate=board.support.base_rate,
            synchronous_hr=board.product.series in ("10-series", "100-series"),
            fine_wrap=board.product.fine_wrap,
            fine_start=-(board.powered_at // TICK),
            start=now,
            bid=board.bid,
            device_id=board.identity.device_id,
            location_id=board.settings.location_id,
        )

    def _make_mtdata(self, now: float) -> MtDataStream:
        board = self._board
        rate = self._output_rate()
        self._on_request = self._on_request or rate is None
        return MtDataStream(
            board.settings.output_mode,
            board.settings.output_settings,
            rate or Fraction(PERIOD_TICKS, board.settings.period),
            board.sensors(),
            fine_wrap=board.product.fine_wrap,
            fine_start=-(board.powered_at // TICK),
            start=now,
            bid=board.bid,
        )

    def _output_rate(self) -> Fraction | None:
        """Returns the rate of strings and MTData by period and skip factor; None: on request."""
        settings = self._board.settings
        if settings.output_skip_factor == ON_DEMAND:
            return None
        return Fraction(PERIOD_TICKS, settings.period * (settings.output_skip_factor + 1))

    def _make_strings(self, now: float) -> StringStream:
        settings, board = self._board.settings, self._board
        frequency = settings.string_output_type.frequency
        rate = self._output_rate() if frequency is None else Fraction(frequency)
        self._on_request = self._on_request or rate is None
        return StringStream(settings.string_output_type.types, rate, board.sensors(), now)

    # Samples

    def take(self, until: int) -> list[tuple[float, bytes]]:
        """Returns the frames sent without request up to a time in ns, each with its time in seconds."""
        if self._on_request:
            return []
        frames: list[tuple[float, bytes]] = []
        while self._momentary and self._taken < until:
            interval = self._taken // SHORTEST_INTERVAL + 1
            self._taken = min(interval * SHORTEST_INTERVAL, until)
            status = self._board.status() | self._momentary
            frames += (new := self._source.take(self._taken / SECOND, status))
            self._clear_sent_flags([frame for _, frame in new])
        if self._taken < until:
            self._taken = until
            frames += self._source.take(until / SECOND, self._board.status())
        return frames

    def take_can(self, until: int) -> list[CanFrame]:
        """Returns the frames sent on CAN up to a time in ns; none while CAN is off."""
        if self._can is None:
            settings, board = self._board.settings, self._board
            is_on = settings.can_config.enabled and board.world.replay is None
            if not is_on or board.can_bitrate is None:
                return []
            self._can = CanStream(
                settings.can_output_config,
                bitrate=board.can_bitrate,
                sensors=board.sensors(),
                fine_start=-(board.powered_at // TICK),
                start=self._began,
            )
        return self._can.take(until, self._board.status())

    def send_latest(self) -> None:
        """Sends the newest sample, if samples are sent on request only."""
        if not self._on_request:
            return
        status = self._board.status() | self._momentary
        frames = self._source.latest(self._board.clock.now / SECOND, status)
        self._clear_sent_flags(frames)
        for frame in frames:
            self._board.send(frame)

    def set_momentary_flag(self, name: str) -> None:
        """Sets a flag of the status word in the next message that has it."""
        if self._status_headers:
            self._momentary |= status_word(**{name: 1})

    def _clear_sent_flags(self, frames: list[bytes]) -> None:
        """Clears the momentary flags if a frame had them."""
        if any(header in frame for header in self._status_headers for frame in frames):
            self._momentary = 0

    def sensors_changed(self) -> None:
        """Replaces the sensors, after a change of settings, fix or RTK status."""
        if isinstance(self._source, Stream | StringStream | MtDataStream):
            self._source.sensors = self._board.sensors()
        if self._can is not None:
            self._can.sensors = self._board.sensors()

    # Edges at the sync inputs

    def edge(self, line: int, *, rising: bool) -> None:
        """Handles an edge at a line: each setting that it triggers acts after its delay."""
        for setting in self._board.sync_inputs.edge(line, rising=rising):
            match setting.function:
                case SyncFunction.CLOCK_BIAS_ESTIMATION:
                    self._board.sync_inputs.reference(setting, self._board.clock.now)
                    # Without another pulse until then, the status changes at this time.
                    self._after(2 * reference_period(setting), lambda: None)
                case SyncFunction.SEND_LATEST:
                    self._after(delay_of(setting), self.send_latest)
                case SyncFunction.TRIGGER_INDICATION:
                    self._after(delay_of(setting), partial(self._indicate, line, rising=rising))

    def _after(self, delay: int, action: Callable[[], None]) -> None:
        """Schedules an action after a delay in ns; it does not run if this measurement ends before."""

        def act() -> None:
            if not self._has_ended:
                action()

        self._board.clock.at(self._board.clock.now + delay, act)

    def _indicate(self, line: int, *, rising: bool) -> None:
        if self._board.product.series != "600-series":
            self.set_momentary_flag("sync_in_marker")
            return
        data_id = TRIGGERS[SyncLine(line)]
        if data_id in (output.data_id for output in self._board.settings.output_configuration):
            microseconds = (self._board.clock.now - self._board.powered_at) // 1000
            trigger = {
                "line": line,
                "polarity": rising,
                "timestamp": microseconds % 2**32,
                "frame": 0,
            }
            # The message has no packet counter, and the counter does not count it.
            self._board.send(encode_sample({int(data_id): trigger}, bid=self._board.bid))

    # Procedures

    def reset_orientation(self, code: ResetCode) -> None:
        """Resets the orientation (Table 33)."""
        now = np.array([self._board.clock.now / SECOND])
        orientation = self._board.world.trajectory.at(now).orientation[0]
        rotations = self._board.rotations or self._board.alignment
        self._board.rotations = reset(code, orientation, *rotations)
        self.sensors_changed()

    def update_no_rotation(self, seconds: int) -> None:
        """Starts a no-rotation update, which fails if the device moves."""
        start = self._board.clock.now
        self._updating_since = start
        self._board.no_rotation = NO_ROTATION_RUNNING

        def end() -> None:
            if self._updating_since == start:
                still = is_still(self._board.world.trajectory, start, self._board.clock.now)
                self._board.no_rotation = NO_ROTATION_DONE if still else NO_ROTATION_FAILED
                self._updating_since = None

        self._after(seconds * SECOND, end)

    def icc(self, command: IccCommand) -> IccReply | None:
        """Runs a command of in-run compass calibration (Table 36); returns None if it is not possible now."""
        now = self._board.clock.now
        match command:
            case IccCommand.START:
                self._board.icc_since = now
                return IccReply(command)
            case IccCommand.STATE:
                return IccReply(command, active=self._board.icc_since is not None)
            case IccCommand.STOP if self._board.icc_since is not None:
                since, self._board.icc_since = self._board.icc_since, None
                return IccReply(command, icc_result(self._board.world.trajectory, since, now))
        return None

    def end(self) -> None:
        """Ends the measurement."""
        self._has_ended, self._board.icc_since = True, None
        if self._updating_since is not None:
            self._board.no_rotation = NO_ROTATION_FAILED
