"""Measures a virtual MTi-630 that sends acceleration at 2 kHz and rate of turn at 1.6 kHz on a pty.

    python benches/virtual.py [SECONDS]

Prints the processor time of the process relative to the elapsed time. Every sample must arrive.
"""

import resource
import time

from common import processor_seconds, seconds_argument, virtual_device

#: Limit of the processor time relative to the elapsed time.
GOAL = 0.15


def main() -> None:
    seconds = seconds_argument(5)
    with virtual_device() as (device, process):
        names = ("acceleration_hr", "rate_of_turn_hr")
        counts, samples, start = dict.fromkeys(names, 0), 0, time.monotonic()
        device.discard()
        used = processor_seconds(process.pid)
        while time.monotonic() - start < seconds:
            block = next(device.blocks(seconds=0.1))
            samples += len(block)
            for name in names:
                counts[name] += len(block[name])
        elapsed, used = time.monotonic() - start, processor_seconds(process.pid) - used
        stats = device.stats
    rates = {name: count / elapsed for name, count in counts.items()}
    assert stats.lost_samples == stats.dropped_samples == stats.skipped_bytes == 0, stats
    assert abs(rates["acceleration_hr"] - 2000) < 50, rates
    assert abs(rates["rate_of_turn_hr"] - 1600) < 40, rates
    share = used / elapsed
    print(
        f"{samples} samples in {elapsed:.1f} s, none lost: {share:.1%} of a core (goal: {GOAL:.0%})"
    )
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    print(f"peak memory {peak:.0f} MiB")


if __name__ == "__main__":
    main()
