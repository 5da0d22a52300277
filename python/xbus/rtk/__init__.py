"""Corrections for GNSS receivers: from an NTRIP caster to a device."""

from xbus.rtk.caster import Caster, CasterError
from xbus.rtk.fix import Fix, Position
from xbus.rtk.forward import Forwarder
from xbus.rtk.sourcetable import Mountpoint, read_source_table

__all__ = [
    "Caster",
    "CasterError",
    "Fix",
    "Forwarder",
    "Mountpoint",
    "Position",
    "read_source_table",
]
