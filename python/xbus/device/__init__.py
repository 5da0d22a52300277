"""Devices: what a host knows of one, the commands, and the ports that they are behind."""

from xbus.device.applying import Applied
from xbus.device.caster import Caster, CasterError
from xbus.device.device import Device, connect, restore_communication
from xbus.device.link import Link
from xbus.device.ports import Port, find_ports
from xbus.device.recording import Recording
from xbus.device.rtk import Fix, Forwarder, Position
from xbus.device.sample import Sample
from xbus.device.session import Event, Notice, Refusal, Reply, Session
from xbus.device.settings import Change, Settings
from xbus.device.stats import LiveStats

__all__ = [
    "Applied",
    "Caster",
    "CasterError",
    "Change",
    "Device",
    "Event",
    "Fix",
    "Forwarder",
    "Link",
    "LiveStats",
    "Notice",
    "Port",
    "Position",
    "Recording",
    "Refusal",
    "Reply",
    "Sample",
    "Session",
    "Settings",
    "connect",
    "find_ports",
    "restore_communication",
]
