"""What a virtual device is set to, and what of it lasts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from xbus.protocol.products import Support
from xbus.protocol.values import (
    PERIODS,
    TRANSMIT_DELAYS,
    Alignment,
    AlignmentRotation,
    CanConfig,
    CanOutput,
    ExtOutputMode,
    GnssLeverArm,
    GnssPlatform,
    GnssReceiver,
    GnssReceiverSettings,
    LatLonAlt,
    OptionFlag,
    Output,
    PortConfig,
    PortProtocol,
    StringOutput,
    StringType,
    SyncSetting,
    baud_code,
    baudrate,
)

__all__ = ["NO_ROTATION", "Memory", "Settings", "factory_settings", "restored"]

NO_ROTATION = (1.0, 0.0, 0.0, 0.0)
#: Default of 7.2.1.
DEFAULT_BAUDRATE = 115_200
#: The place that devices come with (seen in published settings).
FACTORY_PLACE = LatLonAlt(52.24049169408207, 6.838216771186439, 0.0)
#: Table 41.
DEFAULT_ERROR_MODE = 1

#: Receivers that come with the products, as in published settings; an MTi-670 has none of its own.
_RECEIVERS = {
    7: GnssReceiverSettings(GnssReceiver.MAX_M8Q, baud_code(115_200), 4),
    670: GnssReceiverSettings(GnssReceiver.MAX_M8Q, baud_code(115_200), 4),
    680: GnssReceiverSettings(GnssReceiver.ZED_F9P, baud_code(230_400), 4),
}
_NO_PORT = PortConfig(PortProtocol.NONE, 0)


@dataclass(frozen=True)
class Settings:
    """All settings of a device, as the messages carry them; those that a product lacks mean nothing there.

    Attributes:
        outputs: Output configuration, with the rates in effect.
        strings: Strings to send instead of MTData2, if any.
        period: Of the strings, in 1/115200 s.
        skip_factor: Of the strings.
        sync: Synchronization settings.
        option_flags: Option flags.
        location_id: Location identifier.
        baud_code: Code of the baud rate, up to the 100-series.
        ports: The three ports of the 600-series (Table 22).
        can: CAN transceiver.
        can_outputs: CAN output configuration.
        rot_sensor: RotSensor.
        rot_local: RotLocal.
        ext_output_mode: Extended output mode.
        transmit_delay: In ticks of 1/29.4912 MHz.
        error_mode: Error mode.
        place: Stored latitude, longitude and altitude.
        filter_profile: Number, on the 600-series names; None on an IMU.
        platform: GNSS platform.
        lever_arm: GNSS lever arm.
        receiver: GNSS receiver.
        initial_heading: Degrees.
    """

    outputs: tuple[Output, ...]
    strings: StringOutput
    period: int
    skip_factor: int
    sync: tuple[SyncSetting, ...]
    option_flags: OptionFlag
    location_id: int
    baud_code: int
    ports: tuple[PortConfig, ...]
    can: CanConfig
    can_outputs: tuple[CanOutput, ...]
    rot_sensor: AlignmentRotation
    rot_local: AlignmentRotation
    ext_output_mode: ExtOutputMode
    transmit_delay: int
    error_mode: int
    place: LatLonAlt
    filter_profile: int | str | None
    platform: GnssPlatform
    lever_arm: GnssLeverArm
    receiver: GnssReceiverSettings
    initial_heading: float

    @property
    def host_baud_code(self) -> int:
        """Code of the rate of the port to the host: on the 600-series the first one that speaks Xbus."""
        speaking = (it.baud_code for it in self.ports if it.protocol == PortProtocol.XBUS)
        return next(speaking, self.baud_code)

    @property
    def baudrate(self) -> int:
        """Bits per second of the port to the host, from the next start on."""
        return baudrate(self.host_baud_code) or DEFAULT_BAUDRATE

    def with_baud_code(self, code: int) -> Settings:
        """The same with another rate of the ports to the host."""
        ports = tuple(
            replace(it, baud_code=code) if it.protocol == PortProtocol.XBUS else it
            for it in self.ports
        )
        return replace(self, baud_code=code, ports=ports)


def factory_settings(support: Support) -> Settings:
    """How a product comes from the factory (Tables 2, 40 and 41)."""
    code, number = baud_code(DEFAULT_BAUDRATE), support.product.number
    host = PortConfig(PortProtocol.XBUS, code)
    ports: tuple[PortConfig, ...] = ()
    strings = StringOutput(StringType(0))
    if support.product.series == "600-series":
        # Table 22; the rate of the corrections is that of published settings.
        rtcm = PortConfig(PortProtocol.RTCM, baud_code(38_400))
        ports = (host, _NO_PORT, rtcm) if number == 680 else (host, host, _NO_PORT)
        strings = StringOutput(StringType(0), 0)
    return Settings(
        outputs=support.outputs,
        strings=strings,
        period=PERIODS[-1],
        skip_factor=0,
        sync=support.sync_settings,
        option_flags=OptionFlag(0),
        location_id=0,
        baud_code=code,
        ports=ports,
        can=CanConfig(0, enabled=False),
        can_outputs=(),
        rot_sensor=AlignmentRotation(Alignment.ROT_SENSOR, NO_ROTATION),
        rot_local=AlignmentRotation(Alignment.ROT_LOCAL, NO_ROTATION),
        ext_output_mode=ExtOutputMode(0),
        transmit_delay=TRANSMIT_DELAYS[0],
        error_mode=DEFAULT_ERROR_MODE,
        place=FACTORY_PLACE,
        filter_profile=support.filter_profile,
        platform=GnssPlatform.PORTABLE,
        lever_arm=GnssLeverArm(0.0, 0.0, 0.0),
        receiver=_RECEIVERS.get(number, GnssReceiverSettings(GnssReceiver.NONE, code, 0)),
        initial_heading=0.0,
    )


def restored(settings: Settings, support: Support) -> Settings:
    """The same after "restore communication": what Table 41 lists is as it came."""
    factory = factory_settings(support)
    return replace(
        settings,
        outputs=factory.outputs,
        baud_code=factory.baud_code,
        ports=factory.ports,
        period=factory.period,
        skip_factor=factory.skip_factor,
        sync=factory.sync,
        error_mode=factory.error_mode,
    )


class Memory:
    """Settings in use, and the ones that are there again after a start.

    Attributes:
        settings: In use.
        stored: In flash.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = self.stored = settings

    def change(self, **changes: Any) -> None:
        """Changes settings, at once and for good; unless DisableAutoStore is set, then until the next start.

        The flags themselves always last: the manual's example sets DisableAutoStore and clears
        DisableAutoMeasurement in one message, and the device then starts to measure at the next start.
        """
        self.settings = replace(self.settings, **changes)
        if (
            "option_flags" in changes
            or not self.settings.option_flags & OptionFlag.DISABLE_AUTO_STORE
        ):
            self.stored = replace(self.stored, **changes)

    def overwrite(self, settings: Settings) -> None:
        """Replaces all of it."""
        self.settings = self.stored = settings

    def load(self) -> None:
        """What a start does."""
        self.settings = self.stored
