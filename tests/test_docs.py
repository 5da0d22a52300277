"""The examples in the documentation and in docstrings run and give the output shown.

pytest runs the ``>>>`` blocks of the pages (``--doctest-glob``). These tests run the docstrings and the
commands in the pages, and check that every example runs.
"""

from __future__ import annotations

import contextlib
import difflib
import doctest
import importlib
import inspect
import os
import pkgutil
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import click
import pytest
from click.testing import CliRunner

import doc_examples
import xbus
from doc_examples import BLOCK, blocks, commands
from xbus.cli import main

ROOT = Path(__file__).resolve().parents[1]
CAPTURES = "tests/captures"
#: Its `python` blocks are tests, which test_pytest_plugin runs.
PAGE_OF_TESTS = ROOT / "docs" / "howto" / "ci.md"
#: Its `python` blocks are run by test_dask.
PAGE_OF_CLUSTERS = ROOT / "docs" / "howto" / "cluster.md"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
#: Of the terminal on which commands run.
PLAIN = {"COLUMNS": "100", "NO_COLOR": "1"}
MODULES = ["xbus", *(module.name for module in pkgutil.walk_packages(xbus.__path__, "xbus."))]


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def have(page: Path, language: str) -> bool:
    return bool(blocks(page, language))


@pytest.mark.parametrize("module", MODULES)
def test_docstrings(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if module == "xbus.__main__":
        pytest.skip("importing it runs the command")
    if module == "xbus.report":
        pytest.importorskip("plotly")
    monkeypatch.chdir(ROOT)
    found = doctest.testmod(importlib.import_module(module))
    assert found.failed == 0


def test_every_public_name_has_an_example() -> None:
    names = [name for name in xbus.__all__ if name not in ("__version__", "report")]
    values = {name: getattr(xbus, name) for name in names}
    documented = {
        name: value for name, value in values.items() if not isinstance(value, ModuleType)
    }
    assert len(documented) > 40
    assert [
        name for name, value in documented.items() if ">>> " not in (inspect.getdoc(value) or "")
    ] == []


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_python_block_is_run(page: Path) -> None:
    is_run = page in (PAGE_OF_TESTS, PAGE_OF_CLUSTERS)
    for block in [*blocks(page, "py"), *([] if is_run else blocks(page, "python"))]:
        raise AssertionError(f"no test runs this block; write it as pycon, with >>>:\n{block}")
    for block in blocks(page, "pycon"):
        assert block.startswith(">>> "), block
        assert block.endswith("\n\n"), f"doctest needs an empty line before the fence:\n{block}"


@pytest.mark.skipif(os.name == "nt", reason="the commands are written for a POSIX shell")
@pytest.mark.timeout(600)  # each command has its own limit
@pytest.mark.parametrize("page", [page for page in PAGES if have(page, "console")], ids=name)
def test_commands(page: Path, tmp_path: Path) -> None:
    """The ``console`` blocks of a page run in order in one folder and print what the page shows.

    A line that begins with ``$ `` is a command, continued after a backslash; its output on stdout and stderr
    follows. A line ``...`` matches any number of lines.
    """
    shutil.copytree(ROOT / CAPTURES, tmp_path / CAPTURES)
    for block in blocks(page, "console"):
        shown = block.splitlines()
        assert shown[0].startswith("$ "), f"no command to run:\n{block}"
        found = replay(block, tmp_path)
        assert agrees(shown, found), difference(shown, found)


def replay(block: str, folder: Path) -> list[str]:
    """The commands of a block, each followed by its present output."""
    lines = []
    for command in commands(block):
        lines += f"$ {command}".splitlines()
        lines += [text.rstrip() for text in run(command, folder).splitlines()]
    return lines


def run(command: str, folder: Path) -> str:
    """Returns the output of a command. One that needs no shell runs in this process, which is faster."""
    if (words := simple(command)) and words[0] == "xbus":
        with contextlib.chdir(folder):
            runner = CliRunner(env=PLAIN)
            return runner.invoke(main, words[1:], prog_name="xbus", catch_exceptions=False).output
    programs = Path(sys.executable).parent
    path = f"{programs}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(  # noqa: S602 - commands of this repository
        command,
        shell=True,
        cwd=folder,
        env=os.environ | PLAIN | {"PATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=60,
        check=False,
    )
    return done.stdout


def simple(command: str) -> list[str]:
    """Returns the words of a command; none if a shell has to do more than to start a program."""
    lexer = shlex.shlex(command.replace("\\\n", " "), posix=True, punctuation_chars="();<>|&$*`")
    lexer.whitespace_split = True
    words = list(lexer)
    return [] if any(set(word) <= set(lexer.punctuation_chars) for word in words) else words


def agrees(shown: list[str], found: list[str]) -> bool:
    pattern = "".join(r"(?:.*\n)*?" if line == "..." else re.escape(line) + r"\n" for line in shown)
    return re.fullmatch(pattern, "".join(f"{line}\n" for line in found)) is not None


def difference(shown: list[str], found: list[str]) -> str:
    lines = difflib.unified_diff(shown, found, "the page", "the command", lineterm="")
    return "\n".join(["the output of the command differs from the page:", *lines])


def test_commands_go_on_after_a_backslash() -> None:
    assert doctest.testmod(doc_examples).failed == 0
    block = "$ echo a \\\n    b\na b\n"
    assert replay(block, ROOT) == block.splitlines()


def test_simple_commands() -> None:
    assert simple("xbus dump \\\n  'sim:MTi-3?a=1&b=2'") == ["xbus", "dump", "sim:MTi-3?a=1&b=2"]
    for more in ("| head -1", "> file", "&& true", "$HOME", "*.mtb", "`pwd`", "; ls"):
        assert simple(f"xbus dump {more}") == []


def test_agrees() -> None:
    assert agrees(["$ xbus", "a", "...", "d"], ["$ xbus", "a", "b", "c", "d"])
    assert agrees(["$ xbus", "..."], ["$ xbus"])
    assert not agrees(["$ xbus", "a", "..."], ["$ xbus", "b"])
    assert not agrees(["$ xbus", "a"], ["$ xbus", "a", "b"])


def anchors(page: Path) -> set[str]:
    """The anchors that GitHub gives the headings of a page."""
    text = BLOCK.sub("", page.read_text("utf-8"))
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", sorted(ROOT.glob("*.md")), ids=name)
def test_links_lead_somewhere(page: Path) -> None:
    """In the pages outside the documentation; docs/check_links.py checks those inside."""
    for link in re.findall(r"\]\(([^)]+)", page.read_text("utf-8")):
        target, _, anchor = link.partition("#")
        if not target.startswith("https://"):
            to = ROOT / target if target else page
            assert to.exists(), link
            assert not anchor or anchor in anchors(to), link


def test_contributing_names_files_that_exist() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    paths = re.findall(r"`((?:python|rust|tests|docs|fuzz)/[\w./]+\.\w+)`", text)
    assert len(paths) > 10
    for path in paths:
        assert (ROOT / path).exists(), path


def test_contributing_names_payloads_that_exist() -> None:
    """The section on a new message, against the table that it is about."""
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    section = text.partition("## A new message")[2].partition("\n## ")[0]
    source = "".join(path.read_text("utf-8") for path in (ROOT / "rust/src/table").glob("*.rs"))
    names = re.findall(r"`(\w+)`", section)
    assert {"record", "list", "text", "bytes", "opaque", "unconfirmed"} <= set(names)
    for name in set(names) - {"dump", "send", "_TYPES"}:
        assert re.search(rf"\b(fn|const) {name}\b", source), name


def test_the_design_names_every_package() -> None:
    text = (ROOT / "docs" / "design.md").read_text("utf-8")
    packages = {path.parent.name for path in (ROOT / "python" / "xbus").glob("*/__init__.py")}
    assert packages
    assert {package for package in packages if f"`{package}/`" not in text} == set()


def test_the_reference_has_every_command() -> None:
    text = (ROOT / "docs" / "reference" / "command.md").read_text("utf-8")
    context = click.Context(main)
    found = re.findall(r"^## xbus (\w+)$", text, re.MULTILINE)
    assert sorted(found) == sorted(main.list_commands(context))
