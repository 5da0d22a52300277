"""Packages import only from the packages below them, as the diagram in CONTRIBUTING shows.

Modules of one package do not import each other in a cycle.
"""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
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


@functools.cache
def import_nodes(text: str) -> list[ast.Import | ast.ImportFrom]:
    """The imports in a module; the tests ask for those of the same module many times."""
    nodes = ast.walk(ast.parse(text))
    return [node for node in nodes if isinstance(node, ast.Import | ast.ImportFrom)]


def imports(path: Path) -> Iterator[tuple[int, str]]:
    """Line and name, without ``xbus.``, of every import of xbus in a module.

    Imports inside functions and TYPE_CHECKING blocks count too.
    """
    for node in import_nodes(path.read_text()):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative import"
            module = node.module or ""
            names = [f"{module}.{alias.name}" for alias in node.names]
        else:
            names = [alias.name for alias in node.names]
        for name in names:
            if name.split(".")[0] == "xbus":
                yield node.lineno, name.partition(".")[2]


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
        f"{path.relative_to(ROOT)}:{line} imports xbus.{name}"
        for path in sorted(PACKAGE.rglob("*.py"))
        if package_of(path) == package
        for line, name in imports(path)
        if name.partition(".")[0] not in below
    ]
    assert not upward, "\n".join(upward)


def test_an_upward_import_is_found(tmp_path: Path) -> None:
    module = tmp_path / "module.py"
    module.write_text(
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from xbus.cli import main\n"
        "def f() -> None:\n    from xbus import sim\n    import xbus.log.read\n"
    )
    assert list(imports(module)) == [(3, "cli.main"), (5, "sim"), (6, "log.read")]


def cycle(root: Path, package: str) -> list[str]:
    """The modules of a cycle of imports inside a package; empty if there is none."""
    paths = {
        ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__"): path
        for path in sorted((root / package).rglob("*.py"))
    }

    def imported(module: str) -> set[str]:
        names = {name for _, name in imports(paths[module])}
        # The last part of a name is a module, or a name in a module.
        found = {name if name in paths else name.rpartition(".")[0] for name in names}
        return found & paths.keys() - {module}

    try:
        TopologicalSorter({module: imported(module) for module in paths}).prepare()
    except CycleError as error:
        modules: list[str] = error.args[1]
        return modules
    return []


@pytest.mark.parametrize("package", [name for name in layers() if (PACKAGE / name).is_dir()])
def test_modules_of_a_package_do_not_import_each_other(package: str) -> None:
    assert not cycle(PACKAGE, package)


def test_a_cycle_is_found(tmp_path: Path) -> None:
    package = tmp_path / "log"
    package.mkdir()
    (package / "__init__.py").write_text("from xbus.log.read import read_log\n")
    (package / "read.py").write_text("from xbus.log import table\n")
    (package / "table.py").write_text("import xbus.protocol\n")
    assert not cycle(tmp_path, "log")
    (package / "table.py").write_text("def f():\n    from xbus.log import read_log\n")
    assert sorted(set(cycle(tmp_path, "log"))) == ["log", "log.read", "log.table"]
