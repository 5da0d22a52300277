"""Compares ``xbus decode big.mtb -o big.parquet`` with pyarrow: ``python benches/export.py [MIB]``.

The reference is the time in which pyarrow writes the same table from memory, with its default settings and
with those of xbus. The command is a whole process, with start-up and reading.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

import xbus
from common import ahrs_stream, medians

MEBIBYTES = float(sys.argv[1]) if len(sys.argv) > 1 else 256


def parquet_options(schema: pa.Schema) -> dict[str, Any]:
    """Returns the settings of xbus for pyarrow."""
    integers = [pa.int32(), pa.int64(), pa.uint32(), pa.uint64()]
    encoding = {
        field.name: "BYTE_STREAM_SPLIT"
        if pa.types.is_floating(field.type)
        else "DELTA_BINARY_PACKED"
        for field in schema
        if pa.types.is_floating(field.type) or field.type in integers
    }
    return {
        "compression": "zstd",
        "use_dictionary": False,
        "column_encoding": encoding,
        "write_statistics": ["sample", "time"],
    }


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

        def pyarrow_default() -> None:
            pq.write_table(table, theirs)

        def pyarrow_same_settings() -> None:
            pq.write_table(table, theirs, **parquet_options(table.schema))

        command()
        print(f"{table.num_rows} rows, {table.num_columns} columns, MiB of Parquet:")
        for name, write in (
            ("its default settings", pyarrow_default),
            ("the settings of xbus", pyarrow_same_settings),
        ):
            write()
            assert pq.read_table(ours).equals(pq.read_table(theirs))
            mine, other = medians(5, command, write)
            sizes = f"{ours.stat().st_size >> 20} and {theirs.stat().st_size >> 20}"
            print(f"{mine / other:.2f} times pyarrow with {name} ({sizes})")


if __name__ == "__main__":
    main()
