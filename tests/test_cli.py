"""The command line as a whole: help, how commands end, what they cost. Each command has its own test file.

`run` calls a command in this process, `start` in a separate one.
"""

# ruff: noqa: S603, S607 - the programs that are started here are our own, and sh
from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

import xbus
from conftest import OWN_CAPTURES
from xbus.cli import COMMANDS, main
from xbus.cli.inputs import Input

HERE = Path(__file__).parent
WALK = str(OWN_CAPTURES / "walk.mtb")
FIELD = str(OWN_CAPTURES / "field.mtb")
PROGRAM = [sys.executable, "-m", "xbus"]
#: Output is buffered, as it is by default.
ENVIRONMENT = {key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"}


def run(*args: str, stdin: bytes | None = None) -> Result:
    """Returns the output and exit code of a command that runs in this process."""
    result = CliRunner().invoke(main, args, input=stdin, prog_name="xbus", env={"COLUMNS": "80"})
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def sentence(result: Result) -> str:
    """Returns the one-line error message of a command that failed."""
    assert result.exit_code == 1
    assert result.stderr.startswith("xbus: ")
    assert result.stderr.count("\n") == 1
    assert result.stderr.endswith("\n")
    return result.stderr[len("xbus: ") : -1]


class Child(subprocess.Popen[bytes]):
    """A command that runs. Leaving a `with` block waits for its end; a test that fails kills it."""

    def __exit__(self, kind: type[BaseException] | None, *more: Any) -> None:
        if kind is not None:
            self.kill()
        super().__exit__(kind, *more)


def start(*args: str, **options: object) -> Child:
    """Starts a command in a separate process, with pipes.

    The pipes have no buffer: `communicate` would not return the lines that `readline` has read ahead.
    """
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "env": ENVIRONMENT}
    return Child([*PROGRAM, *args], bufsize=0, **{**pipes, **options})  # type: ignore[call-overload, no-any-return]


def shell(line: str, *args: str) -> tuple[int, str]:
    """Returns the exit code and stderr of a shell line; ``"$@"`` is the program with these arguments."""
    done = subprocess.run(
        ["sh", "-c", line, "sh", *PROGRAM, *args], capture_output=True, check=False, env=ENVIRONMENT
    )
    return done.returncode, done.stderr.decode()


# Help


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_texts_are_up_to_date(command: str) -> None:
    """The texts are kept as files. A difference rewrites the file, so that a reviewer sees the change."""
    result = run(*command.split(), "--help")
    assert result.exit_code == 0
    assert max(map(len, result.stdout.splitlines())) <= 80
    assert "Example: xbus " in result.stdout
    path = HERE / "cli_help" / f"{command or 'xbus'}.txt"
    if not path.exists() or path.read_text("utf-8") != result.stdout:
        path.parent.mkdir(exist_ok=True)
        path.write_text(result.stdout, "utf-8")
        raise AssertionError(f"{path} was not up to date; it has been written anew")
    assert run(*command.split(), "-h").stdout == result.stdout


def test_there_are_no_other_help_texts() -> None:
    assert {path.stem for path in (HERE / "cli_help").iterdir()} == {"xbus", *COMMANDS}


def test_every_command_summary_is_complete() -> None:
    assert "..." not in run("--help").stdout.partition("Commands:")[2]


def test_version() -> None:
    assert run("--version").stdout == f"xbus {xbus.__version__}\n"


