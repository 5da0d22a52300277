"""A second decoder of MTData, written from the manuals and not from the tables of the package."""

from __future__ import annotations

import struct
from typing import Any

CONFIGURATION, OUTPUT_MODE, OUTPUT_SETTINGS = 0x0D, 0xD0, 0xD2
MTDATA = 0x32
WIDTHS = (4, 4, 6, 8)

#: What a GPS receiver of an MTi-G sends.
GPS_PVT = ("gps_pvt_data", "IiiiiiiIII", "itow lat lon height velN velE velD hAcc vAcc sAcc")

Item = tuple[str, int, bytes]


def layout(mode: int, settings: int) -> list[tuple[str, int, str]] | None:
    """The items of a payload: name, bytes, kind; None if it is not known.

    The kind is R for real numbers, or a format of `struct`; P is a pressure in steps of 2 Pa.
    """
    width = WIDTHS[settings >> 8 & 3]
    items: list[tuple[str, int, str]] = []

    def real(name: str, count: int) -> None:
        items.append((name, count * width, "R"))

    def integers(name: str, form: str) -> None:
        items.append((name, struct.calcsize(">" + form), form))

    def pressure() -> None:
        items.append(("baro_pressure", 2, "P"))

    if mode & 0x8000:
        return None
    if mode & 0x4000:
        integers("raw_acc_gyr_mag_temp", "9Hh")
        if settings & 1 << 24:
            integers("raw_gyro_temp", "3h")
    if mode & 0x0200:
        integers("device_id", "I")
        integers("time_sync", "B")
        integers("frame_range", "2H")
        real("gyro_bias", 3)
        real("delta_q", 4)
        real("delta_v", 3)
        integers("aiding", "B")
        pressure()
        real("magnetic_field", 3)
        integers("rssi", "b")
    if mode & 0x1000:
        pressure()
        integers("pressure_age", "B")
        if not settings & 1 << 19:
            integers("gps_pvt_data", GPS_PVT[1])
            integers("gnss_age", "B")
    if mode & 0x0001:
        real("temperature", 1)
        if settings & 1 << 24:
            real("gyro_temperature", 3)
    if mode & 0x0002:
        for bit, name in ((4, "acceleration"), (5, "rate_of_turn"), (6, "magnetic_field")):
            if not settings & 1 << bit:
                real(name, 3)
    if mode & 0x0004:
        form = settings >> 2 & 3
        if form == 3:
            return None
        real(("quaternion", "euler_angles", "rotation_matrix")[form], (4, 3, 9)[form])
    if mode & 0x0008:
        for bit, name in ((10, "analog_in1"), (11, "analog_in2")):
            if not settings & 1 << bit:
                integers(name, "H")
    if mode & 0x0010:
        if settings >> 14 & 7:
            return None
        real("lat_lon", 2)
        real("altitude_ellipsoid", 1)
    if mode & 0x0020:
        if settings >> 17 & 3:
            return None
        real("velocity_xyz", 3)
    if mode & 0x0800:
        integers(*(("status_word", "I") if settings & 1 << 7 else ("status_byte", "B")))
    if settings & 1:
        integers("packet_counter", "H")
    if settings & 2:
        integers("utc_time", "IH6B")
    if settings & 1 << 25:
        integers("sample_time_fine", "I")
    return items


def items_of(payload: bytes, mode: int, settings: int) -> list[tuple[str, Any, str]] | None:
    """The items of a payload: name, bytes, kind; None if it has another length."""
    found = layout(mode, settings)
    if not found or sum(size for _, size, _ in found) != len(payload):
        return None
    items, at = [], 0
    for name, size, kind in found:
        items.append((name, payload[at : at + size], kind))
        at += size
    return items


class Outputs:
    """The settings in force of devices that are alone on their bus."""

    def __init__(self) -> None:
        self.known: dict[tuple[int, int], int] = {}
        self.requested: dict[tuple[int, int], int] = {}

    def learn(self, bid: int, mid: int, payload: bytes) -> None:
        """Takes note of a message."""
        device, size = (1 if bid == 0xFF else bid), {OUTPUT_MODE: 2, OUTPUT_SETTINGS: 4}
        if mid == CONFIGURATION and len(payload) == 118 and payload[0] < 0x80 and any(payload[:4]):
            if payload[96:98] != b"\0\0" and payload[102:104] != b"\0\0":
                self.known[device, OUTPUT_MODE] = int.from_bytes(payload[104:106], "big")
                self.known[device, OUTPUT_SETTINGS] = int.from_bytes(payload[106:110], "big")
                self.requested = {
                    key: value for key, value in self.requested.items() if key[0] != device
                }
        elif mid in size:
            self.requested.pop((device, mid), None)
            if len(payload) == size[mid]:
                self.requested[device, mid] = int.from_bytes(payload, "big")
        elif mid - 1 in size:
            if len(payload) == size[mid - 1]:
                self.known[device, mid - 1] = int.from_bytes(payload, "big")
            elif not payload and (device, mid - 1) in self.requested:
                self.known[device, mid - 1] = self.requested.pop((device, mid - 1))

    def items(self, bid: int, payload: bytes) -> list[tuple[str, Any, str]] | None:
        """The items of an MTData message of this device, if it fits its settings."""
        device = 1 if bid == 0xFF else bid
        mode = self.known.get((device, OUTPUT_MODE))
        settings = self.known.get((device, OUTPUT_SETTINGS))
        return None if mode is None or settings is None else items_of(payload, mode, settings)

    def precision(self, bid: int) -> int:
        """The number format of a device."""
        return self.known[1 if bid == 0xFF else bid, OUTPUT_SETTINGS] >> 8 & 3

    def is_ned(self, bid: int) -> bool:
        """Whether orientation and velocity of a device are NED."""
        return bool(self.known[1 if bid == 0xFF else bid, OUTPUT_SETTINGS] >> 31)
