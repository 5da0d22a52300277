"""``decode``, ``info`` and ``report`` of many recordings."""

from __future__ import annotations

import json
import os
import random
import signal
import time
from pathlib import Path

import pyarrow.parquet
import pytest

import xbus
from test_cli import FIELD, WALK, run, start
from test_cli_decode import rotated
from xbus.cli import batch
from xbus.cli.progress import Progress, ShowsProgress
from xbus.cli.recordings import Recording


@pytest.fixture(autouse=True)
def _empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def forty_files() -> dict[str, bytes]:
    """Writes recordings of mixed quality: sound, cut, damaged, and five without a frame."""
    rng = random.Random(13)
    found = {}
    for at in range(40):
        data = bytearray(Path(rng.choice([WALK, FIELD])).read_bytes())
        if at % 8 == 0:
            data = bytearray([b"", b"no frame" * 99][at % 16 // 8])
        elif at % 3 == 0:
            data = data[rng.randrange(len(data) // 2) : rng.randrange(len(data) // 2, len(data))]
        elif at % 3 == 1:
            for _ in range(50):
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        found[f"log {at:02}"] = bytes(data)
        Path(f"logs/log {at:02}.mtb").write_bytes(data)
    return found


def test_forty_files_of_mixed_quality() -> None:
    Path("logs").mkdir()
    logs = forty_files()
    result = run("decode", "logs", "--out-dir", "out/tables", "--json")
    assert result.exit_code == 1
    outcomes = json.loads(result.stdout)
    assert [outcome["files"] for outcome in outcomes] == [[f"logs/{name}.mtb"] for name in logs]
    for (name, data), outcome in zip(logs.items(), outcomes, strict=True):
        log = xbus.read_log(data)
        out = Path(f"out/tables/{name}.parquet")
        assert outcome["out"] == str(out)
        if len(log):
            assert pyarrow.parquet.read_metadata(out).num_rows == len(log) == outcome["rows"]
        else:
            assert outcome["error"].startswith(f"no Xbus frame in logs/{name}.mtb: ")
            assert not out.exists()
    assert len(list(Path("out/tables").iterdir())) == 35
    lines = result.stderr.splitlines()
    assert [line.split(":")[0] for line in lines[:5]] == ["xbus"] * 5
    assert lines[5].split() == ["recording", "result"]
    assert lines[7].startswith("logs/log 01.mtb  ")
    assert lines[-1] == "35 recordings done, 5 failed"


@pytest.mark.parametrize("jobs", ["1", "3"])
def test_the_number_of_jobs_does_not_matter(jobs: str) -> None:
    for name in "abc":
        Path(f"{name}.mtb").write_bytes(Path(WALK).read_bytes())
    for suffix in (".parquet", ".csv", ".npz"):
        options = ["--out-dir", "out", "--jobs", jobs, "--suffix", suffix]
        assert run("decode", ".", *options).exit_code == 0
        run("decode", WALK, "-o", f"whole{suffix}")
        whole = Path(f"whole{suffix}").read_bytes()
        if suffix != ".npz":  # which has the time of writing
            assert all(Path(f"out/{name}{suffix}").read_bytes() == whole for name in "abc")
    assert len(list(Path("out").iterdir())) == 9


def test_skip_existing() -> None:
    for name in "ab":
        Path(f"{name}.mtb").write_bytes(Path(WALK).read_bytes())
    Path("out").mkdir()
    Path("out/a.csv").write_text("old")
    options = ["--out-dir", "out", "--suffix", ".csv", "--skip-existing"]
    result = run("decode", "a.mtb", "b.mtb", *options, "--json")
    assert result.exit_code == 0
    assert Path("out/a.csv").read_text() == "old"
    first, second = json.loads(result.stdout)
    assert first == {"files": ["a.mtb"], "out": "out/a.csv", "skipped": True}
    assert second["rows"] == 1040
    assert result.stderr.splitlines()[-1] == "1 recording done, 1 skipped"


def test_pieces_are_one_recording() -> None:
    names = rotated()
    Path("other.mtb").write_bytes(Path(WALK).read_bytes())
    assert run("decode", *names, "other.mtb", "--out-dir", "out").exit_code == 0
    assert sorted(path.name for path in Path("out").iterdir()) == ["night.parquet", "other.parquet"]
    assert pyarrow.parquet.read_metadata("out/night.parquet").num_rows == 1000


def test_numbered_recordings_are_separate() -> None:
    """Other programs number whole recordings; without the first name of a recorder, times decide."""
    for at in range(1, 4):
        run("record", "sim:MTi-630", "-o", f"run-000{at}.mtb", "--duration", "1")
    result = run("decode", ".", "--out-dir", "out")
    assert result.exit_code == 0
    assert "run-0002.mtb does not continue " in result.stderr
    assert [path.name for path in sorted(Path("out").iterdir())] == [
        f"run-000{at}.parquet" for at in range(1, 4)
    ]


def test_folders_are_kept() -> None:
    for name in ("a/log.mtb", "b/c/log.mtb"):
        Path(name).parent.mkdir(parents=True)
        Path(name).write_bytes(Path(WALK).read_bytes())
    assert run("decode", "**/*.mtb", "--out-dir", "out").exit_code == 0
    found = sorted(str(path) for path in Path("out").rglob("*.parquet"))
    assert found == ["out/a/log.parquet", "out/b/c/log.parquet"]
    Path("a/log.bin").write_bytes(Path(FIELD).read_bytes())
    result = run("decode", "a/*", "--out-dir", "out")
    assert result.exit_code == 2
    assert "would both be written to out/log.parquet" in " ".join(result.stderr.split())


@pytest.mark.parametrize(
    ("args", "words"),
    [
        ([], "add -o OUT, or --out-dir DIR"),
        (["-o", "a.csv", "--out-dir", "out"], "remove one"),
        (["-o", "a.csv", "--jobs", "2"], "--jobs needs --out-dir"),
        (["-o", "a.csv", "--skip-existing"], "--skip-existing needs --out-dir"),
    ],
)
def test_wrong_calls(args: list[str], words: str) -> None:
    result = run("decode", WALK, *args)
    assert result.exit_code == 2
    assert words in " ".join(result.stderr.split())


def test_info() -> None:
    Path("logs").mkdir()
    Path("logs/a.mtb").write_bytes(Path(WALK).read_bytes())
    Path("logs/b.mtb").write_bytes(b"")
    result = run("info", "logs", "--out-dir", "out")
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr.splitlines()[-1] == "1 recording done, 1 failed"
    (expected,) = json.loads(run("info", "--json", "logs/a.mtb").stdout)
    assert json.loads(Path("out/a.json").read_text()) == expected
    assert [path.name for path in Path("out").iterdir()] == ["a.json"]
    result = run("info", WALK, "--skip-existing")
    assert (result.exit_code, "--skip-existing needs --out-dir" in result.stderr) == (2, True)


def test_report() -> None:
    for name, source in (("a", WALK), ("b", FIELD)):
        Path(f"{name}.mtb").write_bytes(Path(source).read_bytes())
    result = run("report", ".", "--out-dir", "out", "--json")
    assert result.exit_code == 0
    first, second = json.loads(result.stdout)
    assert (first["out"], first["samples"], second["damage"]) == ("out/a.html", 1040, 12)
    result = run("report", "a.mtb", "-o", "a.html", "--json", "--quiet")
    assert json.loads(result.stdout) == first | {"files": ["a.mtb"], "out": "a.html"}
    assert "<title>b.mtb" in Path("out/b.html").read_text("utf-8")
    assert sorted(path.name for path in Path("out").iterdir()) == ["a.html", "b.html"]


def test_one_progress_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reading is the first half of each recording, writing the second."""
    reported: list[tuple[str, int, int]] = []
    monkeypatch.setattr(Progress, "update", lambda _, *args: reported.append(args))
    for name in "ab":
        Path(f"{name}.mtb").write_bytes(Path(WALK).read_bytes())
    run("decode", ".", "--out-dir", "out", "--jobs", "1")
    size = Path(WALK).stat().st_size
    done = [item[1] for item in reported]
    assert done == sorted(done)
    assert {size // 2, size, 2 * size} <= set(done)
    assert reported[-1] == ("2 of 2 recordings", 2 * size, 2 * size)


def test_progress_of_writing(monkeypatch: pytest.MonkeyPatch) -> None:
    reported: list[tuple[str, int, int]] = []
    monkeypatch.setattr(Progress, "update", lambda _, *args: reported.append(args))
    size = Path(WALK).stat().st_size
    run("decode", WALK, "-o", "out.csv")
    assert reported[-2:] == [("writing out.csv", 0, size), ("writing out.csv", size, size)]
    reported.clear()
    run("decode", WALK, "-o", "out.npz")
    done = [done for task, done, _ in reported if task == "writing out.npz"]
    assert done == sorted(done)
    assert (done[0], done[-1]) == (0, size)
    assert len(done) > len(xbus.read_log(WALK).keys())  # after each array


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes")
def test_only_files_of_a_folder_are_recordings() -> None:
    """A pipe would wait for a writer. One that is named is read, and Ctrl-C ends the wait."""
    Path("a.mtb").write_bytes(Path(WALK).read_bytes())
    os.mkfifo("b.mtb")
    for given in (".", "*.mtb"):
        result = run("decode", given, "--out-dir", "out", "--suffix", ".npz")
        assert (result.exit_code, result.stderr.splitlines()[-1]) == (0, "1 recording done")
    arguments = ["decode", "b.mtb", "a.mtb", "--out-dir", "pipes", "--suffix", ".npz"]
    with start(*arguments) as child:
        while not Path("pipes/a.npz").exists():
            assert child.poll() is None
            time.sleep(0.01)
        child.send_signal(signal.SIGINT)
        assert child.wait(timeout=20) == 130
    assert [path.name for path in Path("pipes").iterdir()] == ["a.npz"]


@pytest.mark.skipif(os.name == "nt", reason="links need rights")
def test_a_link_is_the_same_file() -> None:
    """Links to pieces, such as that to the latest one, do not hide their names."""
    data = Path(WALK).read_bytes()
    Path("walk.mtb").write_bytes(data[:80_000])
    Path("walk-0001.mtb").write_bytes(data[80_000:])
    Path("a-latest.mtb").symlink_to("walk-0001.mtb")
    shown = json.loads(
        run("info", ".", "a-latest.mtb", str(Path("walk.mtb").resolve()), "--json").stdout
    )
    assert [item["files"] for item in shown] == [["./walk.mtb", "./walk-0001.mtb"]]


@pytest.mark.skipif(os.name == "nt", reason="such names do not exist")
def test_names_that_would_break_a_line() -> None:
    for name in ("one\ntwo.mtb", "bell\a.mtb", "a b.mtb"):
        Path(name).write_bytes(Path(WALK).read_bytes())
    result = run("decode", ".", "--out-dir", "out", "--suffix", ".npz")
    names = [line.partition("  ")[0] for line in result.stderr.splitlines()[1:-1]]
    assert names == ["./a b.mtb", "./bell\\x07.mtb", "./one\\ntwo.mtb"]
    assert Path("out/one\ntwo.npz").exists()


def test_an_interrupt_stops_all_jobs() -> None:
    """Jobs that run end with their next step, and leave no partial file."""
    Path("a.mtb").write_bytes(Path(WALK).read_bytes())
    done: list[str | None] = []

    def work(job: batch.Job, progress: ShowsProgress) -> tuple[str, dict[str, object]]:
        if job.out == "0":
            raise KeyboardInterrupt
        while True:
            progress.update("reading", len(done), 1000)
            done.append(job.out)

    recording = Recording(["a.mtb"])
    jobs = [batch.Job(recording, str(at)) for at in range(9)]
    with pytest.raises(KeyboardInterrupt):
        batch.run(jobs, work, workers=3, skip_existing=False, quiet=True)
    assert set(done) <= {"1", "2", "3"}
