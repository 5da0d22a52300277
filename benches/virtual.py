"""What a virtual MTi-630 costs: acceleration at 2 kHz and rate of turn at 1.6 kHz, on a pty.

    python benches/virtual.py [SECONDS]

Prints CPU time of the process over elapsed time, after it has checked that every sample arrived.
"""

import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import xbus

OUTPUTS = {
    "packet_counter": None,
    "sample_time_fine": None,
    "acceleration_hr": 2000,
    "rate_of_turn_hr": 1600,
}
#: What the goal is.
MOST = 0.15


def cpu(pid: int) -> float:
    """CPU seconds of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 5
    command = [sys.executable, "-m", "xbus", "sim", "--product", "MTi-630"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        port = process.stdout.readline().removeprefix("port: ").strip()
        with xbus.connect(port) as device:
            with device.configure() as cfg:
                cfg.set_output_configuration(OUTPUTS, check_baudrate=False)
            received, begun, used = [], time.monotonic(), cpu(process.pid)
            while time.monotonic() - begun < seconds:
                received.append(device.link.read(1))
            elapsed, used = time.monotonic() - begun, cpu(process.pid) - used
        process.terminate()
    log = xbus.read_log(b"".join(received))
    rates = {name: len(log[name]) / elapsed for name in ("acceleration_hr", "rate_of_turn_hr")}
    assert log.stats.lost_samples == 0, log.stats
    assert abs(rates["acceleration_hr"] - 2000) < 50, rates
    assert abs(rates["rate_of_turn_hr"] - 1600) < 40, rates
    share = used / elapsed
    print(
        f"{len(log)} samples in {elapsed:.1f} s, none lost: {share:.1%} of a core (goal: {MOST:.0%})"
    )
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    print(f"peak memory {peak:.0f} MiB")


if __name__ == "__main__":
    main()
