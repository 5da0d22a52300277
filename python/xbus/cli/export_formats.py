"""The formats of other software that ``xbus decode`` writes, and their options."""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

if TYPE_CHECKING:
    from xbus.export.format import Format

__all__ = ["EXPORTS", "FormatOptions", "format_options"]

#: The class of each format by suffix, as module and name: imported when it is used.
EXPORTS: dict[str, tuple[str, str]] = {
    ".gpx": ("xbus.export.gpx", "Gpx"),
}

#: For each option of the command the suffixes that it applies to, and the option. Its name is that of an
#: attribute of their classes.
OPTIONS: dict[str, tuple[tuple[str, ...], Callable[..., Any]]] = {}


@dataclass(frozen=True)
class FormatOptions:
    """The options that apply to some formats only.

    Attributes:
        values: The value of each option, by its name.
        given: The names of those on the command line.
    """

    values: dict[str, Any] = field(default_factory=dict)
    given: frozenset[str] = frozenset()

    def check(self, suffix: str) -> None:
        """Checks that the options on the command line apply to a format.

        Raises:
            UsageError: One does not.
        """
        for name in sorted(self.given):
            suffixes, _ = OPTIONS[name]
            if suffix not in suffixes:
                option = "--" + name.replace("_", "-")
                raise click.UsageError(
                    f"{option} applies to {' and '.join(suffixes)}, not to {suffix}"
                )

    def format_of(self, suffix: str) -> Format | None:
        """Returns the format with a suffix, or None if it is not one of other software."""
        if suffix not in EXPORTS:
            return None
        module, name = EXPORTS[suffix]
        own = {name: value for name, value in self.values.items() if suffix in OPTIONS[name][0]}
        found: Format = getattr(importlib.import_module(module), name)(**own)
        return found


def format_options(command: Callable[..., None]) -> Callable[..., None]:
    """Adds the options. The command receives them as `FormatOptions` with the name ``options``."""

    @functools.wraps(command)
    @click.pass_context
    def with_options(ctx: click.Context, /, **values: Any) -> None:
        own = {name: values.pop(name) for name in OPTIONS}
        source = ctx.get_parameter_source
        given = frozenset(name for name in own if source(name) == ParameterSource.COMMANDLINE)
        command(options=FormatOptions(own, given), **values)

    decorated: Callable[..., None] = with_options
    for _, option in reversed(OPTIONS.values()):
        decorated = option(decorated)
    return decorated
