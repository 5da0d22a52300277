"""``xbus report``."""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path

import pytest

from test_cli import FIELD, WALK, run, sentence, start

pytest.importorskip("plotly")


@pytest.fixture(autouse=True)
def _scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_report_writes_a_page() -> None:
    result = run("report", FIELD, "-o", "field.html")
    assert (result.exit_code, result.stdout) == (0, "")
    assert result.stderr == (
        "field.html: 9.99 s, 23 samples lost in 12 gaps, 1,816 bytes of damage in 12 places\n"
    )
    assert "<title>field.mtb</title>" in Path("field.html").read_text("utf-8")


def test_quiet_and_title() -> None:
    result = run("report", "-q", WALK, "-o", "WALK.HTM", "--title", "<Tuesday>")
    assert (result.exit_code, result.output) == (0, "")
    assert "<h1>&lt;Tuesday&gt;</h1>" in Path("WALK.HTM").read_text("utf-8")


def test_a_split_recording_has_one_page() -> None:
    data = Path(WALK).read_bytes()
    Path("a.mtb").write_bytes(data[:80_001])
    Path("b.mtb").write_bytes(data[80_001:])
    assert run("report", "a.mtb", "b.mtb", "-o", "both.html").exit_code == 0
    text = Path("both.html").read_text("utf-8")
    assert "<h1>a.mtb, b.mtb</h1>" in text
    assert "<dt>samples</dt><dd>1,040</dd>" in text


def test_different_recordings_stand_side_by_side() -> None:
    result = run("report", FIELD, WALK, "-o", "both.html", "--json")
    assert result.exit_code == 0
    first, second = json.loads(result.stdout)
    assert (first["files"], second["files"]) == ([FIELD], [WALK])
    assert (first["lost_samples"], second["lost_samples"]) == (23, 0)
    assert result.stderr == (
        "both.html: field.mtb: 9.99 s, 23 samples lost in 12 gaps, 1,816 bytes of damage in 12 places\n"
        "both.html: walk.mtb: 9.99 s, no samples lost, no damage\n"
    )
    text = Path("both.html").read_text("utf-8")
    assert "<h1>field.mtb, walk.mtb</h1>" in text
    assert text.count("<dt>samples</dt>") == 2


def test_recordings_of_the_same_name_have_their_folders() -> None:
    for folder, source in (("a", FIELD), ("b", WALK)):
        Path(folder).mkdir()
        Path(folder, "x.mtb").write_bytes(Path(source).read_bytes())
    assert run("report", "a/x.mtb", "b/x.mtb", "-o", "both.html").exit_code == 0
    assert "<h1>a/x.mtb, b/x.mtb</h1>" in Path("both.html").read_text("utf-8")


def test_one_bad_recording_of_several_is_an_error() -> None:
    Path("no.mtb").write_bytes(b"nothing")
    assert "no Xbus frame in no.mtb" in sentence(
        run("report", FIELD, WALK, "no.mtb", "-o", "both.html")
    )
    assert not Path("both.html").exists()


def test_options_add_to_the_page() -> None:
    options = {"--spectrum": "spectrum acc", "--spectrogram": "spectrogram acc", "--map": "map"}
    for option in [[], *([option] for option in options)]:
        assert run("report", WALK, "-o", "walk.html", *option).exit_code == 0
        figures = Path("walk.html").read_text("utf-8").partition('id="figures">')[2][: 10**6]
        for name, first in options.items():
            assert (f'"name":"{first}' in figures) == (name in option), (option, name)


def test_standard_input() -> None:
    result = run("report", "-", "-o", "walk.html", stdin=Path(WALK).read_bytes())
    assert result.exit_code == 0
    assert "<h1>standard input</h1>" in Path("walk.html").read_text("utf-8")


def test_an_existing_file_is_replaced_and_kept_on_failure() -> None:
    Path("walk.html").write_text("before")
    Path("no.mtb").write_bytes(b"nothing")
    assert "no Xbus frame in no.mtb" in sentence(run("report", "no.mtb", "-o", "walk.html"))
    assert Path("walk.html").read_text() == "before"
    assert run("report", WALK, "-o", "walk.html").exit_code == 0
    assert Path("walk.html").stat().st_size > 10**6
    assert sorted(path.name for path in Path().iterdir()) == ["no.mtb", "walk.html"]


def test_an_unwritable_output_is_reported() -> None:
    shown = sentence(run("report", WALK, "-o", "nowhere/walk.html"))
    assert shown == "cannot write nowhere/walk.html: No such file or directory; check the path"
    Path("walk.html").mkdir()
    assert "cannot write walk.html: Is a directory" in sentence(
        run("report", WALK, "-o", "walk.html")
    )


def test_the_input_is_not_overwritten() -> None:
    Path("log.html").write_bytes(Path(WALK).read_bytes())
    result = run("report", "log.html", "-o", "log.html")
    assert result.exit_code == 2
    assert "OUT is the input log.html" in result.stderr


def test_without_plotly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "plotly", None)
    shown = sentence(run("report", WALK, "-o", "walk.html"))
    assert shown == 'to write a report, plotly is needed: pip install "xbus-mti[report]"'
    assert list(Path().iterdir()) == []


def test_a_full_disk() -> None:
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("no /dev/full")
    Path("walk.html").symlink_to(full)
    assert "No space left on device; free some space" in sentence(
        run("report", WALK, "-o", "walk.html")
    )


def test_ctrl_c_leaves_nothing() -> None:
    os.mkfifo("port")
    with start("report", "port", "-o", "walk.html") as child, Path("port").open("wb", 0) as writer:
        # Opening the pipe for writing succeeds only once the child reads it.
        writer.write(Path(WALK).read_bytes()[:1000])
        child.send_signal(signal.SIGINT)
        out, shown = child.communicate()
    assert (child.returncode, out, shown) == (130, b"", b"")
    assert [path.name for path in Path().iterdir()] == ["port"]


def test_file_names_are_escaped() -> None:
    evil = "a\u202e\x1b[0m<b>.mtb"
    Path(evil).write_bytes(Path(WALK).read_bytes())
    odd = os.fsdecode(b"\xff.mtb")
    Path(odd).write_bytes(b"")
    result = run("report", evil, odd, "-o", "walk.html")
    assert result.exit_code == 0
    head = Path("walk.html").read_text("utf-8").partition("<style>")[0]
    assert "<title>a\\u202e\\x1b[0m&lt;b&gt;.mtb, " in head
    assert "\u202e" not in head
