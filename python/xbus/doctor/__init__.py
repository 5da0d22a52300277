"""Checks of this installation and of the serial ports, for `xbus doctor`. They need no device.

`examine` returns facts for a bug report, and `Finding` objects: what was checked, and how to fix it.
"""

from xbus.doctor.examination import Examination, examine
from xbus.doctor.finding import Finding
from xbus.doctor.machine import Machine
from xbus.doctor.usb import UDEV_RULES

__all__ = ["UDEV_RULES", "Examination", "Finding", "Machine", "examine"]
