"""What the monitor costs: 2 kHz acceleration and 1.6 kHz rate of turn, drawn on a terminal.

    python benches/monitor.py [SECONDS]

The source is another process, on a pty; the monitor a third one, on a pty of its own, which pyte reads as a
terminal would. Processor time of the monitor over elapsed time, without its start. The rates on the screen
must be right, and nothing lost.
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
from pathlib import Path

import pyte
from live import measuring

COLUMNS, LINES = 80, 24
#: Seconds that it takes to start, and until the rates are those of all of their span.
BEFORE = 6.0


def used(process: int) -> float:
    """Processor time of a process, in seconds."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def shown(master: int, seconds: float, terminal: pyte.ByteStream) -> None:
    """Reads what is drawn within so many seconds."""
    until = time.monotonic() + seconds
    while (left := until - time.monotonic()) > 0:
        if select.select([master], [], [], left)[0]:
            terminal.feed(os.read(master, 1 << 16))


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 10
    with measuring() as device:
        port = device.link.name
        device.close()
        master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("4H", LINES, COLUMNS, 0, 0))
        screen = pyte.Screen(COLUMNS, LINES)
        terminal = pyte.ByteStream(screen)
        command = [sys.executable, "-m", "xbus", "monitor", port]
        streams = {"stdin": slave, "stdout": slave, "stderr": slave}
        with subprocess.Popen(command, **streams) as monitor:
            shown(master, BEFORE, terminal)
            began, before = time.perf_counter(), used(monitor.pid)
            shown(master, seconds, terminal)
            share = (used(monitor.pid) - before) / (time.perf_counter() - began)
            lines = screen.display
            os.write(master, b"q")
            assert monitor.wait() == 0
    print("\n".join(lines))
    rates = {
        words[0]: float(words[1]) for line in lines if (words := line.split())[1:] and "_hr" in line
    }
    assert abs(rates["acceleration_hr"] - 2000) < 20, rates
    assert abs(rates["rate_of_turn_hr"] - 1600) < 16, rates
    assert any("nothing lost" in line and "no damage" in line for line in lines), lines
    print(f"monitor, 3,600 samples a second   {share:6.1%} of a core  (goal: 10 %)")


if __name__ == "__main__":
    main()
