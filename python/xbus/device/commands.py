"""The commands of the manual, one method each, named as there.

Every method sends one request and waits for its answer. It raises

- `StateError` where device or product cannot take it now; nothing was sent then,
- `ValueError` where a value does not fit, or is something that the product cannot do; nothing was sent then,
- `DeviceError` where the device answers Error, `DecodeError` where its answer cannot be read,
- `XbusTimeout` where no answer comes, and `Disconnected` where the port is gone.

A ``req_`` method gives what was asked for. A ``set_`` method gives the bytes of the answer: most firmware
acknowledges a setting with none, some with the new value.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import Any

from xbus.device.session import Reply
from xbus.protocol import values as v
from xbus.protocol.configuration import Configuration, Firmware
from xbus.protocol.products import Support

__all__ = ["Commands"]

#: The longest payload of a message to the device (section 5.1).
LONGEST = 2048


class Commands(ABC):
    """The commands of section 5.3, on top of `command`, which carries one out."""

    @property
    @abstractmethod
    def support(self) -> Support | None:
        """What the product supports; None until its identity has been read."""

    @abstractmethod
    def command(self, name: str, value: Any = None) -> Reply:
        """Sends a command by the manual's name and waits for its answer."""

    def _ask(self, name: str, value: Any = None) -> Any:
        return self.command(name, value).value

    def _set(self, name: str, value: Any = None) -> bytes:
        return self.command(name, value).payload

    # 5.3.1 WakeUp and state messages

    def go_to_config(self) -> None:
        """GoToConfig (0x30): enters Config State, or confirms it.

        A device that sends a lot, or has just woken up, may miss it; so it is sent again every 0.2 s, for
        2 s.
        """
        self._ask("GoToConfig")

    def go_to_measurement(self) -> None:
        """GoToMeasurement (0x10): enters Measurement State; samples follow."""
        self._ask("GoToMeasurement")

    # 5.3.2 Informational messages

    def req_did(self) -> int:
        """ReqDID (0x00): the device identifier, 32 bits, from the 600-series on 64."""
        return int(self._ask("ReqDID"))

    def init_bus(self) -> tuple[int, ...]:
        """InitBus (0x02, which the manual reserves): the identifiers of the devices on the bus."""
        return tuple(self._ask("InitBus"))

    def req_product_code(self) -> str:
        """ReqProductCode (0x1C): such as ``MTi-630-8A1G6``."""
        return str(self._ask("ReqProductCode"))

    def req_hardware_version(self) -> v.HardwareVersion:
        """ReqHardwareVersion (0x1E): the version of the hardware, on which the high rates depend."""
        return v.HardwareVersion(*self._ask("ReqHardwareVersion"))

    def req_fw_rev(self) -> Firmware:
        """ReqFWRev (0x12): the revision of the firmware (Table 4)."""
        return Firmware(*self._ask("ReqFWRev"))

    def run_selftest(self) -> v.Selftest:
        """RunSelftest (0x24): a flag for each part that passed. Takes up to 3 s."""
        return v.Selftest(self._ask("RunSelftest"))

    # 5.3.3 Device-specific messages

    def req_baudrate(self) -> int | None:
        """ReqBaudrate (0x18): bits per second as stored; None for a code that Table 7 does not have.

        What is stored takes effect at the next reset.
        """
        return v.baudrate(self._ask("ReqBaudrate"))

    def req_option_flags(self) -> v.OptionFlag:
        """ReqOptionFlags (0x48): the flags that are set (Table 8)."""
        return v.OptionFlag(self._ask("ReqOptionFlags"))

    def set_option_flags(self, set: int = 0, clear: int = 0) -> bytes:  # noqa: A002 - the manual's word
        """SetOptionFlags (0x48): sets flags and clears flags; one that is in both is set (Table 8)."""
        return self._set("SetOptionFlags", v.OptionFlags(v.OptionFlag(set), v.OptionFlag(clear)))

    def req_location_id(self) -> int:
        """ReqLocationID (0x84): the user's number."""
        return int(self._ask("ReqLocationID"))

    def set_location_id(self, location_id: int) -> bytes:
        """SetLocationID (0x84): any number from 0 to 65535."""
        return self._set("SetLocationID", location_id)

    def restore_factory_def(self) -> bytes:
        """RestoreFactoryDef (0x0E): discards all settings (section 7.1)."""
        return self._set("RestoreFactoryDef")

    def req_transmit_delay(self) -> int:
        """ReqTransmitDelay (0xDC): ticks of 1/29.4912 MHz between a request and its answer on RS485."""
        return int(self._ask("ReqTransmitDelay"))

    def set_transmit_delay(self, delay: int) -> bytes:
        """SetTransmitDelay (0xDC): 590 to 65535 ticks of 1/29.4912 MHz (20 us to 2.2 ms)."""
        return self._set("SetTransmitDelay", delay)

    def req_error_mode(self) -> int:
        """ReqErrorMode (0xDA, deprecated): 0 ignore, 1 count, 2 count and report, 3 report and stop."""
        return int(self._ask("ReqErrorMode"))

    def set_error_mode(self, mode: int) -> bytes:
        """SetErrorMode (0xDA, deprecated): 0 to 3, see `req_error_mode`."""
        return self._set("SetErrorMode", mode)

    # 5.3.4 Synchronization messages

    def req_sync_settings(self) -> tuple[v.SyncSetting, ...]:
        """ReqSyncSettings (0x2C): what the synchronization lines do (Tables 9 to 12)."""
        return tuple(self._ask("ReqSyncSettings"))

    def set_sync_settings(self, settings: Iterable[v.SyncSetting]) -> bytes:
        """SetSyncSettings (0x2C): replaces all of them, 10 at most; none clears them."""
        return self._set("SetSyncSettings", tuple(settings))

    # 5.3.5 Configuration messages

    def req_configuration(self) -> Configuration:
        """ReqConfiguration (0x0C): the configuration for the head of a log (Tables 13 and 14)."""
        found: Configuration = self._ask("ReqConfiguration")
        return found

    def req_output_configuration(self) -> tuple[v.Output, ...]:
        """ReqOutputConfiguration (0xC0): data identifiers and the rates in effect, Hz."""
        return tuple(self._ask("ReqOutputConfiguration"))

    def req_string_output_type(self) -> v.StringOutput:
        """ReqStringOutputType (0x8E): the strings that take the place of MTData2."""
        return v.StringOutput(*self._ask("ReqStringOutputType"))

    def set_string_output_type(self, types: int, frequency: int | None = None) -> bytes:
        """SetStringOutputType (0x8E): strings in the place of MTData2; none of them switches back.

        Args:
            types: `StringType` flags.
            frequency: Hz, on the 600-series; the others take it from period and skip factor.
        """
        return self._set("SetStringOutputType", v.StringOutput(v.StringType(types), frequency))

    def req_period(self) -> int:
        """ReqPeriod (0x04): the sampling period for strings, 1/115200 s."""
        return int(self._ask("ReqPeriod"))

    def set_period(self, period: int) -> bytes:
        """SetPeriod (0x04): 225 to 1152, 512 to 100 Hz; longer ones set the skip factor (Table 18)."""
        return self._set("SetPeriod", period)

    def req_output_skip_factor(self) -> int:
        """ReqOutputSkipFactor (0xD4): strings left out between two; 65535: only on ReqData (Table 19)."""
        return int(self._ask("ReqOutputSkipFactor"))

    def set_output_skip_factor(self, skip_factor: int) -> bytes:
        """SetOutputSkipFactor (0xD4), see `req_output_skip_factor` (Table 19)."""
        return self._set("SetOutputSkipFactor", skip_factor)

    def req_alignment_rotation(self, parameter: v.Alignment) -> v.AlignmentRotation:
        """ReqAlignmentRotation (0xEC): RotSensor or RotLocal (Table 20)."""
        found: v.AlignmentRotation = self._ask("ReqAlignmentRotation", parameter)
        return found

    def set_alignment_rotation(self, parameter: v.Alignment, quaternion: Sequence[float]) -> bytes:
        """SetAlignmentRotation (0xEC): q0, q1, q2, q3 of a rotation, length 1 (Table 20)."""
        q0, q1, q2, q3 = map(float, quaternion)
        return self._set("SetAlignmentRotation", v.AlignmentRotation(parameter, (q0, q1, q2, q3)))

    def req_ext_output_mode(self) -> v.ExtOutputMode:
        """ReqExtOutputMode (0x86): alternative UART, low latency of USB (Table 21)."""
        return v.ExtOutputMode(self._ask("ReqExtOutputMode"))

    def set_ext_output_mode(self, mode: v.ExtOutputMode) -> bytes:
        """SetExtOutputMode (0x86), see `req_ext_output_mode`."""
        return self._set("SetExtOutputMode", mode)

    def req_port_config(self) -> tuple[v.PortConfig, ...]:
        """ReqPortConfig (0x8C): RS232, UART, and the RS232 that takes RTCM (Table 22)."""
        return tuple(self._ask("ReqPortConfig"))

    def set_port_config(self, ports: Iterable[v.PortConfig]) -> bytes:
        """SetPortConfig (0x8C): all three; takes effect at the next reset."""
        return self._set("SetPortConfig", tuple(ports))

    def req_can_config(self) -> v.CanConfig:
        """ReqCanConfig (0xE6): the CAN transceiver."""
        found: v.CanConfig = self._ask("ReqCanConfig")
        return found

    def set_can_config(self, config: v.CanConfig) -> bytes:
        """SetCanConfig (0xE6): the CAN transceiver; takes effect at the next reset."""
        return self._set("SetCanConfig", config)

    def req_can_output_config(self) -> tuple[v.CanOutput, ...]:
        """ReqCanOutputConfig (0xE8): what is sent on the CAN bus."""
        return tuple(self._ask("ReqCanOutputConfig"))

    def set_can_output_config(self, outputs: Iterable[v.CanOutput]) -> tuple[v.CanOutput, ...]:
        """SetCanOutputConfig (0xE8): at most 16 lines; gives those in effect."""
        return tuple(self._ask("SetCanOutputConfig", tuple(outputs)) or ())

    def req_output_mode(self) -> int:
        """ReqOutputMode (0xD0, deprecated): the mode of the older MTData, which these products lack."""
        return int(self._ask("ReqOutputMode"))

    def set_output_mode(self, mode: int) -> bytes:
        """SetOutputMode (0xD0, deprecated); set_output_configuration has taken its place."""
        return self._set("SetOutputMode", mode)

    def req_output_settings(self) -> int:
        """ReqOutputSettings (0xD2, deprecated): settings of the older MTData, which these products lack."""
        return int(self._ask("ReqOutputSettings"))

    def set_output_settings(self, settings: int) -> bytes:
        """SetOutputSettings (0xD2, deprecated); set_output_configuration has taken its place."""
        return self._set("SetOutputSettings", settings)

    def req_emts(self) -> bytes:
        """ReqEmts (0x90, not in this manual): the memory of settings, encrypted; for the head of a log."""
        return bytes(self._ask("ReqEmts", b"\x00\xff"))

    # 5.3.6 Data-related messages

    def req_data(self) -> None:
        """ReqData (0x34): asks for the latest sample, which then comes like any other.

        It needs a SendLatest setting on the line SOFTWARE, or strings with skip factor 65535.
        """
        self.command("ReqData")

    # 5.3.7 Filter messages

    def req_lat_lon_alt(self) -> v.LatLonAlt:
        """ReqLatLonAlt (0x6E): the stored place, degrees and metres, for gravity and declination."""
        return v.LatLonAlt(*self._ask("ReqLatLonAlt"))

    def set_lat_lon_alt(self, lat: float, lon: float, alt: float) -> bytes:
        """SetLatLonAlt (0x6E): degrees, degrees, metres."""
        return self._set("SetLatLonAlt", v.LatLonAlt(lat, lon, alt))

    def req_available_filter_profiles(self) -> tuple[v.AvailableProfile, ...]:
        """ReqAvailableFilterProfiles (0x62): the filter profiles on board, without the empty slots."""
        return tuple(it for it in self._ask("ReqAvailableFilterProfiles") if it.type)

    def req_filter_profile(self) -> v.FilterProfile | str:
        """ReqFilterProfile (0x64): version and number; on the 600-series names joined by ``/``."""
        found: v.FilterProfile | str = self._ask("ReqFilterProfile")
        return found

    def set_filter_profile(self, profile: int | str) -> bytes:
        """SetFilterProfile (0x64): number or name (Table 30); on the 600-series names joined by ``/``."""
        modern = self.support is not None and "SetFilterProfileModern" in self.support.messages
        if isinstance(profile, str) and self.support is not None and not modern:
            numbers = {it.label.lower(): it.type for it in self.support.filter_profiles}
            if profile.lower() not in numbers:
                product = self.support.product.name
                raise ValueError(
                    f"the {product} has no filter profile {profile!r}; it has {', '.join(numbers)}"
                )
            profile = numbers[profile.lower()]
        return self._set(
            "SetFilterProfileModern" if isinstance(profile, str) else "SetFilterProfile", profile
        )

    def req_gnss_platform(self) -> v.GnssPlatform | int:
        """ReqGnssPlatform (0x76): the dynamic model of the GNSS receiver (Table 31)."""
        found: v.GnssPlatform | int = self._ask("ReqGnssPlatform")
        return found

    def set_gnss_platform(self, platform: v.GnssPlatform | int) -> bytes:
        """SetGnssPlatform (0x76): the dynamic model of the GNSS receiver (Table 31)."""
        return self._set("SetGnssPlatform", platform)

    def req_gnss_lever_arm(self) -> v.GnssLeverArm:
        """ReqGnssLeverArm (0x68): from the device to the antenna, m (Table 32)."""
        return v.GnssLeverArm(*self._ask("ReqGnssLeverArm"))

    def set_gnss_lever_arm(self, x: float, y: float, z: float) -> bytes:
        """SetGnssLeverArm (0x68): m, in the axes of the device."""
        return self._set("SetGnssLeverArm", v.GnssLeverArm(x, y, z))

    def req_gnss_receiver_settings(self) -> v.GnssReceiverSettings:
        """ReqGnssReceiverSettings (0xAC, not in this revision of the manual)."""
        found: v.GnssReceiverSettings = self._ask("ReqGnssReceiverSettings")
        return found

    def set_gnss_receiver_settings(self, settings: v.GnssReceiverSettings) -> bytes:
        """SetGnssReceiverSettings (0xAC, not in this revision of the manual)."""
        return self._set("SetGnssReceiverSettings", settings)

    def reset_orientation(self, code: v.ResetCode | int) -> bytes:
        """ResetOrientation (0xA4, Table 33): resets in Measurement State, and STORE in Config State."""
        return self._set("ResetOrientation", code)

    def set_no_rotation(self, duration: int) -> bytes:
        """SetNoRotation (0x22): takes the device to lie still for so many seconds, to find the gyro bias.

        The answer says nothing about the result: bits 3 and 4 of the status word do.
        """
        return self._set("SetNoRotation", duration)

    def store_filter_state(self) -> bytes:
        """StoreFilterState (0x8A, not in this revision of the manual)."""
        return self._set("StoreFilterState")

    def req_utc_time(self) -> v.UtcTime:
        """ReqUTCTime (0x60): the device's UTC (Table 35)."""
        found: v.UtcTime = self._ask("ReqUTCTime")
        return found

    def set_utc_time(self, time: v.UtcTime) -> bytes:
        """SetUTCTime (0x60). GNSS/INS devices set it themselves."""
        return self._set("SetUTCTime", time)

    def adjust_utc_time(self, ticks: int) -> bytes:
        """AdjustUTCTime (0xA8): moves UTC by so many times 0.1 ms (Table 34)."""
        return self._set("AdjustUTCTime", ticks)

    def icc_command(self, command: v.IccCommand | int) -> v.IccReply:
        """IccCommand (0x74): in-run compass calibration (Table 36); STORE in Config State only."""
        found: v.IccReply = self._ask("IccCommand", command)
        return found

    def set_initial_heading(self, heading: float) -> bytes:
        """SetInitialHeading (0xD6): degrees, -180 to 180, for profiles without a magnetic reference."""
        return self._set("SetInitialHeading", heading)

    def forward_gnss_data(self, data: bytes) -> None:
        """ForwardGnssData (0xE2): hands bytes, such as RTCM corrections, to the GNSS receiver.

        More than the manual's longest message holds goes as several.
        """
        for at in range(0, len(data), LONGEST):
            self.command("ForwardGnssData", data[at : at + LONGEST])
