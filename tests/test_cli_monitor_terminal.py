"""``xbus monitor`` on a terminal: the screen of a terminal emulator."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial

from test_cli import ENVIRONMENT, FIELD, PROGRAM, WALK
from test_cli_record import in_a_thread
from test_cli_sim import GO_TO_CONFIG, GO_TO_CONFIG_ACK, REQ_DID, answer, simulated
from xbus import SimulatedDevice, read_log
from xbus.sim import PtyServer

pyte = pytest.importorskip("pyte")

#: The last escape sequences: the cursor is visible, and the main screen is back.
LEFT = b"\x1b[?25h\x1b[?1049l"


class Seen:
    """A terminal with a user."""

    def __init__(
        self, master: int, child: subprocess.Popen[bytes], columns: int, lines: int
    ) -> None:
        self._master = master
        self._child = child
        self.screen = pyte.Screen(columns, lines)
        self._stream = pyte.ByteStream(self.screen)
        self.bytes = b""

    def more(self) -> bool:
        """Waits for something to be drawn; False once the program has ended and all of it is read."""
        has_ended = False
        while not select.select([self._master], [], [], 0 if has_ended else 0.05)[0]:
            if has_ended:
                return False
            has_ended = self._child.poll() is not None
        try:
            data = os.read(self._master, 65536)
        except OSError:  # Linux reports a closed terminal in this way
            return False
        self.bytes += data
        self._stream.feed(data)
        return bool(data)

    @property
    def text(self) -> str:
        return "\n".join(item.rstrip() for item in self.screen.display)

    def wait_for(self, *words: str) -> str:
        return self.wait_until(lambda text: all(word in text for word in words), words)

    def wait_until(self, holds: Callable[[str], bool], what: object = "") -> str:
        while not holds(self.text):
            assert self.more(), f"it ended before {what}:\n{self.text}"
        return self.text

    def wait_for_whole(self, *words: str) -> str:
        """Waits for the words and then for a complete screen: the bytes of one can arrive in parts."""
        self.wait_for(*words)
        starts = self.bytes.count(b"\x1b[H") + 2
        return self.wait_until(lambda _: self.bytes.count(b"\x1b[H") >= starts, "two more screens")

    def wait_for_the_end(self) -> None:
        while self.more():
            pass

    def wait_for_exit(self, child: subprocess.Popen[bytes]) -> int:
        """Returns the exit status. Reads meanwhile: a program waits while its terminal is full."""
        until = time.monotonic() + 30
        while child.poll() is None:
            assert time.monotonic() < until, f"it has not ended:\n{self.text}"
            if select.select([self._master], [], [], 0.05)[0]:
                self.more()
        return child.wait()

    def frame_sizes(self) -> list[tuple[int, int]]:
        """Columns and lines of the complete screens among the bytes."""
        frames = re.sub(rb"\x1b\[(?!H)[\d;?]*[A-Za-z]", b"", self.bytes).split(b"\x1b[H")[1:-1]
        drawn = [frame.decode().split("\r\n") for frame in frames]
        return [(max(map(len, lines)), len(lines)) for lines in drawn]

    def press(self, keys: str) -> None:
        os.write(self._master, keys.encode())

    def resize(self, columns: int, lines: int) -> None:
        self.screen.resize(lines, columns)
        resize(self._master, columns, lines)


def resize(terminal: int, columns: int, lines: int) -> None:
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("4H", lines, columns, 0, 0))


@contextlib.contextmanager
def monitoring(
    *args: str,
    size: tuple[int, int] = (80, 24),
    program: list[str] | None = None,
    code: int = 0,
    env: dict[str, str] | None = None,
    command: str = "monitor",
) -> Iterator[tuple[Seen, subprocess.Popen[bytes]]]:
    """Yields the command on a terminal; the command must restore the terminal."""
    master, slave = pty.openpty()
    resize(slave, *size)
    before = termios.tcgetattr(slave)
    plain = {
        key: value
        for key, value in ENVIRONMENT.items()
        if key not in ("NO_COLOR", "COLUMNS", "LINES")
    }
    plain |= {"TERM": "xterm", **(env or {})}
    line = [*(program or PROGRAM), command, *args]
    with subprocess.Popen(line, env=plain, stdin=slave, stdout=slave, stderr=slave) as child:  # noqa: S603
        seen = Seen(master, child, *size)
        try:
            yield seen, child
            # The slave end is still open, so that its attributes can be read.
            assert seen.wait_for_exit(child) == code
            assert termios.tcgetattr(slave) == before
            os.close(slave)
            seen.wait_for_the_end()
            assert LEFT in seen.bytes
            assert "\x1b[?1049h" not in seen.bytes.rpartition(LEFT)[2].decode()
        finally:
            child.kill()
            os.close(master)


def test_a_device() -> None:
    with simulated() as (port, _), monitoring(port) as (seen, _):
        text = seen.wait_for(
            "packet_counter", "heading", "no samples lost", "Measurement State", "fix"
        )
        assert port in text
        assert "▄" in text
        # The rates are right as soon as there are any.
        text = seen.wait_until(lambda item: "100.0" in item, "the rates")
        assert "quaternion" in text
        seen.press("q")


def test_ctrl_c() -> None:
    """The terminal sends SIGINT to the program that controls it."""
    owner = (
        "import fcntl, os, sys, termios; os.setsid(); fcntl.ioctl(0, termios.TIOCSCTTY, 0);"
        "os.execv(sys.executable, [sys.executable, '-m', 'xbus', *sys.argv[1:]])"
    )
    with monitoring("sim:MTi-3", program=[sys.executable, "-c", owner]) as (seen, _):
        seen.wait_for("packet_counter")
        seen.press("\x03")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signals(number: int) -> None:
    with monitoring("sim:MTi-3") as (seen, child):
        seen.wait_for("packet_counter")
        child.send_signal(number)


def test_a_terminal_that_is_closed() -> None:
    with monitoring("sim:MTi-3", code=129) as (seen, child):
        seen.wait_for("packet_counter")
        child.send_signal(signal.SIGHUP)


def test_errors_restore_the_terminal() -> None:
    patched = (
        "import sys, xbus.cli.monitor.screen as screen; from xbus.cli import main\n"
        "title = screen._title\n"
        "def worn_out(model, *args):\n"
        "    if model.elapsed > 1: raise ZeroDivisionError('worn out')\n"
        "    return title(model, *args)\n"
        "screen._title = worn_out; main(sys.argv[1:])"
    )
    with monitoring("sim:MTi-3", program=[sys.executable, "-c", patched], code=1) as (seen, _):
        seen.wait_for("packet_counter")
    # The traceback follows the restored screen.
    assert b"ZeroDivisionError: worn out" in seen.bytes.rpartition(LEFT)[2]


def test_pause_and_filter_and_help() -> None:
    with simulated() as (port, _), monitoring(port) as (seen, _):
        seen.wait_for("packet_counter", "velocity_xyz")
        seen.press("/vEl")
        seen.wait_for("filter: vEl_")
        seen.wait_until(lambda item: "packet_counter" not in item, "the filter")
        seen.press("x\x7f\r")
        seen.wait_for("filter 'vEl', Esc shows all", "velocity_xyz")
        seen.press("\x1b")
        seen.wait_for("packet_counter")
        seen.press("?")
        seen.wait_for("start or stop recording")
        seen.press("q")  # any key
        seen.wait_for("velocity_xyz")
        seen.press("p")
        still = seen.wait_for_whole("PAUSED")
        # A key redraws the screen, which stays the same until the pause ends.
        seen.press("?")
        seen.wait_for("this page")
        seen.press("x")
        assert seen.wait_for_whole("velocity_xyz") == still
        seen.press(" ")
        seen.wait_until(lambda item: "PAUSED" not in item and item != still, "the pause ended")
        seen.press("q")


def test_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with simulated() as (port, _), monitoring(port) as (seen, _):
        seen.wait_for("packet_counter")
        seen.press("r")
        seen.wait_for("REC ", "recording to xbus-", "MTi-680G-8A1G6")
        seen.wait_until(lambda item: " kB  Measurement" in item, "some bytes")
        seen.press("r")
        seen.wait_for("recorded ")
        seen.press("r")
        seen.wait_for("REC ")
        seen.press("q")
    (first, second) = sorted(tmp_path.glob("xbus-*.mtb"))
    for item in (first, second):
        log = read_log(item)
        assert log.product_code == "MTi-680G-8A1G6"
        assert log.stats.skipped_bytes == 0
    assert len(read_log(first)) > 10
    # The recording ended, and its summary follows the screen.
    reported = seen.bytes.rpartition(LEFT)[2].decode()
    assert f"{first.name}\r\n" in reported
    assert f"{second.name}\r\n" in reported


def test_config_state() -> None:
    """The screen shows Config State, a key starts the measurement, and the end restores Config State."""
    with simulated() as (path, _):
        with serial.Serial(path, timeout=10) as port:
            answer(port, GO_TO_CONFIG, GO_TO_CONFIG_ACK[:3])
        with monitoring(path) as (seen, _):
            seen.wait_for("Config State", "m starts measurement")
            seen.press("m")
            seen.wait_for("Measurement State", "packet_counter")
            seen.press("q")
        with serial.Serial(path, timeout=10) as port:
            # The device answers this in Config State only, and nothing precedes the answer.
            port.write(REQ_DID)
            assert port.read(3) == b"\xfa\xff\x01"


def test_a_pulled_plug(tmp_path: Path) -> None:
    """The monitor waits for the port; the rates stop, and continue."""
    sim, port = SimulatedDevice("MTi-680G"), str(tmp_path / "mti")
    with (
        PtyServer(sim, link=port) as server,
        in_a_thread(server),
        monitoring(port) as (seen, _),
    ):
        seen.wait_for("packet_counter")
        sim.unplug()
        seen.wait_for("port lost, waiting for it", "the port is gone")
        sim.plug()
        seen.wait_for("the port is back")
        seen.wait_until(
            lambda item: "Measurement State" in item and "stopped" not in item, "samples"
        )
        seen.press("q")


def test_any_size_of_terminal() -> None:
    with monitoring("sim:MTi-680G", size=(120, 40)) as (seen, _):
        seen.wait_for("packet_counter", "heading")
        for columns, lines in ((40, 10), (3, 2), (1, 1), (80, 24)):
            seen.resize(columns, lines)
            seen.bytes = b""
            while (columns, lines) not in seen.frame_sizes():
                assert seen.more()
        seen.wait_for("packet_counter", "heading")
        seen.press("q")


def test_no_colour_and_no_characters_but_ascii() -> None:
    env = {"NO_COLOR": "1", "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    with monitoring("sim:MTi-680G", env=env) as (seen, _):
        seen.wait_for("packet_counter", "#####")
        seen.press("q")
    assert seen.bytes.isascii()
    assert not re.search(rb"\x1b\[(\d+;)*[34]\d[;m]", seen.bytes)


def test_colours() -> None:
    with monitoring("sim:MTi-680G") as (seen, _):
        seen.wait_for("no samples lost", "heading")
        at = seen.text.splitlines().index(
            next(line for line in seen.text.splitlines() if "no samples lost" in line)
        )
        column = seen.screen.display[at].index("no samples lost")
        assert seen.screen.buffer[at][column].fg == "green"
        assert {seen.screen.buffer[1][index].bg for index in range(20)} == {"blue"}
        seen.press("q")


def test_a_recording_is_replayed_to_its_end() -> None:
    with monitoring(FIELD, "--speed", "20") as (seen, _):
        text = seen.wait_for_whole("end of the recording")
        assert "r record" not in text
        assert "23 samples lost in 12 gaps" in text
        assert "Error 41" in text
        seen.press("r")  # there is nothing to record
        seen.press("?")
        seen.wait_for("Events, the latest first")
        seen.press("x")
        seen.wait_for("gnss_pvt_data")
        seen.press("q")


def test_arrow_keys_scroll_the_quantities() -> None:
    with monitoring(FIELD, "--speed", "20", size=(80, 18)) as (seen, _):
        seen.wait_for("end of the recording", "6 below: arrow keys")
        seen.press("\x1b[B")
        seen.wait_for("1 above and 5 below: arrow keys")
        seen.press("\x1b[6~")
        seen.wait_for("6 above: arrow keys", "gnss_pvt_data")
        seen.press("\x1b[5~")
        seen.wait_for("6 below: arrow keys", "packet_counter")
        seen.press("\x1b[A")
        seen.press("q")


def test_a_recording_stands_still_while_it_is_paused() -> None:
    with monitoring(WALK) as (seen, _):
        seen.wait_for("packet_counter")
        seen.press(" ")
        still = seen.wait_for_whole("PAUSED")
        for key in "?x":
            seen.press(key)
            text = seen.wait_for_whole("this page" if key == "?" else "packet_counter")
        assert text == still
        seen.press("p")
        seen.wait_until(lambda item: "PAUSED" not in item and item != still, "the pause ended")
        seen.press("q")


@pytest.mark.parametrize(("piped", "kind"), [(True, "xterm"), (False, "dumb")])
def test_a_pipe_is_not_a_terminal(piped: bool, kind: str) -> None:
    """A dumb terminal has no screen either."""
    master, slave = pty.openpty()
    line = [*PROGRAM, "monitor", "sim:MTi-3"]
    env = {**ENVIRONMENT, "TERM": kind}
    out, err = subprocess.PIPE if piped else slave, subprocess.PIPE
    try:
        with subprocess.Popen(line, env=env, stdin=slave, stdout=out, stderr=err) as child:  # noqa: S603
            printed, complaint = child.communicate()
        os.close(slave)
        seen = Seen(master, child, 80, 24)
        seen.wait_for_the_end()
    finally:
        os.close(master)
    assert child.returncode == 2
    assert b"needs a terminal" in complaint
    assert seen.bytes + (printed or b"") == b""
