"""The board of a virtual device: settings, calendar, receiver, sensors and status."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from xbus import _core
from xbus.protocol.configuration import Configuration
from xbus.protocol.messages import encode
from xbus.protocol.products import LEGACY, FactoryIdentity, Support
from xbus.protocol.tables import MASTER, STATUS_FLAGS, device_of
from xbus.protocol.values import GnssChannel, OptionFlag, SyncFunction, UtcTime
from xbus.sim.clock import SECOND, Clock
from xbus.sim.memory import Memory, UnitSettings, restored
from xbus.sim.motion import Trajectory
from xbus.sim.mtdata import mtdata_size
from xbus.sim.procedures import Rotation
from xbus.sim.receiver import Receiver
from xbus.sim.replay import Replay
from xbus.sim.sensors import Sensors, Ticks
from xbus.sim.sync import SyncInputs

__all__ = ["Board", "World", "status_word"]

#: Bytes of EmtsData, as on an MTi-300.
EMTS_SIZE = 1320
#: Filter modes of the status word.
WITHOUT_GNSS, COASTING, WITH_GNSS = 0, 1, 3


def status_word(**fields: int) -> int:
    """Returns the status word with these fields (Table 27)."""
    return sum(int(value) << STATUS_FLAGS[name].bit for name, value in fields.items())


@dataclass(frozen=True)
class World:
    """The surroundings of a virtual device, which do not depend on its settings.

    Attributes:
        trajectory: The motion.
        noise: Strength of the noise.
        seed: Seed of the noise.
        utc: UTC when the device is created.
        time_to_fix: Seconds from power-up to the first GNSS fix.
        replay: A recording to send instead of computed samples.
    """

    trajectory: Trajectory
    noise: float
    seed: int
    utc: np.datetime64
    time_to_fix: float
    replay: Replay | None


class Board:
    """What a virtual device has in every state. Call `power_up` first.

    Args:
        clock: The device's clock.
        world: The surroundings.
        support: The abilities of the product.
        identity: The identity.
        settings: The settings at first.
        bus_id: Bus identifier in effect with EnableConfigurableBusId.
        strict_outputs: Whether one unsupported data identifier makes the device refuse a configuration.
        send: Called with each frame to the host.
        restart: Called to restart the device after its reply has been sent.

    Attributes:
        memory: The settings.
        receiver: GNSS receiver.
        calendar: UTC of the device's calendar at time zero of the clock.
        powered_at: Time of power-up, in ns on the clock.
        can_bitrate: Bits per second on CAN, which change at power-up only; None for an unknown code.
        no_rotation: State of the no-rotation update in the status word.
        icc_since: Start of the representative motion in ns; None outside a representative motion.
        rotations: RotSensor and RotLocal in effect in Measurement; orientation resets change them. In
            Config, those of the last Measurement, which can be stored; None if there are none.
        sync_inputs: Counters of edges.
    """

    def __init__(
        self,
        clock: Clock,
        world: World,
        support: Support,
        identity: FactoryIdentity,
        settings: UnitSettings,
        *,
        bus_id: int,
        strict_outputs: bool,
        send: Callable[[bytes], None],
        restart: Callable[[], None],
    ) -> None:
        self.clock, self.world = clock, world
        self.support, self.product = support, support.product
        self.identity = identity
        self.memory = Memory(settings)
        self.send, self.restart = send, restart
        self.receiver = Receiver(clock, world.time_to_fix, self.receiver_changed)
        self._bus_id = bus_id
        self.strict_outputs = strict_outputs

    def power_up(self) -> None:
        """Starts with the stored settings."""
        self.memory.load()
        self.no_rotation = 0
        self.icc_since: int | None = None
        self.rotations: tuple[Rotation, Rotation] | None = None
        self.sync_inputs = SyncInputs(self.settings.sync_settings)
        self.powered_at = self.clock.now
        self.can_bitrate = self.settings.can_config.baudrate
        # Without power the time is lost: the calendar starts with the same time at each power-up.
        self.calendar = self.world.utc - _ns(self.clock.now)
        self.receiver.start()

    def receiver_changed(self) -> None:
        """Handles a change of the fix or its RTK status."""
        if self._has_fix:
            self.calendar = self.world.utc

    @property
    def settings(self) -> UnitSettings:
        """Settings in use."""
        return self.memory.settings

    @property
    def alignment(self) -> tuple[Rotation, Rotation]:
        """RotSensor and RotLocal of the settings."""
        return self.settings.rot_sensor.quaternion, self.settings.rot_local.quaternion

    def restore_communication(self) -> None:
        """Restores the factory values of the settings in Table 41."""
        self.memory.overwrite(restored(self.memory.stored, self.support))
        self.sync_inputs = SyncInputs(self.settings.sync_settings)

    # The bus

    @property
    def bid(self) -> int:
        """The bus identifier of messages other than replies."""
        return self._bus_id if self._has_bus_id else MASTER

    def replies_as(self, bid: int) -> int | None:
        """Returns the bus identifier of a reply; None if the message is for another device.

        A stand-alone device answers to two bus identifiers. The manual does not define 0 as a broadcast.
        """
        if self._has_bus_id:
            return self._bus_id if bid in (self._bus_id, MASTER) else None
        return bid if device_of(bid) == device_of(MASTER) else None

    @property
    def _has_bus_id(self) -> bool:
        return bool(self.settings.option_flags & OptionFlag.ENABLE_CONFIGURABLE_BUS_ID)

    def send_message(self, mid: int, payload: bytes = b"") -> None:
        """Sends a message that is not a reply."""
        self.send(_core.encode_frame(self.bid, mid, payload))

    # MTData

    @property
    def is_in_legacy_mode(self) -> bool:
        """Whether the device answers the messages about MTData.

        Devices of the 10- and 100-series do so while they have no other output.
        """
        if self.support.is_legacy:
            return True
        return bool(self.support.output_modes) and not self.settings.output_configuration

    @property
    def sends_mtdata(self) -> bool:
        """Whether the device sends MTData in Measurement."""
        return self.is_in_legacy_mode and (
            self.support.is_legacy or bool(self.settings.output_mode)
        )

    @property
    def data_length(self) -> int:
        """Bytes of the payload of MTData; 0 if the device does not send MTData."""
        if not self.sends_mtdata:
            return 0
        return mtdata_size(self.settings.output_mode, self.settings.output_settings)

    def channels(self) -> tuple[GnssChannel, ...]:
        """Returns the channels of the GPS receiver."""
        tick = Ticks(self.clock.now, 1, SECOND)
        return tuple(GnssChannel(*row) for row in self.sensors().channels(tick)[0].tolist())

    # Information

    def configuration(self) -> bytes:
        """Returns the payload of Configuration (Tables 13 and 14)."""
        settings, series = self.settings, self.product.series
        profile = settings.filter_profile
        letter, version = self.support.filter_version
        is_old = series in ("10-series", "100-series", LEGACY)
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
                output_mode=int(settings.output_mode),
                output_settings=int(settings.output_settings) if is_old else 0,
                data_length=self.data_length,
                filter_type=letter,
                filter_version=version,
            ),
        )

    @cached_property
    def emts(self) -> bytes:
        """The payload of EmtsData. Its content is not documented, so it is random."""
        return random.Random(self.identity.device_id).randbytes(EMTS_SIZE)  # noqa: S311

    def utc_time(self) -> UtcTime:
        """Returns the time of the calendar as the fields of UTCTime."""
        row = self.sensors().utc_time(np.array([self.clock.now]))[0]
        return UtcTime(*row.tolist())

    @property
    def utc(self) -> np.datetime64:
        """The time of the calendar."""
        return self.calendar + _ns(self.clock.now)

    def set_utc(self, utc: np.datetime64) -> None:
        """Sets the calendar; with a fix it follows GNSS and does not change."""
        if not self._has_fix:
            self.calendar = utc - _ns(self.clock.now)

    def sensors(self) -> Sensors:
        """Returns the sensors with the current alignment rotations, calendar and fix."""
        rot_sensor, rot_local = self.rotations or self.alignment
        return Sensors(
            self.world.trajectory,
            self.product,
            rot_sensor=rot_sensor,
            rot_local=rot_local,
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
        """Returns the status word (Table 27) without its momentary flags."""
        has_fix, is_coasting = self._has_fix, self.receiver.is_coasting
        kind = self.product.kind
        return status_word(
            selftest=self.product.series != "600-series",
            # An IMU has no filter, and the filter of a GNSS/INS needs a position.
            filter_valid=has_fix or is_coasting if kind == "GNSS/INS" else kind != "IMU",
            gnss_fix=has_fix,
            no_rotation_update_status=self.no_rotation,
            representative_motion=self.icc_since is not None,
            clock_bias_estimation=self._is_clock_synced,
            filter_mode=WITH_GNSS if has_fix else COASTING if is_coasting else WITHOUT_GNSS,
            have_gnss_time_pulse=has_fix,
            rtk_status=self.receiver.rtk,
        )

    @property
    def _is_clock_synced(self) -> bool:
        """Whether the clock bias is estimated. With a fix the pulses of the receiver are the reference."""
        if self._has_fix:
            functions = [setting.function for setting in self.settings.sync_settings]
            return SyncFunction.CLOCK_BIAS_ESTIMATION in functions
        return self.sync_inputs.is_clock_synced(self.clock.now)


def _ns(nanoseconds: int) -> np.timedelta64:
    return np.timedelta64(nanoseconds, "ns")
