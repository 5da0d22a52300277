"""Settings of a virtual device, and their storage."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from xbus.protocol.products import DEFAULT_BAUDRATE, Support
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
    GnssReceiverSettings,
    LatLonAlt,
    OptionFlag,
    Output,
    OutputMode,
    OutputSettings,
    PortConfig,
    PortProtocol,
    StringOutput,
    StringType,
    SyncSetting,
    baud_code,
    baudrate,
)

__all__ = ["NO_ROTATION", "Memory", "UnitSettings", "factory_settings", "restored"]

#: The identity quaternion, q0 first.
NO_ROTATION = (1.0, 0.0, 0.0, 0.0)
#: Factory setting of latitude, longitude and altitude (seen in published settings).
FACTORY_PLACE = LatLonAlt(52.24049169408207, 6.838216771186439, 0.0)
#: Default error mode (Table 41).
DEFAULT_ERROR_MODE = 1


@dataclass(frozen=True)
class UnitSettings:
    """All settings of a device, as the messages carry them. Settings that a product lacks have no effect.

    Attributes:
        output_configuration: Output configuration, with the rates in effect.
        string_output_type: String outputs; if there are any, the device sends them instead of MTData2.
        period: Sampling period of strings and MTData, in 1/115200 s.
        output_skip_factor: Number of sampling periods to skip between two outputs.
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
        transmit_delay: Transmit delay, in ticks of 1/29.4912 MHz.
        error_mode: Error mode.
        lat_lon_alt: Stored latitude, longitude and altitude.
        filter_profile: Number of the filter profile, on the 600-series its names; None on an IMU.
        gnss_platform: GNSS platform.
        gnss_lever_arm: GNSS lever arm.
        gnss_receiver_settings: GNSS receiver.
        initial_heading: Initial heading in degrees.
        output_mode: Items of MTData.
        output_settings: Their form.
        heading: Heading offset of legacy products, in radians.
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
    output_mode: OutputMode
    output_settings: OutputSettings
    heading: float

    @property
    def host_baud_code(self) -> int:
        """Baud code of the port to the host: on the 600-series the first port with the Xbus protocol."""
        codes = (port.baud_code for port in self.port_config if port.protocol == PortProtocol.XBUS)
        return next(codes, self.baud_code)

    @property
    def baudrate(self) -> int:
        """Bits per second of the port to the host, in effect after the next start."""
        return baudrate(self.host_baud_code) or DEFAULT_BAUDRATE

    def with_baud_code(self, code: int) -> UnitSettings:
        """Returns a copy with another rate of the ports to the host."""
        ports = tuple(
            replace(port, baud_code=code) if port.protocol == PortProtocol.XBUS else port
            for port in self.port_config
        )
        return replace(self, baud_code=code, port_config=ports)


def factory_settings(support: Support) -> UnitSettings:
    """Returns the factory settings of a product (Tables 2, 40 and 41)."""
    return UnitSettings(
        output_configuration=support.output_configuration,
        string_output_type=StringOutput(StringType(0), 0 if support.strings_have_rate else None),
        period=PERIODS[-1],
        output_skip_factor=0,
        sync_settings=support.sync_settings,
        option_flags=OptionFlag(0),
        location_id=0,
        baud_code=baud_code(DEFAULT_BAUDRATE),
        port_config=support.port_config,
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
        gnss_receiver_settings=support.gnss_receiver_settings,
        initial_heading=0.0,
        # A new legacy device sends the quaternion; those of the 10- and 100-series were seen with mode 0.
        output_mode=OutputMode.ORIENTATION if support.is_legacy else OutputMode(0),
        output_settings=OutputSettings(),
        heading=0.0,
    )


def restored(settings: UnitSettings, support: Support) -> UnitSettings:
    """Returns the settings after "restore communication": those of Table 41 have their factory values."""
    factory = factory_settings(support)
    return replace(
        settings,
        output_configuration=factory.output_configuration,
        baud_code=factory.baud_code,
        port_config=factory.port_config,
        period=factory.period,
        output_skip_factor=factory.output_skip_factor,
        output_mode=factory.output_mode,
        output_settings=factory.output_settings,
        sync_settings=factory.sync_settings,
        error_mode=factory.error_mode,
    )


class Memory:
    """The settings in use, and the stored settings that a start loads.

    Attributes:
        settings: Settings in use.
        stored: Settings in flash.
    """

    def __init__(self, settings: UnitSettings) -> None:
        self.settings = self.stored = settings

    def change(self, **changes: Any) -> None:
        """Changes settings in use, and stores the changes unless DisableAutoStore is set.

        Option flags are always stored: the manual's example sets DisableAutoStore and clears
        DisableAutoMeasurement in one message, and the device then measures after its next start.
        """
        self.settings = replace(self.settings, **changes)
        if (
            "option_flags" in changes
            or not self.settings.option_flags & OptionFlag.DISABLE_AUTO_STORE
        ):
            self.stored = replace(self.stored, **changes)

    def overwrite(self, settings: UnitSettings) -> None:
        """Replaces all settings, in use and stored."""
        self.settings = self.stored = settings

    def load(self) -> None:
        """Loads the stored settings, at a start."""
        self.settings = self.stored
