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

__all__ = ["NO_ROTATION", "Memory", "UnitSettings", "factory_settings", "restored"]

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
class UnitSettings:
    """All settings of a device, as the messages carry them; those that a product lacks mean nothing there.

    Attributes:
        output_configuration: Output configuration, with the rates in effect.
        string_output_type: Strings to send instead of MTData2, if any.
        period: Of the strings, in 1/115200 s.
        output_skip_factor: Of the strings.
        sync_settings: Synchronization settings.
        option_flags: Option flags.
        location_id: Location identifier.
        baud_code: Code of the baud rate, up to the 100-series.
        port_config: The three ports of the 600-series (Table 22).
        can_config: CAN transceiver.
        can_output_config: CAN output configuration.
        rot_sensor: RotSensor.
        rot_local: RotLocal.
        ext_output_mode: Extended output mode.
        transmit_delay: In ticks of 1/29.4912 MHz.
        error_mode: Error mode.
        lat_lon_alt: Stored latitude, longitude and altitude.
        filter_profile: Number, on the 600-series names; None on an IMU.
        gnss_platform: GNSS platform.
        gnss_lever_arm: GNSS lever arm.
        gnss_receiver_settings: GNSS receiver.
        initial_heading: Degrees.
    """

    output_configuration: tuple[Output, ...]
    string_output_type: StringOutput
    period: int
    output_skip_factor: int
    sync_settings: tuple[SyncSetting, ...]
    option_flags: OptionFlag
    location_id: int
    baud_code: int
    port_config: tuple[PortConfig, ...]
    can_config: CanConfig
    can_output_config: tuple[CanOutput, ...]
    rot_sensor: AlignmentRotation
    rot_local: AlignmentRotation
    ext_output_mode: ExtOutputMode
    transmit_delay: int
    error_mode: int
    lat_lon_alt: LatLonAlt
    filter_profile: int | str | None
    gnss_platform: GnssPlatform
    gnss_lever_arm: GnssLeverArm
    gnss_receiver_settings: GnssReceiverSettings
    initial_heading: float

    @property
    def host_baud_code(self) -> int:
        """Code of the rate of the port to the host: on the 600-series the first one that speaks Xbus."""
        speaking = (it.baud_code for it in self.port_config if it.protocol == PortProtocol.XBUS)
        return next(speaking, self.baud_code)

    @property
    def baudrate(self) -> int:
        """Bits per second of the port to the host, from the next start on."""
        return baudrate(self.host_baud_code) or DEFAULT_BAUDRATE

    def with_baud_code(self, code: int) -> UnitSettings:
        """The same with another rate of the ports to the host."""
        ports = tuple(
            replace(it, baud_code=code) if it.protocol == PortProtocol.XBUS else it
            for it in self.port_config
        )
        return replace(self, baud_code=code, port_config=ports)


def factory_settings(support: Support) -> UnitSettings:
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
    return UnitSettings(
        output_configuration=support.output_configuration,
        string_output_type=strings,
        period=PERIODS[-1],
        output_skip_factor=0,
        sync_settings=support.sync_settings,
        option_flags=OptionFlag(0),
        location_id=0,
        baud_code=code,
        port_config=ports,
        can_config=CanConfig(0, enabled=False),
        can_output_config=(),
        rot_sensor=AlignmentRotation(Alignment.ROT_SENSOR, NO_ROTATION),
        rot_local=AlignmentRotation(Alignment.ROT_LOCAL, NO_ROTATION),
        ext_output_mode=ExtOutputMode(0),
        transmit_delay=TRANSMIT_DELAYS[0],
        error_mode=DEFAULT_ERROR_MODE,
        lat_lon_alt=FACTORY_PLACE,
        filter_profile=support.filter_profile,
        gnss_platform=GnssPlatform.PORTABLE,
        gnss_lever_arm=GnssLeverArm(0.0, 0.0, 0.0),
        gnss_receiver_settings=_RECEIVERS.get(
            number, GnssReceiverSettings(GnssReceiver.NONE, code, 0)
        ),
        initial_heading=0.0,
    )


def restored(settings: UnitSettings, support: Support) -> UnitSettings:
    """The same after "restore communication": what Table 41 lists is as it came."""
    factory = factory_settings(support)
    return replace(
        settings,
        output_configuration=factory.output_configuration,
        baud_code=factory.baud_code,
        port_config=factory.port_config,
        period=factory.period,
        output_skip_factor=factory.output_skip_factor,
        sync_settings=factory.sync_settings,
        error_mode=factory.error_mode,
    )


class Memory:
    """Settings in use, and the ones that are there again after a start.

    Attributes:
        settings: In use.
        stored: In flash.
    """

    def __init__(self, settings: UnitSettings) -> None:
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

    def overwrite(self, settings: UnitSettings) -> None:
        """Replaces all of it."""
        self.settings = self.stored = settings

    def load(self) -> None:
        """What a start does."""
        self.settings = self.stored
