"""The directive ``figures``: what the source contains of tests, counted when the page is built."""

from __future__ import annotations

import ast
import doctest
import re
import sys
from pathlib import Path

from docutils import nodes
from protocol import table
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from xbus.protocol.tables import MESSAGES, PRODUCTS, QUANTITIES

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))
from doc_examples import blocks, page_commands  # noqa: E402


def python_tests() -> int:
    trees = (ast.parse(path.read_text("utf-8")) for path in (ROOT / "tests").rglob("test_*.py"))
    functions = (
        node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)
    )
    return sum(function.name.startswith("test_") for function in functions)


def rust_tests() -> int:
    files = [*(ROOT / "rust").rglob("*.rs"), *(ROOT / "tests").rglob("*.rs")]
    return sum(len(re.findall(r"#\[test\]", path.read_text("utf-8"))) for path in files)


def examples() -> tuple[int, int]:
    """Returns the numbers of Python examples and of commands in the pages."""
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    pages = [page for page in pages if "_build" not in page.parts]
    parse = doctest.DocTestParser().get_examples
    python = sum(len(parse(block)) for page in pages for block in blocks(page, "pycon"))
    return python, sum(len(page_commands(page)) for page in pages)


def figures() -> nodes.table:
    python, commands = examples()
    targets = list((ROOT / "fuzz" / "fuzz_targets").glob("*.rs"))
    inputs = [path for path in (ROOT / "fuzz" / "corpus").rglob("*") if path.is_file()]
    rows = (
        ("test functions in Python; many run for many cases", python_tests()),
        ("test functions in Rust", rust_tests()),
        ("Python examples in these pages, each run as a test", python),
        ("commands in these pages, each run as a test", commands),
        ("fuzz targets", len(targets)),
        ("inputs that fuzzers found, replayed by cargo test", len(inputs)),
        ("quantities in the tables", len(QUANTITIES)),
        ("messages in the tables", len(MESSAGES)),
        ("virtual products", len(PRODUCTS)),
    )
    return table(("what", "number"), ((text, f"{number:,}") for text, number in rows))


class Figures(SphinxDirective):
    def run(self) -> list[nodes.Node]:
        return [figures()]


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("figures", Figures)
    return {"parallel_read_safe": True}
