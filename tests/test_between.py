"""``xbus decode --between``: what is written is the table of ``read_log(between=...)``."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import xbus
from conftest import counter, fine
from streams import mtdata2, real
from test_cli import WALK, run, sentence
from test_decode_parts import LOGS, PART, times_of
from test_export_formats import content
from test_table_file import assert_identical
from xbus.cli import decoding


@pytest.fixture(autouse=True)
def _small_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(decoding, "PART", PART)


def wrap() -> bytes:
    """Two devices whose clocks wrap around after two seconds, and strings without samples in between."""
    samples = []
    for i in range(400):
        ticks = (2**32 - 20_000 + 100 * i) % 2**32
        samples.append(mtdata2(counter(i), fine(ticks), real(0x4020, i, 0, 0), bid=1 + i % 2))
        if i % 100 == 50:
            samples.append(b"$GPHDT,123.456,T*32\r\n" * 2)
    return b"".join(samples)


INPUTS = {name: LOGS[name] for name in ("walk", "field", "two devices", "with position")} | {
    "wrap": wrap()
}
UTC = ("2026-11-22T09:30:02", "2026-11-22T09:30:05")


@pytest.mark.parametrize("is_timed", [False, True], ids=["", "arrivals"])
@pytest.mark.parametrize("name", INPUTS)
@pytest.mark.parametrize(
    ("moments", "arguments", "options", "key"),
    [
        ((0.5, 1.5), [], {}, None),
        ((None, 1), ["--quantity", "packet_counter"], {}, "packet_counter"),
        ((2.5, None), ["--bid", "1"], {"bid": 1}, None),
    ],
    ids=["a second", "to", "from"],
)
def test_the_table(
    name: str,
    moments: tuple[float | None, float | None],
    arguments: list[str],
    options: dict[str, int],
    key: str | None,
    is_timed: bool,
) -> None:
    Path("log.mtb").write_bytes(INPUTS[name])
    if is_timed:
        Path("log.mtb.times").write_bytes(times_of(INPUTS[name]))
    try:
        log = xbus.read_log("log.mtb", between=moments, **options)  # type: ignore[arg-type]
    except ValueError:
        log = None
    start, end = (
        word if moment is None else str(moment)
        for word, moment in zip(("start", "end"), moments, strict=True)
    )
    decode = ["decode", "log.mtb", "--between", start, end, *arguments]
    if log is None or not log.stats.bytes:
        sentence(run(*decode, "-o", "out.parquet"))
        assert not Path("out.parquet").exists()
        return
    result = run(*decode, "-o", "out.parquet")
    assert result.exit_code == 0, result.stderr
    assert_identical(pq.read_table("out.parquet"), log.to_arrow(key))
    run(*decode, "-o", "out/", "--partition-by", "hour")
    found = [pq.ParquetFile(path).read() for path in sorted(Path("out").rglob("*.parquet"))]
    assert sum(map(len, found)) == len(pq.read_table("out.parquet"))
    assert run(*decode, "-o", "out.npz").exit_code == 0
    with np.load("out.npz") as arrays:
        assert np.array_equal(arrays["packet_counter"], log["packet_counter"].values)


@pytest.mark.parametrize("name", ["walk.mtb", "walk.mtb.gz", "-"])
def test_exports_and_kinds_of_input(name: str) -> None:
    data = LOGS["walk"]
    Path("walk.mtb").write_bytes(data)
    Path("walk.mtb.gz").write_bytes(gzip.compress(data))
    Path("walk.mtb.times").write_bytes(times_of(data))
    moments = ("2", "5") if name == "-" else UTC
    result = run("decode", name, "-o", "out.gpx", "--between", *moments, stdin=data)
    assert result.exit_code == 0, result.stderr
    log = xbus.read_log("walk.mtb", between=UTC)
    log.to_gpx("expected.gpx")
    assert Path("out.gpx").read_bytes() == Path("expected.gpx").read_bytes()
    run("decode", name, "-o", "out.parquet", "--between", *moments, stdin=data)
    found = pq.read_table("out.parquet")
    assert ("host_time" in found.column_names) == (name != "-")
    if name != "-":
        assert_identical(found, log.to_arrow())


def test_a_batch() -> None:
    Path("in").mkdir()
    Path("in/a.mtb").write_bytes(LOGS["walk"])
    Path("in/b.mtb").write_bytes(b"".join(mtdata2(fine(100 * i)) for i in range(300)))
    batch = ["decode", "in", "--out-dir", "out", "--between"]
    assert run(*batch, "1", "2").exit_code == 0
    tables = [pq.read_table(f"out/{name}.parquet") for name in "ab"]
    assert [len(table) for table in tables] == [104, 100]
    result = run(*batch, *UTC)
    assert result.exit_code == 1
    assert "in/b.mtb: the recording has no valid UTC; use seconds" in result.stderr


@pytest.mark.parametrize(
    ("moments", "status", "message"),
    [
        (("5", "2"), 2, "the end must be after the start: 2.0 is not after 5.0"),
        (("-1", "2"), 2, "seconds count from the first sample and are not negative: -1.0"),
        (("inf", "end"), 2, "a moment must be a finite number of seconds, or UTC, not inf"),
        (("start", "nan"), 2, "a moment must be a finite number of seconds, or UTC, not nan"),
        (("noon", "end"), 2, "'noon' is neither seconds nor UTC such as 2026-11-22T09:30:00"),
        (("60", "end"), 1, "walk.mtb has no samples between these times"),
        (("2026-11-22T10:00:00", "end"), 1, "walk.mtb has no samples between these times"),
    ],
)
@pytest.mark.parametrize("suffix", ["parquet", "npz"])
def test_wrong_moments(moments: tuple[str, str], status: int, message: str, suffix: str) -> None:
    result = run("decode", WALK, "-o", f"out.{suffix}", "--between", *moments)
    assert result.exit_code == status
    assert message in result.stderr
    assert content(Path()) == {}


def test_strict_concerns_the_part_only() -> None:
    data = bytearray(LOGS["walk"])
    data[len(data) // 2] ^= 1
    Path("log.mtb").write_bytes(data)
    strict = ["decode", "log.mtb", "-o", "out.csv", "--strict", "--between"]
    assert run(*strict, "0", "1").exit_code == 0
    assert "of the part between these times" in sentence(run(*strict, "1", "end"))
