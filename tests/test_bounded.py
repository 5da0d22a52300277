"""Memory of commands on hostile input, as the operating system measures it, and lists that are cut."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xbus
from conftest import counter, fine
from streams import frame, mtdata2
from test_cli import run
from xbus.describe import listing, log_summary
from xbus.describe.json_text import JsonRows, json_pieces
from xbus.describe.listing import LargestRows
from xbus.describe.log_summary import LogSummary

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="memory is measured with /proc")

SIZE = 1_500_000


def repeated(*frames: bytes) -> bytes:
    """Returns frames again and again."""
    data = b"".join(frames)
    return data * (SIZE // len(data))


def many(samples: int, step: int) -> bytes:
    """Returns samples whose packet counters ascend by this step."""
    period = b"".join(mtdata2(counter(step * at % 65_536)) for at in range(65_536))
    return (period * (1 + SIZE // len(period)))[: samples * 10]


HOSTILE = {
    "preambles": b"\xfa" * SIZE,
    "damage": repeated(frame(0x31), bytes(5)),
    "gaps": many(SIZE // 10, 3),
    "messages": repeated(frame(0x31)),
    "errors": repeated(frame(0x42, b"\x04")),
    "restarts": repeated(frame(0x3E), mtdata2(counter(0), fine(0)))[: SIZE // 4],
    "devices": repeated(*(mtdata2(counter(0), bid=bid) for bid in range(256))),
    "identifiers": b"".join(mtdata2(at.to_bytes(2, "big") + b"\0") for at in range(0x0100, 0xC000)),
}
#: The peak of a command, in MB. Python, numpy and the libraries take 60 of these, and malloc may keep 64 MiB
#: that are free.
MOST = 170

MEASURED = """
import sys
from xbus.cli import main
try:
    main(sys.argv[1:])
finally:
    lines = open("/proc/self/status").read().splitlines()
    print(next(line for line in lines if line.startswith("VmHWM")).split()[1], file=sys.stderr)
