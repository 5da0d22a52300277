"""Runs the examples of each page in a temporary folder that contains the recordings."""

import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from xbus.cli import main

CAPTURES = "tests/captures"
ROOT = Path(__file__).resolve().parents[1]
#: Commands of pages whose Python examples read what they write.
WRITERS = {"large.md": f"decode {CAPTURES}/walk.mtb -o night/ --partition-by hour"}


@pytest.fixture(autouse=True)
def _scratch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    shutil.copytree(ROOT / CAPTURES, tmp_path / CAPTURES)
    monkeypatch.chdir(tmp_path)
    if command := WRITERS.get(request.node.path.name):
        CliRunner().invoke(main, command.split(), catch_exceptions=False)
