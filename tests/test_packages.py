"""Packages import only from the packages below them, as the diagram in CONTRIBUTING shows."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "python" / "xbus"
#: Modules above every package: the public names, ``python -m xbus``, and the pytest plugin.
ABOVE = ("__init__", "__main__", "pytest_plugin")


def layers() -> list[str]:
    """The packages of the diagram, from the bottom up."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    (diagram,) = re.findall(r"^```text\n(cli .*?)^```", text, re.MULTILINE | re.DOTALL)
    return [line.split()[0] for line in diagram.splitlines()][::-1]


def imports(path: Path) -> Iterator[tuple[int, str]]:
    """Line and package of every import of xbus in a module, inside functions and TYPE_CHECKING blocks too."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative import"
            module = node.module or ""
            names = [f"{module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        for name in names:
            if name.split(".")[0] == "xbus":
                yield node.lineno, name.partition(".")[2].partition(".")[0]


def package_of(path: Path) -> str:
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def test_the_diagram_lists_every_package() -> None:
    found = {package_of(path) for path in PACKAGE.rglob("*.py")} - set(ABOVE)
    assert sorted(layers()) == sorted(found)


@pytest.mark.parametrize("package", layers())
def test_imports_point_downward(package: str) -> None:
    order = layers()
    below = {"_core", *order[: order.index(package) + 1]}
    upward = [
        f"{path.relative_to(ROOT)}:{line} imports xbus.{target}"
        for path in sorted(PACKAGE.rglob("*.py"))
        if package_of(path) == package
        for line, target in imports(path)
        if target not in below
    ]
    assert not upward, "\n".join(upward)


def test_an_upward_import_is_found(tmp_path: Path) -> None:
    module = tmp_path / "module.py"
    module.write_text(
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from xbus.cli import main\n"
        "def f() -> None:\n    from xbus import sim\n    import xbus.log.read\n"
    )
    assert list(imports(module)) == [(3, "cli"), (5, "sim"), (6, "log")]
