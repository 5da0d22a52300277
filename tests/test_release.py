"""What a release relies on: one version, one list of supported versions, and pinned actions."""

from __future__ import annotations

import importlib.util
import re
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import xbus

ROOT = Path(__file__).parents[1]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
CHANGELOG = "# Changelog\n\n## 1.2.0 (2027-01-05)\n\n- New\n\n## 1.1.0 (unreleased)\n\n- Old\n"


def text(path: str) -> str:
    return (ROOT / path).read_text("utf-8")


def table(path: str) -> dict[str, Any]:
    return tomllib.loads(text(path))


def script() -> ModuleType:
    """Returns .ci/version.py."""
    spec = importlib.util.spec_from_file_location("version", ROOT / ".ci" / "version.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


# One version


def test_every_version_is_that_of_the_crate() -> None:
    version = table("Cargo.toml")["package"]["version"]
    for lock in ("Cargo.lock", "fuzz/Cargo.lock"):
        packages = table(lock)["package"]
        assert [row["version"] for row in packages if row["name"] == "xbus-mti"] == [version]
    assert xbus.__version__ == version
    assert table("pyproject.toml")["project"]["dynamic"] == ["version"]
    assert next(iter(script().sections(text("CHANGELOG.md")))) == version
    if (ROOT / "CITATION.cff").exists():
        assert re.findall(r'^version: "?([^"\n]+)"?$', text("CITATION.cff"), re.M) == [version]
    assert f'\ncontext:\n  version: "{version}"\n' in text("conda/recipe.yaml")


def test_the_supported_versions_are_the_same_everywhere() -> None:
    project = table("pyproject.toml")
    cargo = table("Cargo.toml")
    python, rust = project["project"]["requires-python"], cargo["package"]["rust-version"]
    assert python == ">=3.11"
    assert cargo["dependencies"]["pyo3"]["features"] == ["abi3-py311"]
    assert project["tool"]["ruff"]["target-version"] == "py311"
    for page in ("CONTRIBUTING.md", "docs/install.md"):
        assert f"Rust {rust} or later" in text(page).replace("\n", " "), page
        assert "3.11 or later" in text(page), page


@pytest.mark.parametrize(
    ("tag", "version", "mistakes"),
    [
        ("v1.2.0", "1.2.0", []),
        ("1.2.0", "1.2.0", ["the tag is 1.2.0, and Cargo.toml has 1.2.0"]),
        ("v1.1.0", "1.2.0", ["the tag is v1.1.0, and Cargo.toml has 1.2.0"]),
        ("v1.1.0", "1.1.0", ["CHANGELOG.md says that 1.1.0 is unreleased; write the date"]),
        ("v1.3.0", "1.3.0", ["CHANGELOG.md has no section 1.3.0"]),
    ],
)
def test_a_tag_is_checked(tag: str, version: str, mistakes: list[str]) -> None:
    assert script().mistakes(tag, version, CHANGELOG, f"version: {version}\n") == mistakes


def test_a_citation_of_another_version() -> None:
    found = script().mistakes("v1.2.0", "1.2.0", CHANGELOG, "version: 1.1.0\n")
    assert found == ["CITATION.cff has another version than 1.2.0"]


def test_the_changes_of_a_version() -> None:
    assert script().sections(CHANGELOG) == {
        "1.2.0": ("2027-01-05", "- New"),
        "1.1.0": ("unreleased", "- Old"),
    }


def test_the_conda_recipe_has_the_requirements_of_the_project() -> None:
    project = table("pyproject.toml")
    recipe = text("conda/recipe.yaml")
    run = re.search(r"^  run:\n((?:    - .*\n)+)", recipe, re.M)
    assert run is not None
    wanted = ["python", *project["project"]["dependencies"]]
    assert [line.strip("- ").replace(" ", "") for line in run[1].splitlines()] == wanted
    (maturin,) = project["build-system"]["requires"]
    assert (
        recipe.count("- maturin ")
        == recipe.count(f"- {maturin.replace('maturin', 'maturin ')}\n")
        == 2
    )
    assert f'python_min: "{project["project"]["requires-python"].removeprefix(">=")}"' in recipe


# Workflows. zizmor and the schema check more, in .ci/run.


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.name)
def test_actions_are_pinned(workflow: Path) -> None:
    """By the hash of a commit, the same for an action everywhere, with its version for readers."""
    uses = re.findall(r"\buses: *(.*)", workflow.read_text("utf-8"))
    assert uses
    for line in uses:
        assert re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+", line), line
    everywhere = {
        line for path in WORKFLOWS for line in re.findall(r"uses: *(.*)", path.read_text())
    }
    names = [line.split("@")[0] for line in everywhere]
    assert len(names) == len(set(names))


def test_every_fuzzer_runs() -> None:
    targets = sorted(path.stem for path in (ROOT / "fuzz" / "fuzz_targets").glob("*.rs"))
    assert f"name: [{', '.join(targets)}]" in text(".github/workflows/ci.yml")