"""


def measured(*args: str) -> tuple[int, str, list[str], float]:
    """Runs a command and returns exit status, output, lines on stderr, and the peak of its memory in MB."""
    command = [sys.executable, "-c", MEASURED, *args]
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
    *lines, peak = done.stderr.splitlines()
    return done.returncode, done.stdout, lines, int(peak) / 1000


@pytest.mark.parametrize("kind", HOSTILE)
def test_info_needs_little_memory(tmp_path: Path, kind: str) -> None:
    """All counts are exact, and the JSON is valid."""
    path = tmp_path / "log.mtb"
    path.write_bytes(HOSTILE[kind])
    code, out, lines, peak = measured("info", "--json", "-q", str(path))
    assert peak < MOST
    log = xbus.read_log(path)
    if not log.stats.frames:
        assert (code, len(lines)) == (1, 1)
        return
    assert (code, lines) == (0, [])
    (facts,) = json.loads(out)
    totals = {
        "runs": len(log.runs),
        "gaps": len(log.gaps),
        "damage": len(log.damage),
        "events": int(np.isin(log.messages.mid, [0x42, 0x43]).sum()),
    }
    assert facts["totals"] == totals
    for name, total in totals.items():
        assert len(facts[name]) == min(total, listing.MAX_LISTED)
    assert len(facts["unknown"]) == len(log.unknown)


@pytest.mark.parametrize("kind", ["damage", "gaps", "errors"])
def test_a_report_needs_little_memory(tmp_path: Path, kind: str) -> None:
    path, out = tmp_path / "log.mtb", tmp_path / "log.html"
    path.write_bytes(HOSTILE[kind])
    code, _, lines, peak = measured("report", "-q", str(path), "-o", str(out))
    assert (code, lines) == (0, [])
    assert peak < MOST
    assert out.stat().st_size < 20_000_000


@pytest.mark.parametrize("kind", ["damage", "messages"])
def test_the_reason_why_nothing_was_decoded_needs_little_memory(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "log.mtb"
    path.write_bytes(HOSTILE[kind] * 10)
    args = ["--memory", "205MB", "-o", str(tmp_path / "log.csv")]  # as one processor would work
    code, _, lines, peak = measured("decode", "-q", str(path), *args)
    assert (code, len(lines)) == (1, 1)
    assert lines[0].startswith(f"xbus: {path}")
    assert peak < MOST


def test_a_command_without_memory_ends_with_one_sentence(tmp_path: Path) -> None:
    """The limit leaves room for the libraries, which differ, and little for the log."""
    path = tmp_path / "log.mtb"
    path.write_bytes(HOSTILE["gaps"])
    limited = (
        "import resource, sys\n"
        "import numpy, xbus.cli.info, xbus.cli.decode, xbus.describe.log_summary, xbus.log.read\n"
        "import xbus.cli.decoding, xbus.log.batches\n"
        "from xbus.cli import main\n"
        "used = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (used + (10 << 20),) * 2)\n"
        "main(sys.argv[1:])\n"
    )
    for args in (["info", "-q"], ["decode", "-q", "-o", str(tmp_path / "x.csv")]):
        command = [sys.executable, "-c", limited, *args, str(path)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
        assert (done.returncode, done.stdout) == (1, "")
        assert done.stderr.splitlines() == [
            "xbus: not enough memory; close other programs, or raise the limit (ulimit -v)"
        ]
        assert [item.name for item in tmp_path.iterdir()] == ["log.mtb"]


def test_no_file_is_left_without_memory_to_describe_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def damage(_: xbus.Log) -> None:
        raise MemoryError

    (tmp_path / "log.mtb").write_bytes(many(10, 1))
    monkeypatch.setattr(xbus.Log, "damage", property(damage))
    result = run("decode", str(tmp_path / "log.mtb"), "-o", str(tmp_path / "log.npz"))
    assert (result.exit_code, "not enough memory" in result.stderr) == (1, True)
    assert [item.name for item in tmp_path.iterdir()] == ["log.mtb"]


# ---------------------------------------------------------------------------------------------
# Lists
# ---------------------------------------------------------------------------------------------


def test_lists_are_cut_and_counts_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_summary, "MAX_KINDS", 3)
    data = b"".join(mtdata2(counter(3 * at)) + frame(0x42, bytes([at])) + b"\0" for at in range(10))
    whole = LogSummary(xbus.iter_log(data, block_bytes=20))
    assert (len(whole.events), len(whole.kinds), whole.messages["Error"]) == (10, 3, 10)
    assert whole.reasons.total() == 10
    first = listing.FirstRows(np.dtype("i8"), 4)
    for part in np.split(np.arange(10), [3, 3, 8]):
        first.add(part)
    assert (first.rows.tolist(), len(first)) == ([0, 1, 2, 3], 10)


@pytest.mark.parametrize("cuts", [[], [2], [1, 5, 5, 9]])
def test_the_largest_rows(cuts: list[int]) -> None:
    """Of equal ones the first are kept, in the order of the table."""
    dtype = np.dtype([("size", "i8"), ("at", "i8")])
    rows = np.array([(size, at) for at, size in enumerate([3, 1, 7, 3, 9, 3, 7, 1, 2, 9])], dtype)
    largest = LargestRows(dtype, "size", 5)
    for part in np.split(rows, cuts):
        largest.add(part)
    assert largest.rows["at"].tolist() == [0, 2, 4, 6, 9]


@pytest.mark.parametrize(
    "value",
    [
        [],
        [1, []],
        [{}, {"a": [2]}],
        [{"a": 1, "b": "a\nb"}, None],
        [[[]], {"c": {"d": ["\u00e9"]}}],
    ],
)
def test_json_in_pieces(value: list[Any]) -> None:
    rows = JsonRows(lambda: iter(value))
    for whole, pieces in (
        (value, value),
        (value, rows),
        ({"x": {"y": [value, 1]}, "z": {}}, {"x": {"y": [rows, 1]}, "z": {}}),
    ):
        assert "".join(json_pieces(pieces)) == json.dumps(whole, indent=2)
