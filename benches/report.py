"""Measures ``xbus report`` of a long recording at 2 kHz: ``python benches/report.py [MINUTES]``.

A virtual MTi-630 at rest sends acceleration and rate of turn at 2,000 and 1,600 Hz. The bench prints the time
of the report relative to `read_log` of the same file, the size of the page, and on Linux the peak memory of
``xbus report`` and ``xbus info``. It checks that one outlier in the middle of the recording is visible.
"""

from __future__ import annotations

import base64
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import xbus
from common import ratio
from xbus import SimulatedDevice
from xbus.report import write_report

MINUTES = float(sys.argv[1]) if len(sys.argv) > 1 else 60
#: Limit of the page size in bytes, for a recording of any length.
MOST_BYTES = 15e6
OUTPUTS = {
    "packet_counter": None,
    "sample_time_fine": None,
    "acceleration_hr": 2000,
    "rate_of_turn_hr": 1600,
    "acceleration": 400,
    "rate_of_turn": 400,
    "quaternion": 400,
    "status_word": 400,
}
SPIKE = 123.0
STATUS = Path("/proc/self/status")
PEAK = f"""
import sys
from xbus.cli import main
main(sys.argv[1:], standalone_mode=False)
lines = open({str(STATUS)!r}).read().splitlines()
print(next(line for line in lines if line.startswith("VmHWM")).split()[1], file=sys.stderr)
"""


def record(path: Path) -> None:
    """Writes the recording, with one additional sample in the middle."""
    virtual = SimulatedDevice("MTi-630", trajectory="still", noise=1)
    with xbus.connect(virtual) as device, device.configure() as cfg:
        cfg.set_output_configuration(OUTPUTS, check_baudrate=False)
    with path.open("wb") as out:
        for second in range(round(60 * MINUTES)):
            virtual.advance(1)
            out.write(virtual.read())
            if second == round(30 * MINUTES):
                out.write(xbus.encode_sample({"acceleration_hr": [0, SPIKE, 0]}))


def largest_drawn(page: Path, name: str) -> float:
    """Returns the largest value in the figures of a quantity."""
    text = re.search(r'id="figures">(.*?)</script>', page.read_text("utf-8"), re.DOTALL)
    assert text is not None
    figures = [figure for figure in json.loads(text[1]) if figure["name"] == name]
    curves = [curve["y"] for figure in figures for curve in figure["data"]]
    arrays = [np.frombuffer(base64.b64decode(y["bdata"]), f"<{y['dtype']}") for y in curves]
    return max(float(np.nanmax(array)) for array in arrays)


def peak(*args: str | Path) -> int:
    """Returns the peak memory of a command in MiB."""
    command = [sys.executable, "-c", PEAK, *map(str, args)]
    run = subprocess.run(command, check=True, capture_output=True, text=True)
    return int(run.stderr.split()[-1]) >> 10


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path, page = Path(folder, "long.mtb"), Path(folder, "long.html")
        record(path)
        samples = len(xbus.read_log(path))
        print(f"{MINUTES:g} min, {samples:,} samples, {path.stat().st_size >> 20} MiB")
        times = ratio(1, lambda: write_report(path, page), lambda: xbus.read_log(path, threads=1))
        size = page.stat().st_size
        print(f"report: {times:.1f} times read_log, a page of {size / 1e6:.1f} MB")
        assert largest_drawn(page, "acceleration_hr") == SPIKE
        assert size < MOST_BYTES
        if STATUS.exists():
            report, info = peak("report", "-q", path, "-o", page), peak("info", path)
            print(f"peak memory {report} MiB; xbus info {info} MiB")


if __name__ == "__main__":
    main()
