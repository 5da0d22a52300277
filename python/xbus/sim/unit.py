"""The works of a virtual device: states, settings, and what requests and time do to them."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from xbus import _core
from xbus.protocol.configuration import Configuration
from xbus.protocol.ids import MessageId
from xbus.protocol.messages import decode, encode
from xbus.protocol.products import Identity, Support
from xbus.protocol.tables import MESSAGES, MessageRow
from xbus.protocol.values import (
    DeviceErrorInfo,
    ErrorCode,
    OptionFlag,
    State,
    SyncFunction,
    UtcTime,
)
from xbus.sim.clock import SECOND, Clock
from xbus.sim.commands import COMMANDS, Refused
from xbus.sim.framing import Request
from xbus.sim.measurement import Measurement, status_word
from xbus.sim.memory import Memory, UnitSettings, restored
from xbus.sim.motion import Trajectory
from xbus.sim.procedures import Rotation
from xbus.sim.receiver import Receiver
from xbus.sim.replay import Replay
from xbus.sim.sensors import Sensors
from xbus.sim.sync import SyncInputs

__all__ = ["MASTER", "Unit", "World"]

#: The bus identifier of a device by itself; the other one is for the first device of a bus (section 5.1).
MASTER, FIRST = 0xFF, 0x01
#: Bytes of EmtsData; an MTi-300 sends so many.
EMTS_SIZE = 1320
#: What the products say in Configuration beyond the manual: letter and version of the filter, as published.
_FILTERS = {30: ("I", (5, 1)), 300: ("I", (5, 1)), 710: ("7", (4, 1))}

#: Filter modes of the status word.
WITHOUT_GNSS, COASTING, WITH_GNSS = 0, 1, 3

#: Requests by MID.
_REQUESTS: dict[int, list[MessageRow]] = {}
for _row in MESSAGES.values():
    if _row.direction == "to device":
        _REQUESTS.setdefault(_row.mid, []).append(_row)


@dataclass(frozen=True)
class World:
    """What is around a virtual device, and does not depend on what it is set to.

    Attributes:
        trajectory: How it moves.
        noise: Strength of noise.
        seed: Of noise.
        utc: UTC when the device is made.
        time_to_fix: Seconds from power-up to the first GNSS fix.
        replay: A recording to send instead.
    """

    trajectory: Trajectory
    noise: float
    seed: int
    utc: np.datetime64
    time_to_fix: float
    replay: Replay | None


class Unit:
    """A device behind its port; `power_up` comes first.

    Args:
        clock: Its clock.
        world: What is around it.
        support: What it can do.
        identity: What it calls itself.
        settings: What it is set to at first.
        bus_id: Its bus identifier, with ConfigurableBusId.
        strict_outputs: See below.
        send: See below.
        restart: See below.

    Attributes:
        state: State.
        memory: Settings.
        measurement: What it does in Measurement; None in other states.
        receiver: GNSS receiver.
        calendar: UTC by the device's calendar when its clock was at zero.
        powered_at: When power came, in ns on the clock.
        no_rotation: The no-rotation update in the status word.
        reset_rotations: RotSensor and RotLocal after the orientation resets of the last Measurement, which
            can be stored in Config; None where there were none.
        sync_inputs: Counts of edges.
        strict_outputs: Whether an unsupported data identifier makes it refuse a whole configuration.
        send: Takes frames to the host.
        restart: Starts the device anew, once what it has said is out.
    """

    def __init__(
        self,
        clock: Clock,
        world: World,
        support: Support,
        identity: Identity,
        settings: UnitSettings,
        *,
        bus_id: int,
        strict_outputs: bool,
        send: Callable[[bytes], None],
        restart: Callable[[], None],
    ) -> None:
        self.clock, self.world = clock, world
        self.support, self.product = support, support.product
        self.identity: Identity = identity
        self.memory = Memory(settings)
        self.send, self.restart = send, restart
        self.receiver = Receiver(clock, world.time_to_fix, self._receiver_changed)
        self._bus_id = bus_id
        self.strict_outputs = strict_outputs

    @property
    def settings(self) -> UnitSettings:
        """Settings in use."""
        return self.memory.settings

    # The bus

    @property
    def bid(self) -> int:
        """The bus identifier of what is not a reply."""
        return self._bus_id if self._has_bus_id else MASTER

    def replies_as(self, bid: int) -> int | None:
        """The bus identifier of a reply; None where the message is for others.

        A stand-alone device answers to two of them. That 0 would be a broadcast is nowhere in the manual.
        """
        if self._has_bus_id:
            return self._bus_id if bid in (self._bus_id, MASTER) else None
        return bid if bid in (MASTER, FIRST) else None

    @property
    def _has_bus_id(self) -> bool:
        return bool(self.settings.option_flags & OptionFlag.ENABLE_CONFIGURABLE_BUS_ID)

    def say(self, mid: int, payload: bytes = b"") -> None:
        """Sends a message unasked."""
        self.send(_core.encode_frame(self.bid, mid, payload))

    # Requests

    def answer(self, request: Request) -> tuple[int, bytes] | None:
        """Does what is asked; MID and payload of the reply, or None where there is none."""
        try:
            row = self._row(request)
            if row is None:
                return None
            # What says nothing may carry anything: the vendor's software sends ReqConfiguration with two
            # bytes, and GoToConfig with thirty to get through whatever a device waits for.
            payload = b"" if row.lengths == (0,) else request.payload
            try:
                value = decode(row.name, payload)
            except ValueError:
                raise Refused(ErrorCode.PARAMETER) from None
            answer = COMMANDS[row.name](self, value)
        except Refused as refused:
            return MessageId.Error, encode("Error", DeviceErrorInfo(refused.code))
        return None if row.reply is None else (row.reply, answer)

    def _row(self, request: Request) -> MessageRow | None:
        """The message that a request is; None for one to pass over."""
        rows = [it for it in _REQUESTS.get(request.mid, ()) if it.name in self.support.messages]
        if not rows:
            raise Refused(ErrorCode.MESSAGE)
        # All messages with one MID are valid in the same states. The manual has no code for another state;
        # "message sent is invalid" comes next to it.
        if self.state not in rows[0].states and not self._is_taken_anyway(request.mid):
            if request.mid == MessageId.WakeUpAck:
                return None  # too late, and never answered
            raise Refused(ErrorCode.MESSAGE)
        length = len(request.payload)
        for row in rows:
            if row.lengths is None or length in row.lengths:
                return row
        if len(rows) == 1 and rows[0].lengths == (0,):
            return rows[0]
        # MT Manager sends 65 bytes: the text, spaces, and more behind them.
        if rows[-1].name == "SetFilterProfileModern":
            return rows[-1]
        raise Refused(ErrorCode.PARAMETER)

    def _is_taken_anyway(self, mid: int) -> bool:
        """Whoever missed WakeUp sends GoToConfig until it is answered."""
        return self.state is State.WAKEUP and mid == MessageId.GoToConfig

    # States

    def power_up(self) -> None:
        """Starts anew with the stored settings."""
        self.state = State.WAKEUP
        self.measurement: Measurement | None = None
        self.memory.load()
        self.no_rotation = 0
        self.reset_rotations: tuple[Rotation, Rotation] | None = None
        self.sync_inputs = SyncInputs(self.settings.sync_settings)
        self.powered_at = self.clock.now
        # Nothing keeps the time without power: the calendar starts where it did the first time.
        self.calendar = self.world.utc - _ns(self.clock.now)
        self.receiver.start()

    def restore_communication(self) -> None:
        """Sets what Table 41 lists to what it was at first."""
        self.memory.overwrite(restored(self.memory.stored, self.support))
        self.sync_inputs = SyncInputs(self.settings.sync_settings)

    def leave_wake_up(self) -> None:
        """What happens when nobody has answered WakeUp."""
        if self.state is not State.WAKEUP:
            return
        flags = self.settings.option_flags
        if flags & OptionFlag.DISABLE_AUTO_MEASUREMENT:
            self.go_to_config()
            return
        asked = flags & OptionFlag.ENABLE_CONFIG_MESSAGE_AT_STARTUP
        if asked or self.product.series != "1-series":
            self.say(MessageId.Configuration, self.configuration())
            self.say(MessageId.EmtsData, self.emts)
        self.go_to_measurement()

    def go_to_config(self) -> None:
        """Enters Config, or stays there."""
        if self.measurement is not None:
            self.measurement.end()
            # They can be stored until Measurement begins anew.
            self.reset_rotations = self.measurement.rot_sensor, self.measurement.rot_local
        self.state, self.measurement = State.CONFIG, None

    def go_to_measurement(self) -> None:
        """Enters Measurement."""
        self.reset_rotations = None
        self.state, self.measurement = State.MEASUREMENT, Measurement(self)

    # What it knows

    def configuration(self) -> bytes:
        """The payload of Configuration (Tables 13 and 14)."""
        settings, series = self.settings, self.product.series
        profile = settings.filter_profile
        letter, version = _FILTERS.get(self.product.number, (None, (0, 0)))
        is_old = series in ("10-series", "100-series")
        return encode(
            "Configuration",
            Configuration(
                device_id=self.identity.device_id,
                product_code=self.identity.product_code if series == "600-series" else None,
                sampling_period=settings.period if is_old else 0,
                output_skip_factor=settings.output_skip_factor if is_old else 0,
                date=None,
                time=None,
                devices=1,
                filter_profile=profile if isinstance(profile, int) else 0,
                firmware=self.identity.firmware,
                output_mode=0,
                output_settings=1 if is_old else 0,
                filter_type=letter,
                filter_version=version,
            ),
        )

    @cached_property
    def emts(self) -> bytes:
        """The payload of EmtsData: nobody outside knows what it says."""
        return random.Random(self.identity.device_id).randbytes(EMTS_SIZE)  # noqa: S311

    def utc_time(self) -> UtcTime:
        """What the calendar says."""
        row = self.sensors().utc_time(np.array([self.clock.now]))[0]
        return UtcTime(*row.tolist())

    @property
    def utc(self) -> np.datetime64:
        """The calendar's time."""
        return self.calendar + _ns(self.clock.now)

    def set_utc(self, utc: np.datetime64) -> None:
        """Sets the calendar; one that goes by GNSS stays right."""
        if not self._has_fix:
            self.calendar = utc - _ns(self.clock.now)

    def sensors(self) -> Sensors:
        """What is measured now; its time is that of the clock."""
        measurement, settings = self.measurement, self.settings
        return Sensors(
            self.world.trajectory,
            self.product,
            rot_sensor=measurement.rot_sensor if measurement else settings.rot_sensor.quaternion,
            rot_local=measurement.rot_local if measurement else settings.rot_local.quaternion,
            noise=self.world.noise,
            seed=self.world.seed,
            utc=self.calendar,
            time_to_fix=self.receiver.fix_at / SECOND,
            rtk=self.receiver.rtk,
        )

    @property
    def _has_fix(self) -> bool:
        return self.product.kind == "GNSS/INS" and self.receiver.has_fix

    def status(self) -> int:
        """The lasting part of the status word (Table 27)."""
        has_fix, is_coasting = self._has_fix, self.receiver.is_coasting
        kind, measurement = self.product.kind, self.measurement
        return status_word(
            selftest=self.product.series != "600-series",
            # An IMU has no filter, and the one of a GNSS/INS needs a position.
            filter_valid=has_fix or is_coasting if kind == "GNSS/INS" else kind != "IMU",
            gnss_fix=has_fix,
            no_rotation_update_status=self.no_rotation,
            representative_motion=measurement is not None and measurement.icc_since is not None,
            clock_bias_estimation=self._is_clock_synced,
            filter_mode=WITH_GNSS if has_fix else COASTING if is_coasting else WITHOUT_GNSS,
            have_gnss_time_pulse=has_fix,
            rtk_status=self.receiver.rtk,
        )

    @property
    def _is_clock_synced(self) -> bool:
        """Whether the clock bias is estimated: by pulses of the receiver, which needs no wire here."""
        if self._has_fix:
            functions = [it.function for it in self.settings.sync_settings]
            return SyncFunction.CLOCK_BIAS_ESTIMATION in functions
        return self.sync_inputs.is_clock_synced(self.clock.now)

    def _receiver_changed(self) -> None:
        if self._has_fix:
            self.calendar = self.world.utc
        if self.measurement is not None:
            self.measurement.sensors_changed()


def _ns(nanoseconds: int) -> np.timedelta64:
    return np.timedelta64(nanoseconds, "ns")
