"""``xbus decode`` part by part: the law is that table and summary are those of the whole log."""

from __future__ import annotations

import gzip
import io
import random
import shutil
from pathlib import Path
from typing import Any

import pyarrow.csv
import pyarrow.feather
import pyarrow.parquet as pq
import pytest

import streams
import xbus
from conftest import counter, fine
from streams import mtdata2, packet, random_log, real
from test_arrow import DATA
from test_cli import FIELD, WALK, run, sentence
from test_table_file import assert_identical
from xbus import MessageId, encode_frame
from xbus.cli import decoding
from xbus.cli.memory import workers_within
from xbus.cli.rotation import parse_size

#: Bytes of a part: so few that every log has many.
PART = 3000


def two_devices() -> bytes:
    """Two devices, of which the second starts late and restarts."""
    samples = [
        mtdata2(counter(i), fine(100 * i), real(0x4020, i, 0, 0), bid=1 + (i > 150 and i % 2))
        for i in range(400)
    ]
    return b"".join(samples) + encode_frame(MessageId.WakeUp, bid=2) + b"".join(samples)


def late_columns() -> bytes:
    """Quantities that begin late, in one precision and then in another, and with other coordinates."""
    early = [mtdata2(counter(i), fine(i)) for i in range(300)]
    late = [mtdata2(counter(i), packet(0x0810, b"\x41\x20\0\0")) for i in range(300, 500)]
    wider = [mtdata2(counter(i), packet(0x0813, bytes(8))) for i in range(500, 520)]
    turned = [mtdata2(real(0x2010 + 4 * (i % 2), 1, 0, 0, 0)) for i in range(100)]
    return b"".join(early + late + wider + turned) + DATA


LOGS = {
    "walk": Path(WALK).read_bytes(),
    "field": Path(FIELD).read_bytes(),
    "two devices": two_devices(),
    "late columns": late_columns(),
    "dirty": streams.dirty(400),
    "with position": streams.gnssins(300),
    "random 1": random_log(random.Random(1), 600),
    "random 2": random_log(random.Random(2), 600),
}
OPTIONS: dict[str, tuple[list[str], dict[str, Any], Any]] = {
    "all": ([], {}, None),
    "raw": (["--raw"], {}, None),
    "one quantity": (["--quantity", "acceleration"], {}, "acceleration"),
    "two quantities": (
        ["--quantity", "packet_counter", "--quantity", "acceleration"],
        {"quantities": ["packet_counter", "acceleration"]},
        None,
    ),
    "satellites": (["--quantity", "gnss_sat_info"], {}, "gnss_sat_info"),
    "one device": (["--bid", "2"], {"bid": 2}, None),
    "a rate": (["--rate", "50"], {"rate": 50}, None),
}


@pytest.fixture(autouse=True)
def _small_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(decoding, "PART", PART)


