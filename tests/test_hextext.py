"""Hex text as people paste it."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import xbus
from test_cli import WALK, run, sentence

FRAME = bytes.fromhex("FAFF3000D1")


@pytest.mark.parametrize(
    "text",
    [
        "FA FF 30 00 D1",
        "faff3000d1",
        "FAFF 3000 D1",
        "0xFA, 0xFF, 0x30, 0x00, 0xD1",
        "0xFAFF3000D1",
        r"\xFA\xFF\x30\x00\xD1",
        "FA:FF:30:00:D1",
        "FA-FF-30-00-D1",
        "2026-11-29 12:00:01 RX FA-FF-30-00-D1",
        "FAh FFh 30h 00h D1h",
        "FA FF 30 0 D1",
        "FA FF\n30\r\n\n00 D1\n",
        "const uint8_t goToConfig[5] = {0xFA, 0xFF, 0x30, 0x00, 0xD1};",
        "[12:00:01.250] Sent: FA FF 30 00 D1",
        "12:00:01 TX -> FA FF 30 00 D1",
        "> FA FF 30 00 D1",
        "```\nFA FF 30 00 D1\n```",
        "FA FF 30 00 D1  // GoToConfig",
        "# a message\nFA FF 30 00 D1 # GoToConfig",
        "/* GoToConfig */ FA FF 30 00 D1",
        "\x1b[32mFA FF\x1b[0m 30 00 D1",
        r">>> b'\xfa\xff0\x00\xd1'",
        r'b"\xfa\xff" b"0\x00\xd1"',
        "00000000: faff 3000 d1                             ..0..",
        "00000000  fa ff 30 00 d1",
        "0000   fa ff 30   ..0\n0003   00 d1      ..",
        "\ufeffFA FF 30 00 D1",
        "00000000  fa ff 30 00 d1                                    |..0..|\n00000005",
    ],
)
def test_from_hex(text: str) -> None:
    assert xbus.from_hex(text) == FRAME


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", "no byte in the hex text"),
        ("nothing", "no byte in the hex text"),
        ("FA FF\nFA FF 30 00 G1", "line 2 of the hex text: 'G1' is not hex"),
        ("FAF", "'FAF' has an odd number of digits"),
        ("00000000  fa ff  |..|\n*\n", "line 2 .*hexdump -v"),
    ],
)
def test_errors(text: str, error: str) -> None:
    with pytest.raises(ValueError, match=error):
        xbus.from_hex(text)


@given(st.binary(min_size=1, max_size=70))
def test_any_bytes(data: bytes) -> None:
    for text in (data.hex(), data.hex(" "), data.hex(" ", 2), data.hex(":"), repr(data)):
        if text == data.hex(":") and len(data) == 3:
            continue  # which can be a time
        assert xbus.from_hex(text) == data


@pytest.mark.parametrize("command", [["xxd"], ["hexdump", "-Cv"]], ids=lambda item: item[0])
def test_dumps_of_other_programs(command: list[str]) -> None:
    if shutil.which(command[0]) is None:
        pytest.skip(f"{command[0]} is absent")
    dump = subprocess.run([*command, WALK], capture_output=True, check=True, text=True)  # noqa: S603
    assert xbus.from_hex(dump.stdout) == Path(WALK).read_bytes()


def test_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    data = Path(WALK).read_bytes()
    Path("issue.txt").write_text("Received:\n" + data.hex(" ").upper())
    assert run("decode", "issue.txt", "--hex", "-o", "out.csv").stderr.startswith(
        "out.csv: 1,040 rows"
    )
    (found,) = json.loads(run("info", "-", "--hex", "--json", stdin=data.hex().encode()).stdout)
    assert found["samples"] == 1040
    shown = run("dump", "-", "--hex", "--no-hex", stdin=b"RX: FA FF 31 00 D0").stdout
    assert "GoToConfigAck" in shown
    Path("bad.txt").write_text("FA FF zz")
    output = sentence(run("info", "bad.txt", "--hex"))
    assert output == "cannot read bad.txt: line 1 of the hex text: 'zz' is not hex"
