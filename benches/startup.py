"""Measures start-up time: ``python benches/startup.py``.

Prints the time of ``import xbus`` with everything that `read_log` needs, minus ``import numpy``, and the
processor time of ``xbus --help``.
"""

from __future__ import annotations

import os
import subprocess
import sys

ROUNDS = 15


def processor_seconds(*args: str) -> float:
    """Returns the processor seconds of a Python process, the minimum of several runs."""

    def once() -> float:
        before = os.times()
        subprocess.run([sys.executable, *args], check=True, stdout=subprocess.DEVNULL)
        after = os.times()
        return (
            after.children_user
            + after.children_system
            - before.children_user
            - before.children_system
        )

    return min(once() for _ in range(ROUNDS))


def main() -> None:
    with_numpy = processor_seconds("-c", "import numpy")
    with_xbus = processor_seconds("-c", "import xbus; xbus.read_log")
    print(f"import xbus: {1000 * (with_xbus - with_numpy):.0f} ms more than import numpy")
    print(f"xbus --help: {processor_seconds('-m', 'xbus', '--help'):.2f} s of processor time")


if __name__ == "__main__":
    main()
