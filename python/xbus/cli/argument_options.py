"""Messages of the library in the terms of the command line."""

from __future__ import annotations

import re

__all__ = ["with_argument_options"]

#: The options that stand for arguments of Python, which messages write as ``rate=100`` or ``between=``.
OPTIONS = {
    "between": "--between",
    "bid": "--bid",
    "by_hour": "--partition-by",
    "legacy": "--legacy",
    "mtm": "--mtm",
    "quantities": "--quantity",
    "rate": "--rate",
    "size": "--partition-size",
    "source": "--source",
}
#: An argument, with or without its value.
ARGUMENT = re.compile(rf"\b({'|'.join(OPTIONS)})=(\"?)(\w[\w.:]*)?\2")


def with_argument_options(message: str) -> str:
    """Returns a message with options in place of arguments.

    >>> with_argument_options('rate=HZ gives times, mtm="2022" needs none; or choose a part with between=')
    '--rate HZ gives times, --mtm 2022 needs none; or choose a part with --between'
    """
    return ARGUMENT.sub(lambda found: f"{OPTIONS[found[1]]} {found[3] or ''}".rstrip(), message)
