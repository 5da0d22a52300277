"""Checks the wheels in a folder, and prints what their size consists of.

python .ci/wheel.py DIST
"""

from __future__ import annotations

import sys
import zipfile
from collections import Counter
from pathlib import Path

#: Bytes of a wheel at most.
MAX_SIZE = 10_000_000
WANTED = (
    "xbus/py.typed",
    "xbus/_core.pyi",
    "xbus/cli/__init__.py",
    "xbus/doctor/70-xsens.rules",
    "xbus/can/mti600.dbc",
    "xbus/report/page.js",
)


def main() -> None:
    wheels = sorted(Path(sys.argv[1]).glob("*.whl"))
    if not wheels:
        sys.exit(f"no wheel in {sys.argv[1]}")
    for wheel in wheels:
        check(wheel)


def check(wheel: Path) -> None:
    """Checks one wheel."""
    if "-cp311-abi3-" not in wheel.name:
        sys.exit(f"{wheel.name} is not an abi3 wheel for CPython 3.11")
    with zipfile.ZipFile(wheel) as archive:
        entries = archive.infolist()
    names = [entry.filename for entry in entries]
    if missing := [name for name in WANTED if name not in names]:
        sys.exit(f"{wheel.name} lacks {' '.join(missing)}")
    core = [name for name in names if name.startswith("xbus/_core.") and not name.endswith(".pyi")]
    if len(core) != 1 or "cpython" in core[0]:
        sys.exit(f"{wheel.name} has not one abi3 extension module, but {core}")
    if not any(name.endswith("/man/man1/xbus.1") for name in names):
        sys.exit(f"{wheel.name} lacks the man page")
    for licence in ("LICENSE", "THIRD-PARTY.txt"):
        if not any(name.endswith(f".dist-info/licenses/{licence}") for name in names):
            sys.exit(f"{wheel.name} lacks {licence}")
    size = wheel.stat().st_size
    print(f"{wheel.name}: {size / 1e6:.2f} MB, {len(names)} files")
    sizes: Counter[str] = Counter()
    for entry in entries:
        folder, _, name = entry.filename.rpartition("/")
        kind = "extension module" if entry.filename in core else Path(name).suffix or name
        sizes[kind if folder.split("/")[0] == "xbus" else "metadata, licences, manual page"] += (
            entry.compress_size
        )
    for kind, compressed in sizes.most_common():
        print(f"  {compressed:10,}  {kind}")
    if size > MAX_SIZE:
        sys.exit(f"{wheel.name} is larger than {MAX_SIZE / 1e6:.0f} MB")


if __name__ == "__main__":
    main()
