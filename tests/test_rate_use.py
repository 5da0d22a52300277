"""``--rate`` without effect: every command that reads recordings says so."""

from __future__ import annotations

from pathlib import Path

import pytest

from conftest import counter, fine, trigger
from streams import frame, mtdata2, packet
from test_cli import run

COUNTED = [mtdata2(counter(at)) for at in range(100)]
STAMPED = [mtdata2(counter(at), fine(100 * at)) for at in range(100)]
PLAIN = [mtdata2(packet(0xE010, b"\0"))] * 100
TRIGGERS = [mtdata2(counter(0), trigger(5000)), *COUNTED[1:]]
LATE = [*COUNTED[:40], mtdata2(counter(40), fine(0)), *COUNTED[41:]]
MESSAGES = [frame(0x3E)]

#: Recordings, and the line that --rate prints.
TABLE = {
    "effect": (COUNTED, None),
    "stamps": (STAMPED, "--rate has no effect: the device sends time stamps"),
    "neither": (PLAIN, "--rate has no effect: no sample has a packet counter"),
    "triggers": (TRIGGERS, "--rate has no effect: the device sends time stamps"),
    "late stamp": (
        LATE,
        "--rate gives no time to 59 samples after the first time stamp of the device",
    ),
    "messages": (MESSAGES, "--rate has no effect: no sample has a packet counter"),
}
COMMANDS = {
    "info": ["info"],
    "decode": ["decode", "-o", "out.npz"],
    "batch": ["decode", "--out-dir", "out", "--suffix", ".npz"],
    "report": ["report", "-o", "out.html"],
    "cut": ["cut", "--from", "0", "-o", "part.mtb"],
    "split": ["split", "--size", "1MB", "--out-dir", "pieces"],
    "dump": ["dump"],
}
#: What cannot work, for want of samples or of times.
FAILING = {("messages", command) for command in ("decode", "batch", "cut")} | {("neither", "cut")}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("name", TABLE)
def test_note(name: str, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    frames, note = TABLE[name]
    Path("x.mtb").write_bytes(b"".join(frames))
    result = run(*COMMANDS[command], "x.mtb", "--rate", "100")
    assert (result.exit_code == 1) == ((name, command) in FAILING)
    if (name, command) in FAILING:
        return
    lines = [line for line in result.stderr.splitlines() if "--rate" in line]
    assert lines == ([] if note is None else [f"xbus: x.mtb: {note}"])
    assert "--rate" not in run(*COMMANDS[command], "x.mtb").stderr.replace("--rate HZ", "")


def test_the_table_of_a_tracker_has_no_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    snapshot = (7).to_bytes(4, "big") + bytes(42)
    Path("x.mtb").write_bytes(mtdata2(packet(0xC810, snapshot)))
    args = ["decode", "x.mtb", "--tracker", "7", "-o", "out.npz", "--rate", "100"]
    text = "xbus: --rate has no effect: the table of a tracker has no times"
    assert run(*args).stderr.splitlines()[0] == text
