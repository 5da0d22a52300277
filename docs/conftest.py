"""Runs the examples of each page in a temporary folder that contains the recordings."""

import shutil
from pathlib import Path

import pytest

CAPTURES = "tests/captures"
ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(autouse=True)
def _scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(ROOT / CAPTURES, tmp_path / CAPTURES)
    monkeypatch.chdir(tmp_path)
