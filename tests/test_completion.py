"""``xbus completion``, in the shells that are installed."""

# ruff: noqa: S603 - the shells that are started here run our own scripts

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from test_cli import run

#: Shell, and a line that completes "xbus doctor --js" with the script in $SCRIPT.
SHELLS = {
    "bash": 'source "$SCRIPT"; COMP_WORDS=(xbus doctor --js); COMP_CWORD=2; _xbus_completion xbus;'
    ' echo "${COMPREPLY[@]}"',
    "fish": 'source "$SCRIPT"; complete -C "xbus doctor --js"',
    # Outside of the line editor, zsh has no completion system: print what the script hands to it.
    "zsh": "compdef() { :; }; compadd() { :; }; _describe() { print -r -- ${(P)3}; };"
    ' source "$SCRIPT"; words=(xbus doctor --js); CURRENT=3; _xbus_completion',
}


@pytest.mark.parametrize("shell", SHELLS)
def test_completion(shell: str, tmp_path: Path) -> None:
    program = shutil.which(shell)
    if program is None or os.name == "nt":
        pytest.skip(f"{shell} is not installed")
    script = tmp_path / "script"
    script.write_text(run("completion", shell).stdout)
    command = tmp_path / "xbus"
    command.write_text(f"#!{sys.executable}\nfrom xbus.cli import main\nmain(prog_name='xbus')\n")
    command.chmod(0o755)
    environment = {
        **os.environ,
        "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}",
        "SCRIPT": str(script),
        "HOME": str(tmp_path),
    }
    line = [program, "-c", SHELLS[shell]]
    done = subprocess.run(line, capture_output=True, text=True, check=True, env=environment)
    assert done.stderr == ""
    assert "--json" in done.stdout
    assert "--udev-rules" not in done.stdout


def test_an_unknown_shell() -> None:
    result = run("completion", "tcsh")
    assert result.exit_code == 2
    assert "'bash', 'fish', 'zsh'" in result.stderr
