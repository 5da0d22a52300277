"""Measures how fast a log becomes messages of ROS 2: ``python benches/ros.py [SAMPLES]``.

Prints messages per second of processor time, for samples with orientation, inertial vectors and status (nine
messages each), and for those with position, velocity and GNSS. Reads all messages of a short file back first.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import Literal

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

import xbus

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
import streams

SAMPLES = int(sys.argv[1]) if len(sys.argv) > 1 else 500_000
STREAMS = {"inertial": streams.ahrs, "with GNSS": streams.gnssins}
COMPRESSIONS: tuple[Literal["zstd", "lz4", "none"], ...] = ("zstd", "lz4", "none")
REPEATS = 3


def check(log: xbus.Log, path: Path) -> None:
    """Checks that a file has the accelerations, orientations and times of a log, to the bit."""
    found = []
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        for _, _, message, data in reader.iter_decoded_messages(topics="/imu/data"):
            vector, q = data.linear_acceleration, data.orientation
            found.append([vector.x, vector.y, vector.z, q.w, q.x, q.y, q.z, message.log_time])
    acceleration, orientation = log["acceleration"], log["quaternion"]
    expected = np.column_stack([acceleration.values, orientation.values]).astype(np.float64)
    assert np.array_equal(np.array(found)[:, :7], expected)
    times = [row[7] for row in found]
    assert times == sorted(times)


def count(path: Path) -> int:
    """Returns the number of messages of a file."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    return summary.statistics.message_count


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "out.mcap")
        for title, make in STREAMS.items():
            short = xbus.read_log(make(5000))
            for compression in COMPRESSIONS:
                short.to_mcap(path, compression=compression)
                check(short, path)
            log = xbus.read_log(make(SAMPLES))
            for compression in COMPRESSIONS:
                seconds = []
                for _ in range(REPEATS):
                    start = time.process_time()
                    log.to_mcap(path, compression=compression)
                    seconds.append(time.process_time() - start)
                assert count(path) == count_of(log), count(path)
                best = min(seconds)
                print(
                    f"{title}, {compression}: {count(path) / best / 1e6:.2f} million messages/s, "
                    f"{len(log) / best / 1e6:.2f} million samples/s, {path.stat().st_size / 1e6:.0f} MB"
                )


def count_of(log: xbus.Log) -> int:
    """Returns the number of messages of a log of the benches: its rows, and those that combine several."""
    rows = {name: len(log[name]) if name in log else 0 for name in ROWS}
    return sum(rows[name] * messages for name, messages in ROWS.items())


#: How many messages a row of each quantity makes.
ROWS = {
    "acceleration": 2,  # and /imu/data
    "rate_of_turn": 1,
    "magnetic_field": 1,
    "sample_time_fine": 1,
    "status_word": 1,
    "utc_time": 1,
    "quaternion": 3,  # and /filter/euler, /tf
    "velocity_xyz": 2,  # and /filter/twist
    "lat_lon": 2,  # /filter/positionlla, /gnss_pose
    "gnss_pvt_data": 2,  # and /nmea
}


if __name__ == "__main__":
    main()
