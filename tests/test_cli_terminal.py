"""Commands on a terminal, and the tables that they print to terminals and pipes."""

from __future__ import annotations

import json
import operator
import os
import pty
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from test_cli import ENVIRONMENT, FIELD, PROGRAM, WALK, run, sentence
from xbus.cli.inputs import Input
from xbus.cli.progress import DELAY, Progress
from xbus.protocol.tables import MESSAGES, PRODUCTS, QUANTITIES


def waiting(seconds: int) -> list[str]:
    """Returns a command line of the program in which the progress bar appears after this delay."""
    code = (
        "import sys; from xbus.cli import main, progress; progress.DELAY = {}; main(sys.argv[1:])"
    )
    return [sys.executable, "-c", code.format(seconds)]


IMPATIENT, PATIENT = waiting(0), waiting(3600)


class Terminal:
    """A terminal: the output of the program as it arrives."""

    def __init__(self, master: int) -> None:
        self._master = master
        self.text = ""

    def more(self) -> bool:
        """Waits for something; False once the program has let go of the terminal."""
        try:
            data = os.read(self._master, 65536)
        except OSError:  # Linux reports a closed terminal in this way
            return False
        self.text += data.decode()
        return bool(data)

    def wait_for(self, words: str) -> None:
        while words not in self.text:
            assert self.more(), self.text

    def wait_for_the_end(self) -> str:
        while self.more():
            pass
        return self.text


@contextmanager
def on_terminal(
    command: list[str], *, columns: int = 80, **others: int
) -> Iterator[tuple[subprocess.Popen[bytes], Terminal]]:
    """Yields a program on a terminal; ``others`` replace its standard streams."""
    master, slave = pty.openpty()
    env = {**ENVIRONMENT, "COLUMNS": str(columns), "TERM": "xterm"}
    env.pop("NO_COLOR", None)
    streams = {"stdin": slave, "stdout": slave, "stderr": slave} | others
    with subprocess.Popen(command, env=env, **streams) as child:  # type: ignore[call-overload] # noqa: S603
        os.close(slave)
        try:
            yield child, Terminal(master)
        finally:
            os.close(master)


def printed(*args: str, columns: int = 80) -> str:
    """Returns what a command prints on a terminal."""
    with on_terminal([*PROGRAM, *args], columns=columns) as (child, terminal):
        text = terminal.wait_for_the_end()
        assert child.wait() == 0
    return text.replace("\r\n", "\n")


def plain(text: str) -> str:
    return re.sub(r"\x1b\[[0-9;]*m", "", text)


# Progress


