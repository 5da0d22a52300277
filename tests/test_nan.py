"""What is not known, and NaN on the wire: no text says "nan", and JSON has null."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, NoReturn

import pytest

import xbus
from conftest import counter, fine
from streams import frame, mtdata2, packet
from test_cli import run

NAN = float("nan")
VALUES = xbus.encode_sample(
    {"acceleration": [NAN, float("inf"), 1], "quaternion": [NAN] * 4, "temperature": NAN}
)[4:-1]
#: Everything "not provided".
PVT = packet(0x7010, b"\xff" * 94)
WAKE_UP, ERROR = frame(0x3E), frame(0x42, b"\x1e")


def samples(count: int, *stamps: bytes, bid: int = 0xFF) -> list[bytes]:
    return [mtdata2(counter(at), *stamps, VALUES, PVT, bid=bid) for at in range(count)]


LOGS = {
    "stamped": samples(20, fine(100)),
    "one stamp": samples(1, fine(100)),
    "no stamps": samples(20),
    "restart": [*samples(9), WAKE_UP, ERROR, *samples(9)],
    "gap": [*samples(9), *samples(20)[12:], ERROR],
    "bus": [*samples(9, bid=1), *samples(9, bid=2)],
    "neither": [mtdata2(VALUES)] * 9,
    "receiver": [mtdata2(PVT)] * 9,
    "messages": [WAKE_UP],
    "strings": [xbus.encode_string("GPGGA")],
}
COMMANDS = [
    ["info"],
    ["info", "--json"],
    ["info", "--out-dir", "out"],
    ["dump"],
    ["dump", "--json"],
    ["decode", "-o", "out.npz", "--json"],
    ["report", "-o", "out.html", "--json"],
    ["monitor", "--once", "0.1"],
    ["monitor", "--once", "0.1", "--json"],
    ["cut", "--from", "0", "-o", "out.mtb"],
]
UNKNOWN = re.compile(r"\bnan\b|\bNaT\b|\bNone\b")


def _refuse(name: str) -> NoReturn:
    raise ValueError(f"{name} is not JSON")


@pytest.fixture(autouse=True)
def _scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", LOGS)
def test_commands(name: str) -> None:
    pytest.importorskip("plotly")
    Path("x.mtb").write_bytes(b"".join(LOGS[name]))
    for command in COMMANDS:
        result = run(command[0], "x.mtb", *command[1:])
        assert not UNKNOWN.search(result.output), command
        if "--json" in command and result.exit_code == 0:
            objects = result.stdout.splitlines() if command[0] == "dump" else [result.stdout]
            for text in objects:
                json.loads(text, parse_constant=_refuse)
    if Path("out.html").exists():
        page = re.sub(
            r"(?s)<script.*?</script>|<style.*?</style>", "", Path("out.html").read_text()
        )
        assert not UNKNOWN.search(re.sub("<[^>]*>", " ", page))


@pytest.mark.parametrize("name", LOGS)
def test_logs_and_columns(name: str) -> None:
    log = xbus.read_log(b"".join(LOGS[name]))
    shown: Any
    for shown in (log, *log.values()):
        assert not UNKNOWN.search(repr(shown))
        assert not UNKNOWN.search(shown._repr_html_())


def test_html_of_a_struct_is_in_units() -> None:
    log = xbus.read_log(b"".join(LOGS["receiver"]))
    html = log["gnss_pvt_data"]._repr_html_()
    assert "<th>hAcc, m</th>" in html
    assert "4294967295" not in html