def at_once(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> tuple[int, str, str]:
    """Returns exit status, summary and messages of a decode that reads the whole log into memory."""
    with monkeypatch.context() as context:
        context.setattr(decoding.Decoding, "_needs_whole_log", lambda *_: True)
        result = run("decode", *arguments)
    return result.exit_code, result.stdout, result.stderr


@pytest.mark.parametrize("options", list(OPTIONS))
@pytest.mark.parametrize("log", list(LOGS))
def test_table_and_summary(log: str, options: str, monkeypatch: pytest.MonkeyPatch) -> None:
    Path("log.mtb").write_bytes(LOGS[log])
    arguments, how, key = OPTIONS[options]
    result = run("decode", "log.mtb", "-o", "out.parquet", "--json", *arguments)
    whole = at_once(monkeypatch, "log.mtb", "-o", "whole.parquet", "--json", *arguments)
    lines = [text.replace("whole.parquet", "out.parquet") for text in whole[1:]]
    assert (result.exit_code, result.stdout, result.stderr) == (whole[0], *lines)
    if result.exit_code == 0:
        expected = xbus.read_log("log.mtb", **how).to_arrow(key, raw="--raw" in arguments)
        found = pq.read_table("out.parquet")
        assert found.schema.equals(pq.read_table("whole.parquet").schema, check_metadata=True)
        assert_identical(found, expected)
    else:
        assert not Path("out.parquet").exists()


def test_formats() -> None:
    Path("log.mtb").write_bytes(LOGS["late columns"])
    expected = xbus.read_log("log.mtb").to_arrow()
    for suffix in ("csv", "arrow", "feather"):
        assert run("decode", "log.mtb", "-o", f"out.{suffix}").exit_code == 0
    text = io.BytesIO()
    pyarrow.csv.write_csv(expected, text)
    assert Path("out.csv").read_bytes() == text.getvalue()
    for name in ("out.arrow", "out.feather"):
        found = pyarrow.feather.read_table(name)
        assert found.schema.equals(expected.schema, check_metadata=True)
        assert_identical(found, expected)


def times_of(data: bytes, pieces: int = 40) -> bytes:
    """Returns a side file with arrivals."""
    import numpy as np

    from xbus.log.arrivals import Arrivals

    end = np.linspace(1, len(data), pieces).astype(np.int64)
    return b"".join(Arrivals(end, 10**18 + end * 10**5, len(data)).blocks())


@pytest.mark.parametrize("kind", ["plain", "gzip", "gzip with the side file", "stdin", "hex"])
@pytest.mark.parametrize("log", ["walk", "two devices"])
def test_kinds_of_input(kind: str, log: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a file, a compressed file and a stream the table is the same, with host times if they are known."""
    data, stdin, arguments = LOGS[log], None, ["log.mtb"]
    Path("log.mtb").write_bytes(data)
    match kind:
        case "plain":
            Path("log.mtb.times").write_bytes(times_of(data))
        case "gzip":
            arguments = ["log.mtb.gz"]
            Path("log.mtb.gz").write_bytes(gzip.compress(data))
        case "gzip with the side file":
            arguments = ["log.mtb.gz"]
            Path("log.mtb.gz").write_bytes(gzip.compress(data))
            Path("log.mtb.times").write_bytes(times_of(data))
        case "stdin":
            stdin, arguments = data, ["-"]
        case "hex":
            arguments = ["log.txt", "--hex"]
            Path("log.txt").write_text(data.hex(" "))
    result = run("decode", *arguments, "-o", "out.parquet", stdin=stdin)
    assert result.exit_code == 0, result.stderr
    expected = xbus.read_log(arguments[0] if "gz" in arguments[0] else "log.mtb").to_arrow()
    assert ("host_time" in expected.column_names) == Path("log.mtb.times").exists()
    assert_identical(pq.read_table("out.parquet"), expected)


def test_temporary_copies_are_deleted(monkeypatch: pytest.MonkeyPatch) -> None:
    Path("temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", "temporary")
    assert run("decode", "-", "-o", "out.csv", stdin=LOGS["walk"]).exit_code == 0
    assert "no Xbus frame" in sentence(run("decode", "-", "-o", "no.csv", stdin=b"no frame"))
    assert list(Path("temporary").iterdir()) == []


def test_no_room_for_a_temporary_copy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", "nowhere")
    text = sentence(run("decode", "-", "-o", "out.csv", stdin=LOGS["walk"]))
    assert text.startswith("cannot copy the input to a temporary file in nowhere (set TMPDIR")
    assert not Path("out.csv").exists()


@pytest.mark.parametrize("cuts", [(5000,), (1, 40_000, 40_001)])
def test_pieces(cuts: tuple[int, ...]) -> None:
    data, names = LOGS["walk"], []
    for number, (start, end) in enumerate(zip((0, *cuts), (*cuts, len(data)), strict=True)):
        names.append(f"log-{number:04}.mtb" if number else "log.mtb")
        Path(names[-1]).write_bytes(data[start:end])
        Path(f"{names[-1]}.times").write_bytes(times_of(data[start:end], min(40, end - start)))
    assert run("decode", *reversed(names), "-o", "out.parquet").exit_code == 0
    expected = xbus.read_log(names).to_arrow()
    assert "host_time" in expected.column_names
    assert_identical(pq.read_table("out.parquet"), expected)


@pytest.mark.parametrize("kind", ["plain", "stdin"])
def test_strict(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    Path("log.mtb").write_bytes(LOGS["dirty"])
    stdin = LOGS["dirty"] if kind == "stdin" else None
    name = "-" if kind == "stdin" else "log.mtb"
    text = sentence(run("decode", name, "-o", "out.csv", "--strict", stdin=stdin))
    _, _, expected = at_once(monkeypatch, "log.mtb", "-o", "out.csv", "--strict")
    assert f"xbus: {text}\n".replace("standard input", "log.mtb") == expected
    assert run("decode", WALK, "-o", "walk.csv", "--strict").exit_code == 0


def test_a_file_that_changes_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second pass finds another file than the first."""
    shutil.copy(WALK, "log.mtb")
    Path("out.parquet").write_text("what was there")
    split = xbus.split_log

    def split_and_append(*args: Any, **options: Any) -> Any:
        parts = split(*args, **options)
        with Path("log.mtb").open("ab") as file:
            file.write(bytes(10))
        return parts

    monkeypatch.setattr("xbus.log.parts.split_log", split_and_append)
    assert sentence(run("decode", "log.mtb", "-o", "out.parquet")) == (
        "log.mtb changed while it was decoded; wait until it is complete, or decode what it has now with "
        "xbus decode - < log.mtb"
    )
    assert Path("out.parquet").read_text() == "what was there"
    assert len(list(Path().iterdir())) == 2


def test_a_file_that_disappears_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy(WALK, "log.mtb")
    split = xbus.split_log

    def split_and_delete(*args: Any, **options: Any) -> Any:
        parts = split(*args, **options)
        Path("log.mtb").unlink()
        return parts

    monkeypatch.setattr("xbus.log.parts.split_log", split_and_delete)
    expected = "cannot read log.mtb: No such file or directory; check the path"
    assert sentence(run("decode", "log.mtb", "-o", "out.parquet")) == expected
    assert not list(Path().iterdir())


def test_pieces_of_different_devices_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    from xbus.log.pieces import PiecesError

    def refuse(*_: object, **__: object) -> None:
        raise PiecesError("log-0001.mtb", "log.mtb", "it is from another device", is_restart=False)

    shutil.copy(WALK, "log.mtb")
    monkeypatch.setattr("xbus.log.parts.split_log", refuse)
    assert "it is from another device" in sentence(run("decode", "log.mtb", "-o", "out.parquet"))


def test_many_recordings(tmp_path: Path) -> None:
    for name in ("walk", "field", "dirty"):
        Path(f"{name}.mtb").write_bytes(LOGS[name])
    result = run("decode", "*.mtb", "--out-dir", "out", "--jobs", "2")
    assert result.exit_code == 0
    assert "3 recordings done" in result.stderr
    for name in ("walk", "field", "dirty"):
        assert_identical(
            pq.read_table(f"out/{name}.parquet"), xbus.read_log(f"{name}.mtb").to_arrow()
        )


# ---------------------------------------------------------------------------------------------
# Memory
# ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("memory", "message"),
    [
        ("204MB", "204MB is too little; decode needs 205MB"),
        ("1kB", "1kB is too little; decode needs 205MB"),
        ("much", "'much' is no size, such as 500MB or 2GB"),
        ("2.5XB", "'2.5XB' is no size, such as 500MB or 2GB"),
        ("512", "512 is too little; decode needs 205MB"),
    ],
)
def test_too_little_memory(memory: str, message: str) -> None:
    result = run("decode", WALK, "-o", "out.csv", "--memory", memory)
    assert result.exit_code == 2
    assert message in result.stderr


@pytest.mark.parametrize(
    ("text", "size"), [("210000000", 210_000_000), ("0.5 GB", 5 * 10**8), ("100TB", 10**14)]
)
def test_sizes(text: str, size: int) -> None:
    assert parse_size(text) == size


@pytest.mark.parametrize(
    ("memory", "recordings", "jobs", "expected"),
    [
        (205, 1, None, (1, 1)),
        (512, 1, None, (1, 10)),
        (10_000, 1, None, (1, 16)),
        (512, 100, None, (2, 2)),
        (10_000, 100, None, (16, 1)),
        (10_000, 100, 4, (4, 4)),
        (512, 2, 4, (2, 2)),
    ],
)
def test_workers_within_memory(
    memory: int,
    recordings: int,
    jobs: int | None,
    expected: tuple[int, int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 16)
    assert workers_within(memory * 10**6, recordings, jobs) == expected


def test_parts_of_a_wide_table_are_smaller(monkeypatch: pytest.MonkeyPatch) -> None:
    """The table of a part has no more rows than a chunk of the file."""
    monkeypatch.setattr("xbus.log.part_file.chunk_rows", lambda *_, **__: 10)
    sizes = []
    split = xbus.split_log

    def noted(*args: Any, **options: Any) -> Any:
        parts = split(*args, **options)
        sizes.append(max(part.samples for part in parts))
        return parts

    monkeypatch.setattr("xbus.log.parts.split_log", noted)
    assert run("decode", WALK, "-o", "out.parquet").exit_code == 0
    assert sizes[0] > 15 > sizes[1]
    assert_identical(pq.read_table("out.parquet"), xbus.read_log(WALK).to_arrow())