@pytest.mark.parametrize("args", [["info"], ["decode", "-o", "out.csv"]], ids=["info", "decode"])
def test_progress(args: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The bar is on stderr while bytes arrive, and is removed at the end."""
    monkeypatch.chdir(tmp_path)
    os.mkfifo("port")
    data = Path(WALK).read_bytes()
    out, theirs = os.pipe()
    with on_terminal([*IMPATIENT, *args, "port"], stdout=theirs) as (child, terminal):
        os.close(theirs)
        with Path("port").open("wb", buffering=0) as writer:
            writer.write(data[:60_000])
            terminal.wait_for("reading port")
            terminal.wait_for("kB")
            writer.write(data[60_000:])
        text = terminal.wait_for_the_end()
        assert child.wait() == 0
    with os.fdopen(out) as reader:
        assert "reading" not in reader.read()
    assert text.rpartition("\x1b[2K")[0]  # the line was wiped
    if args[0] == "decode":
        assert text.endswith(
            "out.csv: 1,040 rows, 66 columns; 9.99 s, no samples lost, no damage\r\n"
        )


def test_progress_knows_the_size(tmp_path: Path) -> None:
    """Names that look like markup are shown unchanged."""
    code = (
        "import sys; from xbus.cli import progress; progress.DELAY = 0\n"
        "with progress.Progress('counting') as bar:\n"
        "    bar.update('counting [red]sheep', 3_000_000, 4_000_000); sys.stdin.readline()"
    )
    ours, theirs = os.pipe()
    with on_terminal([sys.executable, "-c", code], stdin=ours) as (child, terminal):
        os.close(ours)
        terminal.wait_for("counting [red]sheep")
        terminal.wait_for("3.0/4.0 MB")
        os.close(theirs)
        terminal.wait_for_the_end()
        assert child.wait() == 0


def test_reading_shows_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    """Progress counts the bytes of all files; a pipe has no total."""
    reported: list[tuple[str, int, int | None]] = []
    monkeypatch.setattr(Progress, "update", lambda _, *args: reported.append(args))
    size = Path(WALK).stat().st_size + Path(FIELD).stat().st_size
    with Progress("") as progress, Input([WALK, FIELD], progress) as source:
        assert operator.length_hint(source) == size
        while source.read(99_999):
            pass
    assert reported[0] == ("reading walk.mtb", 99_999, size)
    assert reported[-1] == ("reading field.mtb", size, size)
    reported.clear()
    run("info", "-", stdin=Path(WALK).read_bytes())
    assert {item[2] for item in reported} == {None}


@pytest.mark.parametrize(
    "args",
    [["info", WALK], ["decode", WALK, "-o", "out.csv"], ["dump", WALK]],
    ids=lambda item: item[0],
)
def test_no_progress_when_fast_quiet_or_piped(
    args: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bar does not appear before its delay, without a terminal on stderr, or with --quiet."""
    monkeypatch.chdir(tmp_path)
    assert DELAY == 1
    with on_terminal([*PATIENT, *args]) as (child, terminal):
        assert "reading" not in terminal.wait_for_the_end()
        assert child.wait() == 0
    env = {**ENVIRONMENT, "FORCE_COLOR": "1"}  # what some CI services set; no terminal all the same
    done = subprocess.run([*IMPATIENT, *args], env=env, capture_output=True, check=True)  # noqa: S603
    assert b"reading" not in done.stderr
    assert b"\x1b" not in done.stderr + done.stdout
    if args[0] == "decode":
        with on_terminal([*IMPATIENT, *args, "--quiet"]) as (child, terminal):
            assert (terminal.wait_for_the_end(), child.wait()) == ("", 0)


def test_ctrl_c_removes_the_progress_bar(tmp_path: Path) -> None:
    port = tmp_path / ("port" * 30)  # a long name does not break the line
    os.mkfifo(port)
    with on_terminal([*IMPATIENT, "info", str(port)]) as (child, terminal):
        with port.open("wb", buffering=0) as writer:
            writer.write(b"\xfa\xff")
            terminal.wait_for("reading")
            child.send_signal(2)
            text = terminal.wait_for_the_end()
        assert child.wait() == 130
    assert "Traceback" not in text
    assert "Aborted" not in text
    assert text.endswith("\x1b[?25h\r\x1b[1A\x1b[2K")  # the cursor is back, and the bar is gone


# Pages and tables


def test_headings_are_bold_on_a_terminal_only() -> None:
    on_a_terminal, piped = printed("info", FIELD), run("info", FIELD).stdout
    assert on_a_terminal.startswith(f"\x1b[1m{FIELD}\x1b[0m\n")
    assert "\x1b[1mdamage\x1b[0m\n" in on_a_terminal
    assert plain(on_a_terminal) == piped


@pytest.mark.parametrize("columns", [80, 140, 200])
def test_tables_fit_the_terminal(columns: int) -> None:
    """No name is cut; a narrow terminal shows how many columns are missing."""
    for command, names, spare in (
        ("quantities", list(QUANTITIES), "manual, products, source"),
        ("messages", [message.name for message in MESSAGES.values()], "states, products, status"),
    ):
        text = plain(printed(command, columns=columns))
        assert max(map(len, text.splitlines())) <= columns
        assert set(names) <= set(text.split())
        head = text.partition("\u2500")[0].split()
        reported = f"A wider terminal or a pipe also shows {spare}."
        assert (reported in text) == (spare.split(", ")[0] not in head) == (columns == 80)


def test_quantities() -> None:
    head, *rows = run("quantities").stdout.splitlines()
    assert head.split() == [
        *["id", "name", "manual", "layout", "unit", "axes", "coordinates", "products", "source"]
    ]
    assert [row.split()[:3] for row in rows] == [
        [f"0x{quantity.id:04X}", quantity.name, quantity.manual] for quantity in QUANTITIES.values()
    ]
    (row,) = run("quantities", "0x5040").stdout.splitlines()[1:]
    assert re.split(r"  +", row) == [
        *["0x5040", "lat_lon", "LatLon", "2 real", "deg", "earth", "7 710 670 680", "5.3.6"]
    ]
    at = head.index
    for quantity, row in zip(QUANTITIES.values(), rows, strict=True):
        cell = row[at("coordinates") : at("products")].strip()
        assert cell == ("ENU NED NWU" if quantity.coordinates else "")
        assert row[at("unit") : at("axes")].strip() == quantity.unit
        assert row[at("axes") : at("coordinates")].strip() == (quantity.axes or "")


def test_fields_of_structs_have_units() -> None:
    rows, _, fields = run("quantities", "hacc").stdout.partition("\n\n")
    assert [line.split()[1] for line in rows.splitlines()[1:]] == ["gnss_pvt_data"]
    lines = {line.split()[1]: re.split(r"  +", line)[2:] for line in fields.splitlines()}
    assert lines["field"] == ["type", "unit", "raw count", "not provided"]
    assert lines["lat"] == ["i4", "deg", "1e-7 deg"]
    assert lines["hAcc"] == ["u4", "m", "0.001 m", "0XFFFFFFFF"]
    assert lines["pdop"][0] == "u2"
    assert "raw count" not in run("quantities", "temperature").stdout


def test_layouts() -> None:
    rows = run("quantities").stdout.splitlines()
    at = rows[0].index("layout"), rows[0].index("unit")
    layouts = {row.split()[1]: row[slice(*at)].strip() for row in rows}
    expected = {
        "temperature": "real",
        "rotation_matrix": "9 real",
        "packet_counter": "u2",
        "raw_gyro_temp": "3 i2",
        "gnss_pvt_data": "35 fields, 94 bytes",
        "gnss_sat_info": "8 bytes and 4 each",
        "device_id": "u4 or u8",
    }
    assert {item: layouts[item] for item in expected} == expected


def test_messages() -> None:
    head, *rows = run("messages").stdout.splitlines()
    assert head.split() == [
        *["mid", "name", "direction", "states", "reply", "length", "payload", "products", "status"]
    ]
    assert [row.split()[:2] for row in rows] == [
        [f"0x{message.mid:02X}", message.name] for message in MESSAGES.values()
    ]
    lengths = {
        message.name: row[head.index("length") : head.index("payload")].strip()
        for message, row in zip(MESSAGES.values(), rows, strict=True)
    }
    assert lengths["DeviceID"] == "4, 8"
    assert lengths["MTData2"] == "any"
    assert lengths["ProductCode"] == "4 to 20"
    assert lengths["SetSyncSettings"] == "12 to 120 by 12"
    assert lengths["GoToConfig"] == "0"


def test_products_by_series() -> None:
    def products(name: str) -> str:
        (row,) = [line for line in run("quantities").stdout.splitlines() if line.split()[1] == name]
        return re.split(r"  +", row)[-2]

    assert products("acceleration") == "all"
    assert products("baro_pressure") == "7 100-series 600-series"
    assert products("raw_gyro_temp") == "10-series 100-series"
    assert products("gnss_pvt_pulse") == "670 680"
    assert len(PRODUCTS) > 10


@pytest.mark.parametrize("text", ["GNSS", "gnss", "Gnss"])
def test_text_filters_ignore_case(text: str) -> None:
    rows, _, fields = run("quantities", text).stdout.partition("\n\n")
    names = [line.split()[1] for line in rows.splitlines()[1:]]
    assert "gnss_pvt_data" in fields
    assert names[:2] == ["gnss_age", "gnss_pvt_data"]
    assert all("gnss" in name for name in names)
    names = [load["name"] for load in json.loads(run("quantities", text, "--json").stdout)]
    assert "gnss_sat_info" in names
    assert "acceleration" not in names


@pytest.mark.parametrize("command", ["quantities", "messages"])
def test_text_without_a_match_is_an_error(command: str) -> None:
    assert "'accccc'" in sentence(run(command, "accccc"))


def test_tables_as_json() -> None:
    output = run("quantities", "--json").stdout
    assert len(output.splitlines()) == len(QUANTITIES)
    found = json.loads(output)
    for shown, row in zip(found, QUANTITIES.values(), strict=True):
        assert list(shown) == list(row._fields)
        assert tuple(shown["products"]) == row.products
        assert [tuple(f.values()) for f in shown["fields"]] == [tuple(f) for f in row.fields]
        assert [tuple(f.values()) for f in shown["entry"]] == [tuple(f) for f in row.entry]
    found = json.loads(run("messages", "--json").stdout)
    for shown, message in zip(found, MESSAGES.values(), strict=True):
        assert list(shown) == list(message._fields)
        assert shown["lengths"] == (None if message.lengths is None else list(message.lengths))
