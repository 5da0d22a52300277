"""``xbus decode big.mtb -o big.parquet`` against pyarrow alone: ``python benches/export.py``.

The yardstick is what pyarrow takes to write the same table when it is in memory already: as it does when
nobody says how, and with the settings that xbus uses. The command is measured as a whole process, start-up
and reading included.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import pyarrow.parquet as pq
from common import ahrs_stream, medians

import xbus
from xbus.log.export import parquet_options

MEBIBYTES = float(sys.argv[1]) if len(sys.argv) > 1 else 256


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        log, ours, theirs = (
            Path(folder) / name for name in ("big.mtb", "ours.parquet", "theirs.parquet")
        )
        log.write_bytes(ahrs_stream(MEBIBYTES))
        table = xbus.read_log(log).to_arrow()

        def command() -> None:
            subprocess.run(
                [sys.executable, "-m", "xbus", "decode", "-q", log, "-o", ours], check=True
            )

        def default() -> None:
            pq.write_table(table, theirs)

        def alike() -> None:
            pq.write_table(table, theirs, **parquet_options(table.schema))

        command()
        print(f"{table.num_rows} rows, {table.num_columns} columns, MiB of Parquet:")
        for name, write in (("pyarrow's settings", default), ("the settings of xbus", alike)):
            write()
            assert pq.read_table(ours).equals(pq.read_table(theirs))
            mine, other = medians(5, command, write)
            sizes = f"{ours.stat().st_size >> 20} and {theirs.stat().st_size >> 20}"
            print(f"{mine / other:.2f} times pyarrow with {name} ({sizes})")


if __name__ == "__main__":
    main()
