"""Corrections for GNSS receivers: from an NTRIP caster to a device."""

from xbus.rtk.caster import Caster, CasterError
from xbus.rtk.forward import Fix, Forwarder, Position

__all__ = ["Caster", "CasterError", "Fix", "Forwarder", "Position"]
