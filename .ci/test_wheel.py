"""Installs a wheel, or builds the sdist, in a fresh environment and tests it there, outside the repository.

    python .ci/test_wheel.py DIST [--sdist] [PYTEST OPTION...]

DIST is a folder with wheels, of which the one for this Python is used, and with the sdist for --sdist. Needs
only pip. The tests are those that need no extra, no terminal and no Linux: this script also runs on Windows,
macOS and musl.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: What the tests read. `python` is left out, so that only the installed package can be imported.
FILES = ("tests", "docs", "pyproject.toml", "Cargo.toml", "README.md", "CONTRIBUTING.md")
TOOLS = ("pytest>=8", "pytest-timeout>=2.3", "pytest-xdist>=3.6", "hypothesis>=6.100")
TESTS = (
    "codec",
    "column",
    "cutting",
    "doctor",
    "log",
    "products",
    "settings",
    "sim_framing",
    "strings",
)


def main() -> None:
    dist, *options = sys.argv[1:]
    is_sdist = "--sdist" in options
    options = [option for option in options if option != "--sdist"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        python = environment(folder / "venv")
        install(python, Path(dist).resolve(), is_sdist=is_sdist)
        where = (
            "import xbus, pathlib; print(xbus.__version__, pathlib.Path(xbus.__file__).resolve())"
        )
        run(python, "-c", where, cwd=folder)
        run(python, "-m", "xbus", "demo", cwd=folder)
        run(python, "-m", "pytest", "-q", *options, *tests(folder), cwd=folder)


def environment(folder: Path) -> Path:
    """Makes a virtual environment, and returns its Python."""
    venv.create(folder, with_pip=True)
    return folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def install(python: Path, dist: Path, *, is_sdist: bool) -> None:
    """Installs xbus from a folder only, then its requirements and the tools from the index."""
    pip = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check")
    if is_sdist:
        (sdist,) = dist.glob("*.tar.gz")
        run(python, *pip, "--no-deps", str(sdist))
    else:
        source = ("--no-index", "--find-links", str(dist), "--only-binary=:all:")
        run(python, *pip, "--no-deps", *source, "xbus-mti")
    run(python, *pip, "xbus-mti", *TOOLS)


def tests(folder: Path) -> list[str]:
    """Copies the tests and what they read, and returns the files to run."""
    for name in FILES:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, folder / name)
    return [str(Path("tests", f"test_{name}.py")) for name in TESTS]


def run(python: Path, *args: str, cwd: Path | None = None) -> None:
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    subprocess.run([python, *args], cwd=cwd, env=environment, check=True)


if __name__ == "__main__":
    main()
