"""Texts for people: unknown numbers are words or left out, never "nan"."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from test_cli import FIELD, WALK, run
from xbus import encode_sample
from xbus.protocol.tables import QUANTITIES

PACKAGE = Path(__file__).parent.parent / "python" / "xbus"
#: An option of a command.
OPTION = re.compile(r"(?<![\w-])--[a-z]")


def texts_of(module: Path) -> Iterator[str]:
    """The texts in a module that are no docstrings."""
    nodes = list(ast.walk(ast.parse(module.read_text("utf-8"))))
    docs = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs:
            yield node.value


@pytest.mark.parametrize("package", ["export", "log", "protocol"])
def test_the_library_names_arguments_and_no_options(package: str) -> None:
    """Commands replace them: see `xbus.cli.argument_options`."""
    modules = [*(PACKAGE / package).rglob("*.py")]
    assert len(modules) > 10
    assert [text for module in modules for text in texts_of(module) if OPTION.search(text)] == []


def strange(number: float) -> bytes:
    """Returns a sample of each quantity: a number for reals, "not provided" for fields that can be that."""
    parts = []
    for row in QUANTITIES.values():
        if row.kind == "real":
            parts.append(encode_sample({row.name: np.full(row.shape, number)}))
        elif row.kind == "struct":
            fields = {field.name: field.missing or 0 for field in row.fields}
            parts.append(encode_sample({row.name: fields, "sample_time_fine": len(parts)}))
    return b"".join(parts)


@pytest.mark.parametrize("what", [WALK, FIELD, np.nan, np.inf, 0.0])
def test_no_text_contains_nan(what: str | float, tmp_path: Path) -> None:
    file, page = tmp_path / "x.mtb", tmp_path / "x.html"
    file.write_bytes(Path(what).read_bytes() if isinstance(what, str) else strange(what))
    assert run("report", str(file), "-o", str(page)).exit_code == 0
    texts = [re.sub("<script.*?</script>", "", page.read_text("utf-8"), flags=re.DOTALL)]
    for args in (["info"], ["dump"], ["monitor", "--once", "1"]):
        result = run(*args, str(file))
        assert result.exit_code == 0
        texts.append(result.output)
    for text in texts:
        assert not re.search(r"\bnan\b", text)
