"""Devices: what a host knows of one, the commands, and the ports that they are behind."""

from xbus.device.commands import Commands
from xbus.device.device import Device, connect, restore_communication
from xbus.device.ports import Port, find_ports
from xbus.device.recording import Recording
from xbus.device.sample import Sample
from xbus.device.session import Event, Notice, Refusal, Reply, Session
from xbus.device.settings import Applied, ApplyError, Change, Settings
from xbus.device.stats import LiveStats
from xbus.wire.link import Link

__all__ = [
    "Applied",
    "ApplyError",
    "Change",
    "Commands",
    "Device",
    "Event",
    "Link",
    "LiveStats",
    "Notice",
    "Port",
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
