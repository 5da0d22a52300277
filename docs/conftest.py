"""Runs the examples of each page in a temporary folder that contains the recordings."""

import shlex
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from doc_examples import page_commands
from xbus.cli import main

CAPTURES = "tests/captures"
ROOT = Path(__file__).resolve().parents[1]
#: What commands of a page write and its Python examples read.
WRITTEN = {
    "large.md": ("night/",),
    "tutorial.md": ("first.mtb",),
    "robotics.md": ("run.mtb", "run_bag"),
    "marine.md": ("trip.mtb",),
    "automotive.md": ("drive.mtb",),
    "biomechanics.md": ("subject01.mtb", "thigh.mtb", "shank.mtb"),
}


@pytest.fixture(autouse=True)
def _scratch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    shutil.copytree(ROOT / CAPTURES, tmp_path / CAPTURES)
    monkeypatch.chdir(tmp_path)
    page = request.node.path
    for file in WRITTEN.get(page.name, ()):
        # The last one: a page may show a command that fails first.
        command = [line for line in page_commands(page) if f"-o {file} " in line][-1]
        _, *arguments = shlex.split(command.replace("\\\n", " "))
        done = CliRunner().invoke(main, arguments, catch_exceptions=False)
        assert done.exit_code == 0, done.output
