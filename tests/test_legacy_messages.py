"""Messages of legacy products, both ways: frames of other drivers and documents, and rebuilt ones."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from xbus import Coordinates, Message, Precision, Scanner, encode_frame
from xbus.protocol import (
    GnssChannel,
    OrientationForm,
    OutputMode,
    OutputSettings,
    decode,
    encode,
)
from xbus.protocol.tables import MESSAGES, message_name

_M = OutputMode

#: Frame, name of the message, value, bus identifier.
FRAMES: list[tuple[str, str, Any, int]] = [
    ("FAFFD002000629", "SetOutputMode", _M.CALIBRATED | _M.ORIENTATION, 0xFF),
    (
        "FAFFD2040000000922", "SetOutputSettings",
        OutputSettings(orientation=OrientationForm.ROTATION_MATRIX), 0xFF,
    ),
    (
        "FAFFD002080F18", "SetOutputMode",
        _M.TEMPERATURE | _M.CALIBRATED | _M.ORIENTATION | _M.AUXILIARY | _M.STATUS, 0xFF,
    ),
    (
        "FAFFD20480000005A6", "SetOutputSettings",
        OutputSettings(orientation=OrientationForm.EULER_ANGLES, coordinates=Coordinates.NED), 0xFF,
    ),
    ("FAFFD0024000EF", "SetOutputMode", _M.RAW, 0xFF),
    ("FAFFD204000000012A", "SetOutputSettings", OutputSettings(), 0xFF),
    ("FAFFD10030", "SetOutputModeAck", None, 0xFF),
    ("FAFFD00031", "ReqOutputMode", None, 0xFF),
    ("FA013400CB", "ReqData", None, 1),
    ("FAFF8A0077", "StoreFilterState", None, 0xFF),
    ("FAFFD3002E", "SetOutputSettingsAck", None, 0xFF),
    ("FAFF0402048077", "SetPeriod", 1152, 0xFF),
    ("FAFF0A00F7", "ReqDataLength", None, 0xFF),
    ("FAFF0B020036BE", "DataLength", 54, 0xFF),
    ("FAFFD402FFFF2D", "SetOutputSkipFactor", 0xFFFF, 0xFF),
    ("FAFF3400CD", "ReqData", None, 0xFF),
    ("FAFFD102000628", "ReqOutputModeAck", _M.CALIBRATED | _M.ORIENTATION, 0xFF),
    ("FAFFD3040000000129", "ReqOutputSettingsAck", OutputSettings(), 0xFF),
    ("FAFFC004000000003D", "SetOutputConfiguration", (), 0xFF),
]  # fmt: skip


@pytest.mark.parametrize(("wire", "name", "value", "bid"), FRAMES)
def test_frames_both_ways(wire: str, name: str, value: Any, bid: int) -> None:
    frame = bytes.fromhex(wire)
    assert encode_frame(MESSAGES[name].mid, encode(name, value), bid=bid) == frame
    scanner = Scanner()
    (message,) = scanner.feed(frame) + scanner.close()
    assert isinstance(message, Message)
    assert (message.name, message.bid) == (name, bid)
    found = decode(name, message.payload)
    assert found == value
    assert type(found) is type(value)


#: Settings of real devices, and what they mean.
SETTINGS = [
    (0x0000_0001, OutputSettings()),
    (
        0x0000_0044,
        OutputSettings(
            packet_counter=False, orientation=OrientationForm.EULER_ANGLES, magnetic_field=False
        ),
    ),
    (
        0x0000_0105,
        OutputSettings(orientation=OrientationForm.EULER_ANGLES, precision=Precision.Fp1220),
    ),
    (
        0x8000_0C05,
        OutputSettings(
            orientation=OrientationForm.EULER_ANGLES,
            analog_in1=False,
            analog_in2=False,
            coordinates=Coordinates.NED,
        ),
    ),
    (
        0x0000_0046,
        OutputSettings(
            packet_counter=False,
            utc_time=True,
            orientation=OrientationForm.EULER_ANGLES,
            magnetic_field=False,
        ),
    ),
    (
        0x030B_0080 & ~(1 << 16 | 1 << 17) | 0x0000_0300,
        OutputSettings(
            packet_counter=False,
            status_word=True,
            precision=Precision.Float64,
            gps=False,
            gyro_temperature=True,
            sample_time_fine=True,
        ),
    ),
]


@pytest.mark.parametrize(("word", "settings"), SETTINGS)
def test_output_settings_of_devices(word: int, settings: OutputSettings) -> None:
    assert OutputSettings.from_word(word) == settings
    assert int(settings) == word


@given(st.integers(0, 2**32 - 1))
def test_every_word_of_output_settings_is_kept(word: int) -> None:
    settings = OutputSettings.from_word(word)
    assert int(settings) == word
    assert encode("SetOutputSettings", settings) == encode("SetOutputSettings", word)
    assert decode("ReqOutputSettingsAck", word.to_bytes(4, "big")) == settings
    names = {"OutputSettings": OutputSettings, "OrientationForm": OrientationForm}
    names |= {"Precision": Precision, "Coordinates": Coordinates}
    assert eval(repr(settings), names) == settings  # noqa: S307 - of our own text
    assert str(settings).startswith(f"{word:08X}: ")


def test_output_settings_in_words() -> None:
    settings = OutputSettings.from_word(0x8000_0C45)
    assert str(settings) == (
        "80000C45: packet counter, Euler angles, no magnetic field, no analog in1, no analog in2,"
        " Float32, NED"
    )
    assert repr(settings) == (
        "OutputSettings(orientation=OrientationForm.EULER_ANGLES, magnetic_field=False, analog_in1=False,"
        " analog_in2=False, coordinates=Coordinates.NED)"
    )
    assert repr(OutputSettings()) == "OutputSettings()"
    assert str(OutputSettings.from_word(0x4C)).startswith(
        "0000004C: orientation 3, no magnetic field"
    )


@pytest.mark.parametrize(
    ("values", "error"),
    [
        ({"coordinates": Coordinates.ENU}, "NWU or NED"),
        ({"orientation": 4}, "orientation cannot be 4"),
        ({"reserved": 1}, "reserved cannot be 1"),
        ({"packet_counter": 2}, "packet_counter cannot be 2"),
        ({"precision": 4}, "precision cannot be 4"),
    ],
)
def test_output_settings_that_do_not_fit(values: dict[str, Any], error: str) -> None:
    with pytest.raises(ValueError, match=error):
        OutputSettings(**values)


def test_channels_of_the_gps_receiver() -> None:
    channels = tuple(GnssChannel(k, k + 1, 5, -1, 40) for k in range(16))
    payload = encode("GnssStatus", channels)
    assert len(payload) == 81
    assert decode("GnssStatus", payload) == channels
    for broken in (b"", payload[:-1], payload + b"\0"):
        with pytest.raises(ValueError, match="channels"):
            decode("GnssStatus", broken)


def test_a_setting_of_the_old_sync_in_is_not_read_as_a_heading() -> None:
    """MID D6 sets the heading on later devices, with four bytes. Of older ones it has 1, 3 or 5."""
    for payload in (b"\0", b"\0\0\1", b"\2\0\0\0\1"):
        with pytest.raises(ValueError, match="payload has"):
            decode(message_name(0xD6, len(payload)), payload)
