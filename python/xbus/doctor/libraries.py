"""Checks of the installed versions: xbus, its extension module, and the libraries it uses."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from xbus._core import __version__
from xbus.doctor.finding import Finding
from xbus.doctor.machine import DISTRIBUTION, Machine

__all__ = [
    "Library",
    "as_python_writes",
    "check_installation",
    "check_libraries",
    "extras",
    "required",
]

#: Extras for work on xbus itself.
DEVELOPMENT = {"test", "lint", "docs"}
REQUIREMENT = re.compile(r"([\w.-]+)(?:\[[^]]*\])?\s*>=\s*([\d.]+)")
EXTRA = re.compile(r"""extra\s*==\s*["']([\w-]+)["']""")


class Library(NamedTuple):
    """A library that xbus uses.

    Attributes:
        name: Name of its distribution.
        needs: The lowest version that xbus supports.
        version: The installed version; None if it is not installed.
    """

    name: str
    needs: str
    version: str | None

    @property
    def is_enough(self) -> bool:
        """Whether it is installed in a version that xbus supports."""
        return self.version is not None and _release(self.version) >= _release(self.needs)


def _release(version: str) -> list[int]:
    """Returns the numbers of a version: [2, 1] for 2.1.0rc1, since 2.1 and 2.1.0 are equal."""
    found = re.match(r"\d+(?:\.\d+)*", version)
    numbers = [int(number) for number in found[0].split(".")] if found else []
    while numbers and numbers[-1] == 0:
        numbers.pop()
    return numbers


def as_python_writes(version: str) -> str:
    """Returns a version of Rust as metadata has it: 0.2.0rc1 for 0.2.0-rc.1."""
    return re.sub(r"-(a|b|rc)\w*\.(\d+)$", r"\1\2", version)


def _libraries(machine: Machine) -> Iterator[tuple[str | None, Library]]:
    """Yields the libraries in the metadata of xbus, each with the extra that installs it."""
    for requirement in machine.requirements() or []:
        text, _, marker = requirement.partition(";")
        extra = EXTRA.search(marker)
        if (found := REQUIREMENT.match(text.strip())) is not None:
            name, needs = found.groups()
            yield extra and extra[1], Library(name, needs, machine.version(name))


def required(machine: Machine) -> list[Library]:
    """Returns the libraries without which xbus does not run; empty without metadata."""
    return [library for extra, library in _libraries(machine) if extra is None]


def extras(machine: Machine) -> dict[str, list[Library]]:
    """Returns the libraries of each extra that adds features; empty without metadata."""
    found: dict[str, list[Library]] = {}
    for extra, library in _libraries(machine):
        if extra is not None and extra not in DEVELOPMENT:
            found.setdefault(extra, []).append(library)
    return found


def check_installation(machine: Machine) -> Iterator[Finding]:
    """Checks that package and extension module belong together."""
    installed = machine.version(DISTRIBUTION)
    others = [name for name in machine.providers() if name != DISTRIBUTION]
    if others:
        yield Finding(
            "installation",
            "problem",
            f"{' and '.join(others)} also installs a package xbus, which replaces files of this one",
            f"pip uninstall {' '.join(others)}, then: pip install --force-reinstall {DISTRIBUTION}",
        )
    if installed is None:
        yield Finding(
            "installation",
            "warning",
            f"{DISTRIBUTION} is not installed: xbus runs from a folder, so its libraries are not checked",
            "pip install . in the checkout",
        )
    elif installed != as_python_writes(__version__):
        yield Finding(
            "installation",
            "problem",
            f"the installed package is {installed}, but its extension module is {__version__}",
            f"pip install --force-reinstall {DISTRIBUTION}",
        )
    elif not others:
        yield Finding("installation", "ok", "package and extension module have the same version")


def check_libraries(machine: Machine) -> Iterator[Finding]:
    """Checks the versions of the libraries. An extra that is not installed is no finding."""
    failed = False
    for extra, library in _libraries(machine):
        if library.is_enough or extra in DEVELOPMENT or (extra and library.version is None):
            continue
        failed = True
        has = f"is {library.version}" if library.version else "is not installed"
        needs = f"xbus needs {library.needs} or later"
        if extra is not None:
            needs = f"the extra {extra} needs {library.needs} or later"
        yield Finding(
            "libraries",
            "warning" if extra else "problem",
            f"{library.name} {has}; {needs}",
            f'pip install --upgrade "{library.name}>={library.needs}"',
        )
    if not failed and machine.requirements() is not None:
        yield Finding("libraries", "ok", "all installed libraries are recent enough")
