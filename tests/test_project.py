"""What the pages say of licences and products, and the scripts that build the site."""

from __future__ import annotations

import re
import runpy
import shutil
import tomllib
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path
from typing import Any

import pytest

import make_third_party
from xbus.protocol.tables import PRODUCTS

ROOT = Path(__file__).resolve().parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
#: Extras for work on xbus itself.
DEVELOPMENT = {"test", "lint", "docs"}


def script(name: str) -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "docs" / name))


def table(page: str, header: str) -> list[list[str]]:
    """Returns the cells of the table with this header, row by row."""
    text = (ROOT / page).read_text("utf-8")
    rows = text.partition(f"{header}\n")[2].partition("\n\n")[0].splitlines()[1:]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]


@pytest.mark.skipif(shutil.which("cargo") is None, reason="needs cargo")
def test_the_notices_are_those_of_the_crates() -> None:
    """A difference is written to the file, and the test fails once."""
    text = make_third_party.text()
    if make_third_party.NOTICES.read_text("utf-8") != text:
        make_third_party.NOTICES.write_text(text, "utf-8")
        raise AssertionError(
            "THIRD-PARTY.txt was out of date and is written again; check the difference"
        )


def test_wheels_contain_the_notices() -> None:
    assert make_third_party.NOTICES.name in PYPROJECT["project"]["license-files"]


@pytest.mark.parametrize(
    ("licence", "part"),
    [
        ("MIT OR Apache-2.0", "MIT"),
        ("Apache-2.0/MIT", "MIT"),
        ("Unlicense OR BSD-3-Clause", "BSD-3-Clause"),
        ("Zlib OR Apache-2.0", "Apache-2.0"),
        ("Apache-2.0 AND MIT", "Apache-2.0 AND MIT"),
    ],
)
def test_chosen_licences(licence: str, part: str) -> None:
    assert make_third_party.chosen(licence) == part


def test_an_unknown_licence_is_refused() -> None:
    with pytest.raises(ValueError, match=r"no known licence in 'GPL-3\.0'"):
        make_third_party.chosen("GPL-3.0")


def test_the_page_of_licences_lists_every_library() -> None:
    extras = {"": PYPROJECT["project"]["dependencies"]}
    extras |= PYPROJECT["project"]["optional-dependencies"]
    wanted: dict[str, list[str]] = {}
    for extra in sorted(extras.keys() - DEVELOPMENT):
        for requirement in extras[extra]:
            found = re.match(r"[\w-]+", requirement)
            assert found, requirement
            wanted.setdefault(found[0], []).append(extra)
    rows = table("docs/licences.md", "| library | extra | licence |")
    assert {name: extra for name, extra, _ in rows} == {
        name: ", ".join(extras) for name, extras in wanted.items()
    }


def test_licences_are_those_that_the_libraries_state() -> None:
    checked = 0
    for name, _, licence in table("docs/licences.md", "| library | extra | licence |"):
        try:
            about = metadata(name)
        except PackageNotFoundError:
            continue
        fields = ("License-Expression", "License", "Classifier")
        stated = " ".join(text for field in fields for text in about.get_all(field) or ())
        assert licence in stated, f"{name}: {stated}"
        checked += 1
    assert checked >= 4  # the dependencies are always there


def test_the_page_of_support_names_products_of_the_manual() -> None:
    products = {product.title.split()[0] for product in PRODUCTS.values()}
    rows = table("docs/support.md", "| | tested with | status |")
    named = {name for cells in rows for name in re.findall(r"MTi-[\w-]+", cells[0])}
    assert named - products == {"MTi-320", "MTi-G"}
    assert len(products) == 16


# The site


def test_versions_are_sorted_newest_first(tmp_path: Path) -> None:
    for version in ("0.2.0", "0.10.0", "0.2.0rc1", "0.1.0"):
        (tmp_path / version).mkdir()
        (tmp_path / version / "index.html").write_text("")
    (tmp_path / "other").mkdir()
    (tmp_path / "0.3.0").mkdir()  # without pages
    build_site = script("build_site.py")
    assert build_site["versions"](tmp_path) == ["0.10.0", "0.2.0", "0.2.0rc1", "0.1.0"]
    build_site["write_index"](tmp_path)
    assert "url=0.10.0/index.html" in (tmp_path / "index.html").read_text()
    assert '["0.10.0", "0.2.0", "0.2.0rc1", "0.1.0"]' in (tmp_path / "versions.js").read_text()


def test_broken_links_are_found(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "a.html").write_text(
        '<h1 id="top">A</h1><a href="#top"></a><a href="sub/b.html#here"></a><a href="https://example.org/x"></a>'
        '<script src="../versions.js"></script>'
        '<a href="#gone"></a><a href="sub/b.html#gone"></a><a href="c.html"></a><img src="no.png">'
        '<script src="https://example.org/x.js"></script>'
    )
    (tmp_path / "sub" / "b.html").write_text('<p id="here"><a href="../a.html#top"></a>')
    assert list(script("check_links.py")["broken_links"](tmp_path)) == [
        "a.html: #gone leads to no anchor",
        "a.html: sub/b.html#gone leads to no anchor",
        "a.html: c.html leads to no file",
        "a.html: no.png leads to no file",
        "a.html: https://example.org/x.js is loaded from elsewhere",
    ]
