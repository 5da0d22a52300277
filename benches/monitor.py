"""Measures ``xbus monitor`` with 2 kHz acceleration and 1.6 kHz rate of turn on a terminal.

    python benches/monitor.py [SECONDS]

The device is another process on a pty. The monitor is a third process on a second pty, whose output pyte
renders like a terminal. The bench prints the processor time of the monitor relative to the elapsed time,
without its start. The rates on the screen must be right, and no sample may be lost.
"""

import fcntl
import os
import pty
import select
import struct
import subprocess
import sys
import termios
import time

import pyte

from common import processor_seconds, seconds_argument, virtual_device

COLUMNS, LINES = 80, 24
#: Seconds until the monitor has started and its rates cover their whole time span.
WARM_UP = 6.0


def render(master: int, seconds: float, terminal: pyte.ByteStream) -> None:
    """Renders the output of the next seconds."""
    until = time.monotonic() + seconds
    while (left := until - time.monotonic()) > 0:
        if select.select([master], [], [], left)[0]:
            terminal.feed(os.read(master, 1 << 16))


def main() -> None:
    seconds = seconds_argument(10)
    with virtual_device() as (device, _):
        port = device.link.name
        device.close()
        master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("4H", LINES, COLUMNS, 0, 0))
        screen = pyte.Screen(COLUMNS, LINES)
        terminal = pyte.ByteStream(screen)
        command = [sys.executable, "-m", "xbus", "monitor", port]
        with subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave) as monitor:
            render(master, WARM_UP, terminal)
            began, before = time.perf_counter(), processor_seconds(monitor.pid)
            render(master, seconds, terminal)
            used = processor_seconds(monitor.pid) - before
            share = used / (time.perf_counter() - began)
            lines = screen.display
            os.write(master, b"q")
            assert monitor.wait() == 0
    print("\n".join(lines))
    rates = {
        words[0]: float(words[1]) for line in lines if (words := line.split())[1:] and "_hr" in line
    }
    assert abs(rates["acceleration_hr"] - 2000) < 20, rates
    assert abs(rates["rate_of_turn_hr"] - 1600) < 16, rates
    assert any("no samples lost" in line and "no damage" in line for line in lines), lines
    print(f"monitor, 3,600 samples a second   {share:6.1%} of a core  (goal: 10 %)")


if __name__ == "__main__":
    main()
