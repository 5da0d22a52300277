"""Devices: connections, commands, settings, live data and recordings."""

from xbus.device.commands import Commands
from xbus.device.device import Device
from xbus.device.events import Notice, Refusal, Reply, SessionEvent
from xbus.device.opening import connect, restore_communication
from xbus.device.ports import Port, find_ports
from xbus.device.recording import Recording
from xbus.device.sample import Sample
from xbus.device.session import Session
from xbus.device.settings import Applied, ApplyError, Change, Settings
from xbus.device.stats import LiveStats
from xbus.wire.link import Link

__all__ = [
    "Applied",
    "ApplyError",
    "Change",
    "Commands",
    "Device",
    "Link",
    "LiveStats",
    "Notice",
    "Port",
    "Recording",
    "Refusal",
    "Reply",
    "Sample",
    "Session",
    "SessionEvent",
    "Settings",
    "connect",
    "find_ports",
    "restore_communication",
]
