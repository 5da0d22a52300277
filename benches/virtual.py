"""Measures a virtual MTi-630 that sends acceleration at 2 kHz and rate of turn at 1.6 kHz on a pty.

    python benches/virtual.py [SECONDS]

Prints the processor time of the process relative to the elapsed time. Every sample must arrive.
"""

import resource
import time

from common import processor_seconds, seconds_argument, virtual_device

import xbus

#: Limit of the processor time relative to the elapsed time.
GOAL = 0.15


def main() -> None:
    seconds = seconds_argument(5)
    with virtual_device() as (device, process):
        received, start = [], time.monotonic()
        used = processor_seconds(process.pid)
        while time.monotonic() - start < seconds:
            received.append(device.link.read(1).data)
        elapsed, used = time.monotonic() - start, processor_seconds(process.pid) - used
    log = xbus.read_log(b"".join(received))
    rates = {name: len(log[name]) / elapsed for name in ("acceleration_hr", "rate_of_turn_hr")}
    assert log.stats.lost_samples == 0, log.stats
    assert abs(rates["acceleration_hr"] - 2000) < 50, rates
    assert abs(rates["rate_of_turn_hr"] - 1600) < 40, rates
    share = used / elapsed
    print(
        f"{len(log)} samples in {elapsed:.1f} s, none lost: {share:.1%} of a core (goal: {GOAL:.0%})"
    )
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    print(f"peak memory {peak:.0f} MiB")


if __name__ == "__main__":
    main()
