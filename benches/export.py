"""``xbus decode big.mtb -o big.parquet`` against pyarrow alone: ``python benches/export.py``.

The yardstick is what pyarrow takes to write the same table with the same settings when it is in memory
already. The command is measured as a whole process, start-up and reading included.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import pyarrow.parquet as pq
from common import ahrs_stream, medians

import xbus
from xbus.export import parquet_options

MEBIBYTES = float(sys.argv[1]) if len(sys.argv) > 1 else 256


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        log, ours, theirs = (
            Path(folder) / it for it in ("big.mtb", "ours.parquet", "theirs.parquet")
        )
        log.write_bytes(ahrs_stream(MEBIBYTES))
        table = xbus.read_log(log).to_arrow()

        def command() -> None:
            subprocess.run(
                [sys.executable, "-m", "xbus", "decode", "-q", log, "-o", ours], check=True
            )

        def pyarrow() -> None:
            pq.write_table(table, theirs, **parquet_options(table.schema))

        command()
        pyarrow()
        assert pq.read_table(ours).equals(pq.read_table(theirs))
        mine, other = medians(3, command, pyarrow)
        size = ours.stat().st_size >> 20
        print(f"{table.num_rows} rows, {table.num_columns} columns, {size} MiB of Parquet")
        print(f"xbus decode takes {mine / other:.2f} times what pyarrow takes to write the table")


if __name__ == "__main__":
    main()
