"""The enums are written down for editors and type checkers; the tables say what stands in them."""

from pathlib import Path

from xbus.protocol import ids
from xbus.protocol.tables import MESSAGES, QUANTITIES

HEADER = '''\
"""Data identifiers and message identifiers as enums.

Made from the tables of the extension; ``pytest tests/test_ids.py`` writes this file anew when they change.
"""

from enum import IntEnum

__all__ = ["Coordinates", "DataId", "MessageId", "Precision"]


class Precision(IntEnum):
    """Number formats: the two low bits of a data identifier (Table 17).

    >>> import xbus
    >>> f"{xbus.DataId.LatLon | xbus.Precision.Fp1632:04X}", xbus.Precision.Fp1632.size
    ('5042', 6)
    """

    Float32 = 0
    Fp1220 = 1
    Fp1632 = 2
    Float64 = 3

    @property
    def size(self) -> int:
        """Bytes of one number."""
        return (4, 4, 6, 8)[self]


class Coordinates(IntEnum):
    """Coordinate systems: bits 2 and 3 of a data identifier (Table 17).

    >>> import xbus
    >>> xbus.read_log("tests/captures/walk.mtb")["quaternion"].coordinates == xbus.Coordinates.ENU.name
    True
    """

    ENU = 0x0
    NED = 0x4
    NWU = 0x8
'''

DATA_ID = '''    """Data identifiers, format bits zero (Table 16).

    >>> import xbus
    >>> f"{xbus.DataId.Quaternion:04X}", xbus.DataId.Quaternion in xbus.read_log("tests/captures/walk.mtb")
    ('2010', True)
    """'''
MESSAGE_ID = '''    """Message identifiers (section 5.3). A request and its setting share one.

    >>> import xbus
    >>> xbus.encode_frame(xbus.MessageId.GoToConfig).hex(" ")
    'fa ff 30 00 d1'
    """'''


def text() -> str:
    lines = [HEADER, "", "class DataId(IntEnum):"]
    lines += [DATA_ID, ""]
    lines += [f"    {quantity.manual} = 0x{quantity.id:04X}" for quantity in QUANTITIES.values()]
    lines += ["", "", "class MessageId(IntEnum):"]
    lines += [MESSAGE_ID, ""]
    lines += [f"    {message.name} = 0x{message.mid:02X}" for message in MESSAGES.values()]
    return "\n".join(lines) + "\n"


def test_enums_are_the_tables() -> None:
    path = Path(ids.__file__)
    wanted = text()
    if path.read_text() != wanted:
        path.write_text(wanted)
        raise AssertionError(f"{path} was not up to date; it has been written anew")
