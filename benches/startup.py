"""What importing costs: ``python benches/startup.py``.

``import xbus`` with all that reading takes, over ``import numpy``, and the processor time of
``xbus --help``.
"""

from __future__ import annotations

import os
import subprocess
import sys

ROUNDS = 15


def cpu(*args: str) -> float:
    """Processor seconds of a whole Python process, the least of several runs."""

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
    with_numpy, with_xbus = cpu("-c", "import numpy"), cpu("-c", "import xbus; xbus.read_log")
    print(f"import xbus: {1000 * (with_xbus - with_numpy):.0f} ms over import numpy")
    print(f"xbus --help: {cpu('-m', 'xbus', '--help'):.2f} s of processor time")


if __name__ == "__main__":
    main()
