"""The commands of the manual, one method per message, named like the message.

A ``req_`` method returns the value that was requested. A ``set_`` method returns None, or the value in effect
where the device acknowledges with one. `Device.command` returns the payload of an acknowledgement, if a
program needs it.

Every method sends one request, waits for the answer, and raises

- `StateError` if the state or the product of the device does not accept the command; nothing was sent,
- `ValueError` if a value does not fit the message or the product; nothing was sent,
- `DeviceError` if the device answers Error, `DecodeError` if the answer cannot be decoded,
- `XbusTimeout` if no answer comes, and `Disconnected` if the port is gone.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Sequence
from typing import Any

from xbus.device.channel import Channel
from xbus.device.filter_profile import filter_profile_command
from xbus.errors import DeviceError
from xbus.protocol import values as v
from xbus.protocol.configuration import Configuration, Firmware

__all__ = ["Commands"]


class Commands:
    """The raw commands of section 5.3, as `Device.commands`.

    `Device` itself has the commands that most programs need, with checks and follow-up steps that take more
    than one message: `Device.go_to_config`, `Device.set_output_configuration`, `Device.set_strings`,
    `Device.set_baudrate`, `Device.reset`.

    >>> import xbus
    >>> device = xbus.connect("sim:MTi-630")
    >>> with device.configure():
    ...     device.commands.set_location_id(7)
    ...     device.commands.req_location_id()
    7
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel

    def _ask(self, name: str, value: Any = None) -> Any:
        return self._channel.command(name, value).value

    def _set(self, name: str, value: Any = None) -> None:
        self._channel.command(name, value)

    # 5.3.2 Informational messages

    def req_did(self) -> int:
        """ReqDID (0x00): the device identifier: 64 bits on the 600-series and later, otherwise 32."""
        return int(self._ask("ReqDID"))

    def init_bus(self) -> tuple[int, ...]:
        """InitBus (0x02, reserved by the manual): the identifiers of the devices on the bus."""
        return tuple(self._ask("InitBus"))

    def req_product_code(self) -> str:
        """ReqProductCode (0x1C): such as ``MTi-630-8A1G6``."""
        return str(self._ask("ReqProductCode"))

    def req_hardware_version(self) -> v.HardwareVersion:
        """ReqHardwareVersion (0x1E): the hardware version, which limits the highest rates."""
        return v.HardwareVersion(*self._ask("ReqHardwareVersion"))

    def req_fw_rev(self) -> Firmware:
        """ReqFWRev (0x12): the firmware revision (Table 4)."""
        return Firmware(*self._ask("ReqFWRev"))

    def run_selftest(self) -> v.Selftest:
        """RunSelftest (0x24): a flag for each component that passed. Takes up to 3 s."""
        return v.Selftest(self._ask("RunSelftest"))

    # 5.3.3 Device-specific messages

    def req_baudrate(self) -> int | None:
        """ReqBaudrate (0x18): the stored baud rate in bits per second; None for a code outside Table 7.

        The stored baud rate takes effect at the next reset.
        """
        return v.baudrate(self._ask("ReqBaudrate"))

    def req_option_flags(self) -> v.OptionFlag:
        """ReqOptionFlags (0x48): the flags that are set (Table 8)."""
        return v.OptionFlag(self._ask("ReqOptionFlags"))

    def set_option_flags(self, set: int = 0, clear: int = 0) -> None:  # noqa: A002 - the manual's word
        """SetOptionFlags (0x48): sets and clears flags (Table 8). A flag in both arguments is set."""
        self._set("SetOptionFlags", v.OptionFlags(v.OptionFlag(set), v.OptionFlag(clear)))

    def req_location_id(self) -> int:
        """ReqLocationID (0x84): the number that the user gave the device."""
        return int(self._ask("ReqLocationID"))

    def set_location_id(self, location_id: int) -> None:
        """SetLocationID (0x84): a number of your choice, 0 to 65535."""
        self._set("SetLocationID", location_id)

    def restore_factory_def(self) -> None:
        """RestoreFactoryDef (0x0E): resets all settings to the factory defaults (section 7.1)."""
        self._set("RestoreFactoryDef")

    def req_transmit_delay(self) -> int:
        """ReqTransmitDelay (0xDC): delay between request and answer on RS485, in ticks of 1/29.4912 MHz."""
        return int(self._ask("ReqTransmitDelay"))

    def set_transmit_delay(self, delay: int) -> None:
        """SetTransmitDelay (0xDC): 590 to 65535 ticks of 1/29.4912 MHz (20 us to 2.2 ms)."""
        self._set("SetTransmitDelay", delay)

    def req_error_mode(self) -> int:
        """ReqErrorMode (0xDA, deprecated): 0 ignore, 1 count, 2 count and report, 3 report and stop."""
        return int(self._ask("ReqErrorMode"))

    def set_error_mode(self, mode: int) -> None:
        """SetErrorMode (0xDA, deprecated): 0 to 3 as in `req_error_mode`."""
        self._set("SetErrorMode", mode)

    # 5.3.4 Synchronization messages

    def req_sync_settings(self) -> tuple[v.SyncSetting, ...]:
        """ReqSyncSettings (0x2C): the functions of the synchronization lines (Tables 9 to 12)."""
        return tuple(self._ask("ReqSyncSettings"))

    def set_sync_settings(self, settings: Iterable[v.SyncSetting]) -> None:
        """SetSyncSettings (0x2C): replaces all settings, at most 10. An empty list clears them."""
        self._set("SetSyncSettings", tuple(settings))

    # 5.3.5 Configuration messages

    def req_configuration(self) -> Configuration:
        """ReqConfiguration (0x0C): the configuration, as it starts a log file (Tables 13 and 14)."""
        found: Configuration = self._ask("ReqConfiguration")
        return found

    def req_output_configuration(self) -> tuple[v.Output, ...]:
        """ReqOutputConfiguration (0xC0): the outputs, with the rates in effect in Hz."""
        return tuple(self._ask("ReqOutputConfiguration"))

    def req_string_output_type(self) -> v.StringOutput:
        """ReqStringOutputType (0x8E): the strings that replace MTData2."""
        return v.StringOutput(*self._ask("ReqStringOutputType"))

    def set_string_output_type(self, types: int, frequency: int | None = None) -> None:
        """SetStringOutputType (0x8E): strings that replace MTData2. No types switches back to MTData2.

        The new setting is read back: it sets whether the scanner looks for EM1000, the string that only
        its length distinguishes from noise, and recordings need the same information.

        Args:
            types: `StringType` flags.
            frequency: Hz, on the 600-series. On the other series, period and skip factor define the rate.
        """
        self._set("SetStringOutputType", v.StringOutput(v.StringType(types), frequency))
        with contextlib.suppress(DeviceError):
            self.req_string_output_type()

    def req_period(self) -> int:
        """ReqPeriod (0x04): the sampling period of strings and MTData, in 1/115200 s."""
        return int(self._ask("ReqPeriod"))

    def set_period(self, period: int) -> None:
        """SetPeriod (0x04): 225 to 1152 (512 to 100 Hz). Longer periods set the skip factor (Table 18)."""
        self._set("SetPeriod", period)

    def req_output_skip_factor(self) -> int:
        """ReqOutputSkipFactor (0xD4): outputs skipped between two; 65535: only on ReqData (Table 19).

        The rate of strings and MTData is 115200 / (period (skip factor + 1)) Hz.
        """
        return int(self._ask("ReqOutputSkipFactor"))

    def set_output_skip_factor(self, skip_factor: int) -> None:
        """SetOutputSkipFactor (0xD4): 0 to 65535 as in `req_output_skip_factor` (Table 19)."""
        self._set("SetOutputSkipFactor", skip_factor)

    def req_alignment_rotation(self, parameter: v.Alignment) -> v.AlignmentRotation:
        """ReqAlignmentRotation (0xEC): the rotation RotSensor or RotLocal (Table 20)."""
        found: v.AlignmentRotation = self._ask("ReqAlignmentRotation", parameter)
        return found

    def set_alignment_rotation(self, parameter: v.Alignment, quaternion: Sequence[float]) -> None:
        """SetAlignmentRotation (0xEC): a unit quaternion q0, q1, q2, q3 (Table 20)."""
        q0, q1, q2, q3 = map(float, quaternion)
        self._set("SetAlignmentRotation", v.AlignmentRotation(parameter, (q0, q1, q2, q3)))

    def req_ext_output_mode(self) -> v.ExtOutputMode:
        """ReqExtOutputMode (0x86): alternative UART, low latency of USB (Table 21)."""
        return v.ExtOutputMode(self._ask("ReqExtOutputMode"))

    def set_ext_output_mode(self, mode: v.ExtOutputMode) -> None:
        """SetExtOutputMode (0x86): flags as in `req_ext_output_mode`."""
        self._set("SetExtOutputMode", mode)

    def req_port_config(self) -> tuple[v.PortConfig, ...]:
        """ReqPortConfig (0x8C): the three ports: RS232, UART, and RS232 for RTCM (Table 22)."""
        return tuple(self._ask("ReqPortConfig"))

    def set_port_config(self, ports: Iterable[v.PortConfig]) -> None:
        """SetPortConfig (0x8C): all three ports. Takes effect at the next reset."""
        self._set("SetPortConfig", tuple(ports))

    def req_can_config(self) -> v.CanConfig:
        """ReqCanConfig (0xE6): the settings of the CAN transceiver."""
        found: v.CanConfig = self._ask("ReqCanConfig")
        return found

    def set_can_config(self, config: v.CanConfig) -> None:
        """SetCanConfig (0xE6): the settings of the CAN transceiver. They take effect at the next reset."""
        self._set("SetCanConfig", config)

    def req_can_output_config(self) -> tuple[v.CanOutput, ...]:
        """ReqCanOutputConfig (0xE8): the outputs on the CAN bus."""
        return tuple(self._ask("ReqCanOutputConfig"))

    def set_can_output_config(self, outputs: Iterable[v.CanOutput]) -> tuple[v.CanOutput, ...]:
        """SetCanOutputConfig (0xE8): at most 16 outputs on the CAN bus. Returns the outputs in effect."""
        return tuple(self._ask("SetCanOutputConfig", tuple(outputs)) or ())

    def req_data_length(self) -> int:
        """ReqDataLength (0x0A, legacy): bytes of the payload of MTData; 0 while MTData2 is sent."""
        return int(self._ask("ReqDataLength"))

    def req_output_mode(self) -> v.OutputMode:
        """ReqOutputMode (0xD0, legacy): the items of MTData.

        >>> import xbus
        >>> device = xbus.connect("sim:MTi")
        >>> with device.configure():
        ...     device.commands.req_output_mode()
        <OutputMode.ORIENTATION: 4>
        """
        return v.OutputMode(self._ask("ReqOutputMode"))

    def set_output_mode(self, mode: v.OutputMode | int) -> None:
        """SetOutputMode (0xD0, legacy): the items of MTData.

        `Device.set_output_configuration` sets mode, settings and rate from names of quantities.
        """
        self._set("SetOutputMode", mode)

    def req_output_settings(self) -> v.OutputSettings:
        """ReqOutputSettings (0xD2, legacy): the form of the items of MTData."""
        found: v.OutputSettings = self._ask("ReqOutputSettings")
        return found

    def set_output_settings(self, settings: v.OutputSettings | int) -> None:
        """SetOutputSettings (0xD2, legacy): the form of the items of MTData.

        >>> import xbus
        >>> from xbus.protocol import OutputMode, OutputSettings
        >>> device = xbus.connect("sim:MTi")
        >>> with device.configure():
        ...     device.commands.set_output_mode(OutputMode.CALIBRATED)
        ...     device.commands.set_output_settings(OutputSettings(magnetic_field=False))
        >>> list(device.read_sample())
        ['acceleration', 'rate_of_turn', 'packet_counter']
        """
        self._set("SetOutputSettings", settings)

    def req_emts(self) -> bytes:
        """ReqEmts (0x90, not in this manual): the encrypted settings memory, as it starts a log file."""
        return bytes(self._ask("ReqEmts", b"\x00\xff"))

    # 5.3.6 Data-related messages

    def req_data(self) -> None:
        """ReqData (0x34): asks for the latest sample, which then arrives like any other.

        Requires a SendLatest setting on the line SOFTWARE, or strings or MTData with skip factor 65535.

        >>> import xbus
        >>> device = xbus.connect("sim:MTi")
        >>> with device.configure():
        ...     device.commands.set_output_skip_factor(65535)
        >>> device.commands.req_data()
        >>> list(device.read_sample())
        ['quaternion', 'packet_counter']
        """
        self._set("ReqData")

    # 5.3.7 Filter messages

    def req_lat_lon_alt(self) -> v.LatLonAlt:
        """ReqLatLonAlt (0x6E): the stored position, which gives gravity and declination."""
        return v.LatLonAlt(*self._ask("ReqLatLonAlt"))

    def set_lat_lon_alt(self, lat: float, lon: float, alt: float) -> None:
        """SetLatLonAlt (0x6E): latitude and longitude in degrees, altitude in metres."""
        self._set("SetLatLonAlt", v.LatLonAlt(lat, lon, alt))

    def req_available_filter_profiles(self) -> tuple[v.AvailableProfile, ...]:
        """ReqAvailableFilterProfiles (0x62): the filter profiles of the device, without empty slots."""
        profiles = self._ask("ReqAvailableFilterProfiles")
        return tuple(profile for profile in profiles if profile.type)

    def req_filter_profile(self) -> v.FilterProfile | str:
        """ReqFilterProfile (0x64): version and number; on the 600-series, names joined by ``/``."""
        found: v.FilterProfile | str = self._ask("ReqFilterProfile")
        return found

    def set_filter_profile(self, profile: int | str) -> None:
        """SetFilterProfile (0x64): number or name (Table 30); on the 600-series, names joined by ``/``."""
        self._set(*filter_profile_command(profile, self._channel.session.support))

    def req_gnss_platform(self) -> v.GnssPlatform | int:
        """ReqGnssPlatform (0x76): the dynamic model of the GNSS receiver (Table 31)."""
        found: v.GnssPlatform | int = self._ask("ReqGnssPlatform")
        return found

    def set_gnss_platform(self, platform: v.GnssPlatform | int) -> None:
        """SetGnssPlatform (0x76): the dynamic model of the GNSS receiver (Table 31)."""
        self._set("SetGnssPlatform", platform)

    def req_gnss_lever_arm(self) -> v.GnssLeverArm:
        """ReqGnssLeverArm (0x68): the vector from the device to the antenna, in m (Table 32)."""
        return v.GnssLeverArm(*self._ask("ReqGnssLeverArm"))

    def set_gnss_lever_arm(self, x: float, y: float, z: float) -> None:
        """SetGnssLeverArm (0x68): from the device to the antenna, in m, in the axes of the device."""
        self._set("SetGnssLeverArm", v.GnssLeverArm(x, y, z))

    def req_gnss_receiver_settings(self) -> v.GnssReceiverSettings:
        """ReqGnssReceiverSettings (0xAC, not in this revision of the manual)."""
        found: v.GnssReceiverSettings = self._ask("ReqGnssReceiverSettings")
        return found

    def set_gnss_receiver_settings(self, settings: v.GnssReceiverSettings) -> None:
        """SetGnssReceiverSettings (0xAC, not in this revision of the manual)."""
        self._set("SetGnssReceiverSettings", settings)

    def reset_orientation(self, code: v.ResetCode | int) -> None:
        """ResetOrientation (0xA4, Table 33): a reset in Measurement State, or STORE in Config State."""
        self._set("ResetOrientation", code)

    def set_no_rotation(self, duration: int) -> None:
        """SetNoRotation (0x22): estimates the gyro bias; the device must not move for `duration` seconds.

        Bits 3 and 4 of the status word report the result.
        """
        self._set("SetNoRotation", duration)

    def store_filter_state(self) -> None:
        """StoreFilterState (0x8A, not in this revision of the manual)."""
        self._set("StoreFilterState")

    def req_utc_time(self) -> v.UtcTime:
        """ReqUTCTime (0x60): the UTC of the device (Table 35)."""
        found: v.UtcTime = self._ask("ReqUTCTime")
        return found

    def set_utc_time(self, time: v.UtcTime) -> None:
        """SetUTCTime (0x60): sets the UTC of the device. GNSS/INS devices take it from the receiver."""
        self._set("SetUTCTime", time)

    def adjust_utc_time(self, ticks: int) -> None:
        """AdjustUTCTime (0xA8): shifts UTC by a number of ticks of 0.1 ms (Table 34)."""
        self._set("AdjustUTCTime", ticks)

    def req_gnss_status(self) -> tuple[v.GnssChannel, ...]:
        """ReqGnssStatus (0xA6, legacy): the channels of the GPS receiver of an MTi-G."""
        return tuple(self._ask("ReqGnssStatus"))

    def req_heading(self) -> float:
        """ReqHeading (0x82, legacy): the heading offset in radians."""
        return float(self._ask("ReqHeading"))

    def set_heading(self, heading: float) -> None:
        """SetHeading (0x82, legacy): the heading offset in radians."""
        self._set("SetHeading", heading)

    def icc_command(self, command: v.IccCommand | int) -> v.IccReply:
        """IccCommand (0x74): in-run compass calibration (Table 36); STORE in Config State only."""
        found: v.IccReply = self._ask("IccCommand", command)
        return found

    def set_initial_heading(self, heading: float) -> None:
        """SetInitialHeading (0xD6): -180 to 180 degrees, for profiles without magnetic reference."""
        self._set("SetInitialHeading", heading)

    def forward_gnss_data(self, data: bytes) -> None:
        """ForwardGnssData (0xE2): sends bytes, such as RTCM corrections, to the GNSS receiver.

        Data that exceeds the maximum payload is split into several messages.
        """
        for start in range(0, len(data), v.MAX_REQUEST_PAYLOAD):
            self._set("ForwardGnssData", data[start : start + v.MAX_REQUEST_PAYLOAD])
