"""JSON that is written piece by piece: long lists need not fit into memory."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

__all__ = ["JsonRows", "json_pieces"]


class JsonRows:
    """A JSON list whose elements are made one by one when it is written.

    Args:
        rows: Returns the elements.
    """

    def __init__(self, rows: Callable[[], Iterator[Any]]) -> None:
        self._rows = rows

    def __iter__(self) -> Iterator[Any]:
        return self._rows()


def json_pieces(value: Any, indent: str = "\n") -> Iterator[str]:
    r"""Yields what ``json.dumps(value, indent=2, allow_nan=False)`` returns, in pieces.

    Args:
        value: Plain values, and `JsonRows` in objects and lists.
        indent: A line feed and the indentation of the value.

    >>> "".join(json_pieces({"n": 2, "rows": JsonRows(lambda: iter([1, []]))}))
    '{\n  "n": 2,\n  "rows": [\n    1,\n    []\n  ]\n}'
    """
    inner = indent + "  "
    if isinstance(value, dict) and value:
        start = "{"
        for key, item in value.items():
            yield f"{start}{inner}{json.dumps(key)}: "
            yield from json_pieces(item, inner)
            start = ","
        yield indent + "}"
    elif isinstance(value, list | JsonRows):
        start = "["
        for item in value:
            yield start + inner
            yield from (
                json_pieces(item, inner) if isinstance(value, list) else [_dumps(item, inner)]
            )
            start = ","
        yield "[]" if start == "[" else indent + "]"
    else:
        yield _dumps(value, indent)


def _dumps(value: Any, indent: str) -> str:
    return json.dumps(value, indent=2, allow_nan=False).replace("\n", indent)
