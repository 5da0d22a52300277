"""The manual page xbus(1)."""

# ruff: noqa: S603 - the programs that are started here format manual pages

from __future__ import annotations

import importlib.util
import shutil
import subprocess
from pathlib import Path
from types import ModuleType

import pytest

import xbus
from xbus.cli import COMMANDS

ROOT = Path(__file__).parents[1]


def make_man() -> ModuleType:
    """Returns the script that writes the page."""
    spec = importlib.util.spec_from_file_location("make_man", ROOT / "docs" / "make_man.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def page() -> Path:
    path: Path = make_man().PAGE
    return path


def test_the_page_is_up_to_date(page: Path) -> None:
    """A difference rewrites the file, so that a reviewer sees the change."""
    text = make_man().page()
    if not page.exists() or page.read_text("utf-8") != text:
        page.parent.mkdir(parents=True, exist_ok=True)
        page.write_text(text, "utf-8")
        raise AssertionError(f"{page} was not up to date; it has been written anew")


def test_the_page_has_every_command_and_the_version(page: Path) -> None:
    text = page.read_text("utf-8")
    assert [name for name in COMMANDS if f"\n.SS xbus {name} " not in text] == []
    assert f'"xbus {xbus.__version__}"' in text
    assert "\n.SS xbus config apply " in text


@pytest.mark.parametrize(
    "program",
    [
        # The page has no date, since it depends on the commands only.
        ["mandoc", "-T", "lint", "-W", "warning"],
        ["groff", "-man", "-Tutf8", "-ww", "-z"],
    ],
    ids=lambda program: program[0],
)
def test_formatters_accept_the_page(program: list[str], page: Path) -> None:
    if shutil.which(program[0]) is None:
        pytest.skip(f"{program[0]} is not installed")
    done = subprocess.run([*program, page], capture_output=True, text=True, check=False)
    lines = [line for line in (done.stdout + done.stderr).splitlines() if "date" not in line]
    assert lines == []


def test_text_is_printed_as_it_is() -> None:
    escaped = make_man().escaped
    assert escaped(".mtb files, 'a' \\ --x") == "\\&.mtb files, 'a' \\e \\-\\-x"
