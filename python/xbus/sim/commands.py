"""The requests that a virtual device answers: a table of messages and handlers.

A handler gets the device and the value of the request, and returns the payload of the reply. States, products
and lengths are checked before.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from xbus.protocol.ids import MessageId
from xbus.protocol.messages import decode, encode
from xbus.protocol.tables import MESSAGES, MessageRow
from xbus.protocol.values import (
    Alignment,
    AlignmentRotation,
    DeviceErrorInfo,
    ErrorCode,
    IccCommand,
    IccReply,
    ResetCode,
    State,
    UtcTime,
)
from xbus.sim.framing import Request
from xbus.sim.setting_commands import SETTING_COMMANDS, Refused, reply_with, require
from xbus.sim.unit import Unit

__all__ = ["COMMANDS", "answer"]

Handler: TypeAlias = Callable[[Unit, Any], bytes]

#: The unit of AdjustUTCTime, in ns.
UTC_TICK = 100_000

# States


def _go_to_config(unit: Unit, _: None) -> bytes:
    unit.go_to_config()
    return b""


def _go_to_measurement(unit: Unit, _: None) -> bytes:
    unit.go_to_measurement()
    return b""


def _reset(unit: Unit, _: None) -> bytes:
    unit.restart()
    return b""


# Data and GNSS


def _send_latest(unit: Unit, _: None) -> bytes:
    if unit.measurement is not None:
        unit.measurement.send_latest()
    return b""


def _forward_gnss_data(unit: Unit, data: bytes) -> bytes:
    unit.receiver.correct(data)
    return b""


# Filters


def _reset_orientation(unit: Unit, code: ResetCode | int) -> bytes:
    require(isinstance(code, ResetCode))
    require(code in unit.support.orientation_resets)
    # STORE is valid in Config only, the other codes in Measurement only.
    require((code == ResetCode.STORE) == (unit.state is State.CONFIG), ErrorCode.MESSAGE)
    if unit.measurement is not None:
        unit.measurement.reset_orientation(ResetCode(code))
    elif unit.rotations is not None:
        rot_sensor, rot_local = unit.rotations
        unit.memory.change(
            rot_sensor=AlignmentRotation(Alignment.ROT_SENSOR, rot_sensor),
            rot_local=AlignmentRotation(Alignment.ROT_LOCAL, rot_local),
        )
    return b""


def _store_filter_state(_unit: Unit, _: None) -> bytes:
    # A virtual device has no filter state.
    return b""


def _set_no_rotation(unit: Unit, seconds: int) -> bytes:
    require(seconds > 0)
    if unit.measurement is not None:
        unit.measurement.update_no_rotation(seconds)
    return b""


def _icc(unit: Unit, command: IccCommand | int) -> bytes:
    require(command in (IccCommand.START, IccCommand.STOP, IccCommand.STORE, IccCommand.STATE))
    # STORE is valid in Config only, the other commands in Measurement only (Table 36).
    require((command == IccCommand.STORE) == (unit.state is State.CONFIG), ErrorCode.MESSAGE)
    if unit.measurement is None:
        return encode("IccCommandAck", IccReply(command))
    reply = unit.measurement.icc(IccCommand(command))
    require(reply is not None, ErrorCode.MESSAGE)
    return encode("IccCommandAck", reply)


# Time


def _set_utc_time(unit: Unit, time: UtcTime) -> bytes:
    require(1999 <= time.year <= 2099 and time.ns <= 10**9)
    day = f"{time.year}-{time.month:02}-{time.day:02}"
    try:
        utc = np.datetime64(f"{day}T{time.hour:02}:{time.minute:02}:{time.second:02}", "ns")
    except ValueError:
        raise Refused(ErrorCode.PARAMETER) from None
    unit.set_utc(utc + np.timedelta64(time.ns, "ns"))
    return b""


def _adjust_utc_time(unit: Unit, ticks: int) -> bytes:
    unit.set_utc(unit.utc + np.timedelta64(ticks * UTC_TICK, "ns"))
    return b""


#: The handlers of all requests that some product knows, by name of the message in
#: `xbus.protocol.tables.MESSAGES`.
COMMANDS: dict[str, Handler] = {
    # 5.3.1
    "WakeUpAck": _go_to_config,
    "GoToConfig": _go_to_config,
    "GoToMeasurement": _go_to_measurement,
    "Reset": _reset,
    # 5.3.2
    "ReqDID": reply_with("DeviceID", lambda unit: unit.identity.device_id),
    "InitBus": reply_with("InitBusResults", lambda unit: [unit.identity.device_id & 0xFFFF_FFFF]),
    "ReqProductCode": reply_with("ProductCode", lambda unit: unit.identity.product_code),
    "ReqHardwareVersion": reply_with("HardwareVersion", lambda unit: unit.identity.hardware),
    "ReqFWRev": reply_with("FirmwareRev", lambda unit: unit.identity.firmware),
    "RunSelftest": reply_with("SelftestResults", lambda unit: unit.support.selftest),
    # 5.3.5
    "ReqConfiguration": lambda unit, _: unit.configuration(),
    "ReqEmts": lambda unit, _: unit.emts,
    "ReqDataLength": reply_with("DataLength", lambda unit: unit.data_length),
    "ReqGnssStatus": reply_with("GnssStatus", lambda unit: unit.channels()),
    # 5.3.6
    "ReqData": _send_latest,
    # 5.3.7
    "ResetOrientation": _reset_orientation,
    "StoreFilterState": _store_filter_state,
    "SetNoRotation": _set_no_rotation,
    "ReqUTCTime": reply_with("UTCTime", lambda unit: unit.utc_time()),
    "SetUTCTime": _set_utc_time,
    "AdjustUTCTime": _adjust_utc_time,
    "IccCommand": _icc,
    "ForwardGnssData": _forward_gnss_data,
    **SETTING_COMMANDS,
}

#: Requests by MID.
_REQUESTS: dict[int, list[MessageRow]] = {}
for _row in MESSAGES.values():
    if _row.direction == "to device":
        _REQUESTS.setdefault(_row.mid, []).append(_row)


def answer(unit: Unit, request: Request) -> tuple[int, bytes] | None:
    """Handles a request; returns MID and payload of the reply, or None without a reply."""
    try:
        row = _request_row(unit, request)
        if row is None:
            return None
        # The payload of an empty message is ignored: the vendor's software sends ReqConfiguration with
        # two bytes, and GoToConfig with thirty, which complete a frame that the device may wait for.
        payload = b"" if row.lengths == (0,) else request.payload
        try:
            value = decode(row.name, payload)
        except ValueError:
            raise Refused(ErrorCode.PARAMETER) from None
        reply = COMMANDS[row.name](unit, value)
    except Refused as refused:
        return MessageId.Error, encode("Error", DeviceErrorInfo(refused.code))
    return None if row.reply is None else (row.reply, reply)


def _request_row(unit: Unit, request: Request) -> MessageRow | None:
    """Returns the row of a request in the table of messages; None for a request to ignore."""
    known = _REQUESTS.get(request.mid, ())
    names = unit.support.messages
    if unit.is_in_legacy_mode:
        names |= unit.support.legacy_messages
    rows = [row for row in known if row.name in names]
    if not rows:
        raise Refused(ErrorCode.MESSAGE)
    # All messages with one MID are valid in the same states. The manual has no error code for a wrong
    # state; "message sent is invalid" is the closest.
    if unit.state not in rows[0].states and not _is_always_accepted(unit, request.mid):
        if request.mid == MessageId.WakeUpAck:
            return None  # too late, and without a reply
        raise Refused(ErrorCode.MESSAGE)
    length = len(request.payload)
    for row in rows:
        if row.lengths is None or length in row.lengths:
            return row
    if len(rows) == 1 and rows[0].lengths == (0,):
        return rows[0]
    # MT Manager sends 65 bytes: the text, spaces, and further bytes.
    if rows[-1].name == "SetFilterProfileModern":
        return rows[-1]
    raise Refused(ErrorCode.PARAMETER)


def _is_always_accepted(unit: Unit, mid: int) -> bool:
    """Returns whether a message is valid in WakeUp too: a host that missed WakeUp repeats GoToConfig."""
    return unit.state is State.WAKEUP and mid == MessageId.GoToConfig