def test_help_waits_for_nothing_heavy() -> None:
    lines = ["--help", "--version", *(f"{command} -h" for command in COMMANDS)]
    code = (
        "import sys\n"
        "from xbus.cli import main\n"
        "for line in sys.argv[1:]:\n"
        "    main(line.split(), standalone_mode=False)\n"
        "    if heavy := {'numpy', 'rich', 'pyarrow', 'serial'} & set(sys.modules):\n"
        "        sys.exit(f'xbus {line}: {heavy}')\n"
    )
    done = subprocess.run([sys.executable, "-c", code, *lines], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.count(b"Usage: ") == 1 + len(COMMANDS)


def test_names_of_the_package_are_loaded_on_first_access() -> None:
    code = (
        "import sys, xbus; assert 'numpy' not in sys.modules;"
        "assert all(getattr(xbus, name) is not None for name in xbus.__all__);"
        "assert dir(xbus) == sorted(xbus.__all__);"
        "assert xbus.protocol.tables.QUANTITIES and xbus.errors.DecodeError is xbus.DecodeError"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        xbus.nonsense  # noqa: B018


# Wrong calls


@pytest.mark.parametrize(
    ("args", "words"),
    [
        ([], "Usage:"),
        (["nonsense"], "No such command"),
        (["info"], "Missing argument 'IN...'"),
        (["info", "--nonsense", WALK], "No such option"),
        (["decode", WALK], "the output is missing; add -o OUT, or --out-dir DIR"),
        (["decode", WALK, "-o", "walk.docx"], "'walk.docx' must end in one of .parquet, .csv"),
        (["decode", WALK, "-o", "walk"], "'walk' must end in one of .parquet, .csv"),
        (["decode", WALK, "-o", "x.csv", "--quantity", "accel"], "did you mean acceleration?"),
        (["decode", WALK, "-o", "x.csv", "--quantity", "x" * 9], "xbus quantities lists them"),
        (["decode", WALK, "-o", "x.csv", "--quantity", "quaternion:ABC"], "ENU, NED, NWU"),
        (["decode", WALK, "-o", "x.csv", "--quantity", "acceleration:NED"], "has no coordinates"),
        (["report", WALK], "the output is missing; add -o OUT, or --out-dir DIR"),
        (["report", WALK, "-o", "walk.pdf"], "'walk.pdf' must end in .html"),
        (["dump", WALK, "--mid", "Warnin"], "did you mean Warning?"),
        (["dump", WALK, "--mid", "0x100"], "is not a message identifier; use 0 to 255"),
        (["dump", WALK, FIELD], "these are different recordings"),
    ],
)
def test_wrong_call(args: list[str], words: str) -> None:
    result = run(*args)
    assert result.exit_code == 2
    assert words in " ".join(result.output.split())
    assert not Path("x.csv").exists()


# Inputs that cannot be read

COMMANDS_ON_FILES = {
    "info": ["info"],
    "dump": ["dump"],
    "decode": ["decode", "-o", "never.csv"],
    "report": ["report", "-o", "never.html"],
}


@pytest.fixture(params=COMMANDS_ON_FILES)
def reading(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> list[str]:
    """Returns a command that reads a file; it runs in an empty folder and must leave nothing there."""
    if request.param == "report":
        pytest.importorskip("plotly")
    monkeypatch.chdir(tmp_path)
    return COMMANDS_ON_FILES[request.param]


def test_no_such_file(reading: list[str]) -> None:
    shown = sentence(run(*reading, "nowhere.mtb"))
    assert shown == "cannot read nowhere.mtb: No such file or directory; check the path"
    assert list(Path().iterdir()) == []


def test_an_empty_folder_is_not_a_log(reading: list[str]) -> None:
    Path("logs.mtb").mkdir()
    shown = sentence(run(*reading, "logs.mtb"))
    assert shown.startswith("no .mtb file in the folder logs.mtb; name the files, such as ")


def test_a_file_is_not_a_folder_of_the_path(reading: list[str]) -> None:
    Path("log").touch()
    assert "cannot read log/walk.mtb: Not a directory" in sentence(run(*reading, "log/walk.mtb"))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_no_permission(reading: list[str]) -> None:
    Path("secret.mtb").touch(0)
    assert "cannot read secret.mtb: Permission denied" in sentence(run(*reading, "secret.mtb"))


@pytest.mark.parametrize("content", [b"", b"time,acc_x\n0.01,0.2\n" * 50, b"\xfa" * 1000])
def test_an_input_without_a_frame_is_an_error(reading: list[str], content: bytes) -> None:
    Path("walk.txt").write_bytes(content)
    shown = sentence(run(*reading, "walk.txt"))
    assert shown.startswith("no Xbus frame in walk.txt: ")
    assert (
        "the input is empty" in shown if not content else f"none in {len(content):,} bytes" in shown
    )
    assert [path.name for path in Path().iterdir()] == ["walk.txt"]


def test_a_read_error_names_the_file(reading: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """/proc/self/mem can be opened but not read."""
    mem = Path("/proc/self/mem")
    if not mem.exists():
        pytest.skip("no /proc")
    Path("disk.mtb").symlink_to(mem)
    shown = sentence(run(*reading, "disk.mtb"))
    assert shown == "cannot read disk.mtb: Input/output error; try again, or check the disk"
    assert [path.name for path in Path().iterdir()] == ["disk.mtb"]


def test_undecodable_file_names_work(tmp_path: Path) -> None:
    odd = os.fsdecode(os.fsencode(tmp_path) + b"/\xff\xc3\xa4.mtb")
    Path(odd).write_bytes(Path(WALK).read_bytes())
    plain = {**ENVIRONMENT, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    for args in (["info"], ["info", "--json"], ["decode", "--json", "-o", f"{odd}.csv"]):
        with start(*args, odd, env=plain) as child:
            out, shown = child.communicate()
        assert child.returncode == 0, shown
        assert out
    with start("info", f"{odd}!", env=plain) as child:
        _, shown = child.communicate()
    assert child.returncode == 1
    assert shown.startswith(b"xbus: cannot read ")
    assert shown.count(b"\n") == 1


# Outputs that cannot be written

OUTPUTS = [
    ["info", FIELD],
    ["dump", FIELD],
    ["quantities"],
    ["quantities", "gnss"],
    ["messages", "--json"],
    ["monitor", WALK, "--once", "1"],
    ["--help"],
    ["info", "-h"],
]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.parametrize("args", OUTPUTS, ids=" ".join)
def test_full_disk(args: list[str]) -> None:
    code, shown = shell('exec "$@" > /dev/full', *args)
    assert code == 1
    assert shown == (
        "xbus: cannot write to standard output: No space left on device; "
        "free some space, or write to another disk\n"
    )


@pytest.mark.parametrize("args", OUTPUTS[:6], ids=" ".join)
def test_closed_output(args: list[str]) -> None:
    code, shown = shell('exec "$@" >&-', *args)
    assert code == 1
    assert shown.startswith("xbus: cannot write to standard output: Bad file descriptor; ")
    assert shown.count("\n") == 1


def test_closed_input() -> None:
    code, shown = shell('exec "$@" <&-', "info", "-")
    assert (code, shown) == (1, "xbus: standard input is closed; name a file\n")


@pytest.mark.parametrize("args", OUTPUTS, ids=" ".join)
def test_broken_pipe(args: list[str]) -> None:
    """The reader closes the pipe before the first byte."""
    ours, theirs = os.pipe()
    os.close(ours)
    with start(*args, stdout=theirs) as child:
        os.close(theirs)
        _, shown = child.communicate()
    assert (child.returncode, shown) == (0, b"")


def test_head_reads_one_line() -> None:
    with start("dump", FIELD) as child:
        assert child.stdout is not None
        assert child.stderr is not None
        assert b"damage" in child.stdout.readline()
        child.stdout.close()
        assert (child.wait(), child.stderr.read()) == (0, b"")


# Signals


def test_ctrl_c_while_reading(tmp_path: Path) -> None:
    pipe = tmp_path / "port"
    os.mkfifo(pipe)
    for args in (["dump"], ["info"], ["decode", "-o", str(tmp_path / "x.parquet")]):
        with start(*args, str(pipe)) as child, pipe.open("wb", buffering=0) as writer:
            # Opening the pipe for writing succeeds only once the child reads it.
            writer.write(Path(WALK).read_bytes()[:1000])
            child.send_signal(signal.SIGINT)
            out, shown = child.communicate()
        assert (child.returncode, shown) == (130, b"")
        assert out == b"" or args == ["dump"]
        assert [path.name for path in tmp_path.iterdir()] == ["port"]


@pytest.mark.parametrize("command", ["dump", "info"])
def test_ctrl_c_when_a_file_has_just_been_opened(
    command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(_: Input) -> bool:
        raise KeyboardInterrupt

    monkeypatch.setattr(Input, "is_regular", property(interrupted))
    result = run(command, WALK)
    assert (result.exit_code, result.output) == (130, "")


def test_ctrl_c_while_modules_are_imported() -> None:
    interrupted = (
        "import sys\n"
        "class Finder:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'click': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Finder())\n"
        "import runpy; runpy.run_module('xbus', run_name='__main__')"
    )
    done = subprocess.run([sys.executable, "-c", interrupted], capture_output=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, b"", b"")


def test_ctrl_c_between_two_reads_ends_the_program(tmp_path: Path) -> None:
    """The signal reaches another thread, or arrives just before the read; the program ends all the same."""
    patched = (
        "import signal, sys, threading; from xbus.cli import main\n"
        "def other(): sys.stdin.read(1); signal.pthread_kill(threading.get_ident(), signal.SIGINT)\n"
        "threading.Thread(target=other, daemon=True).start(); main(['dump', sys.argv[1]])"
    )
    os.mkfifo(tmp_path / "port")
    command = [sys.executable, "-c", patched, str(tmp_path / "port")]
    with (
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child,
        (tmp_path / "port").open("wb", buffering=0) as writer,
    ):
        assert child.stdout is not None
        writer.write(Path(WALK).read_bytes()[:400])
        assert b"Configuration" in child.stdout.readline()
        child.communicate(b"!")
        assert child.returncode == 130


#: What replaces the writing of OUT: half a file is written, and then nothing more. A pause of the main thread
#: could begin after the signal.
STUCK = {
    "walk.npz": (
        "import numpy\n"
        "def stuck(out, *arrays, **options):\n"
        "    out.write(b'half'); print('now', flush=True)\n"
        "    while True: time.sleep(0.1)\n"
        "numpy.lib.format.write_array = stuck"
    ),
    "walk.parquet": (
        "from xbus.log import part_file\n"
        "def stuck(file, batches, out, pool, ahead):\n"
        "    out.write(b'half'); print('now', flush=True)\n"
        "    while True: yield pool.submit(time.sleep, 0.1).result() or 0\n"
        "part_file.write_batches = stuck"
    ),
}


@pytest.mark.parametrize("name", list(STUCK))
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_a_signal_while_writing_leaves_no_partial_file(
    number: int, code: int, name: str, tmp_path: Path
) -> None:
    patched = f"import sys, time\n{STUCK[name]}\nfrom xbus.cli import main\nmain(sys.argv[1:])"
    out = tmp_path / name
    out.write_bytes(b"what was there")
    command = [sys.executable, "-c", patched, "decode", WALK, "-o", str(out)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, **pipes) as child:  # type: ignore[call-overload]
        assert child.stdout.readline() == b"now\n"
        assert len(list(tmp_path.iterdir())) == 2
        child.send_signal(number)
        _, shown = child.communicate()
    assert (child.returncode, shown) == (code, b"")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"what was there"]


def test_an_ignored_signal_stays_ignored() -> None:
    """nohup ignores SIGHUP in this way."""
    handler = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert run("quantities", "--help").exit_code == 0
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, handler)
    before = signal.getsignal(signal.SIGTERM)
    run("info", WALK)
    assert signal.getsignal(signal.SIGTERM) is before
