"""TOML text: values written on one line, and the line number of each key.

The standard library reads TOML and does not write it. tomlkit does both, but has no line numbers, which every
message about a settings file needs.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

__all__ = ["format_value", "line_numbers", "parse", "shortened"]

#: Maximum length of a value in a message.
SHOWN = 60
#: What decides where a value ends: strings, comments, brackets, equals signs and line ends.
_TOKEN = re.compile(
    r'''"""(?:[^\\]|\\.)*?"{3,5}|\'\'\'.*?'{3,5}|"(?:[^"\\]|\\.)*"|'[^']*'|#[^\n]*|[\[\]{}=\n]''',
    re.DOTALL,
)


def format_value(value: Any) -> str:
    r"""Returns a value as TOML on one line.

    Raises:
        ValueError: Text contains a lone surrogate, which TOML cannot represent.

    >>> print(format_value({"types": ["GPGGA"], "name": 'a "b"\t'}))
    { types = ["GPGGA"], name = "a \"b\"\U00000009" }
    """
    match value:
        case bool():
            return str(value).lower()
        case str():
            escaped = value.replace("\\", "\\\\").replace('"', '\\"')
            return '"' + "".join(map(_escape, escaped)) + '"'
        case dict():
            pairs = ", ".join(f"{key} = {format_value(item)}" for key, item in value.items())
            return f"{{ {pairs} }}" if pairs else "{}"
        case list():
            return f"[{', '.join(map(format_value, value))}]"
    return str(value)


def _escape(character: str) -> str:
    if character.isprintable():
        return character
    if "\ud800" <= character <= "\udfff":
        raise ValueError(f"TOML cannot represent the lone surrogate {character!r}")
    return f"\\U{ord(character):08X}"


def shortened(text: str) -> str:
    """Returns text for a message, cut if it is long.

    >>> shortened("x" * 1000)[-21:]
    '... (1000 characters)'
    """
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}... ({len(text)} characters)"


def parse(text: str) -> dict[str, Any]:
    """Returns the content of TOML text.

    Raises:
        ValueError: The text is not TOML; the message begins with the line.

    >>> parse("a = 1")
    {'a': 1}
    """
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        problem, _, place = str(error).rpartition(" (at ")
        found = re.match(r"line (\d+)", place)
        line = int(found[1]) if found else max(1, len(text.splitlines()))
        raise ValueError(
            f"line {line}: {problem[0].lower()}{problem[1:]}; this is not TOML"
        ) from None
    except RecursionError:
        raise ValueError("lists or tables are nested too deeply for a settings file") from None
    except ValueError:
        raise ValueError("a number has too many digits for a settings file") from None


def line_numbers(text: str) -> Mapping[str, Sequence[int]]:
    r"""Returns the line of each top-level key, followed by the lines of the tables in its list.

    Args:
        text: Valid TOML. Quotes and brackets are counted, so a key inside a string or a table is not found.

    >>> line_numbers("a = 1\nb = [\n  { c = 2 },\n  { c = 3 },\n]")
    {'a': [1], 'b': [2, 3, 4]}
    """
    found: dict[str, list[int]] = {}
    line, depth, start = 1, 0, 0  # start: offset of the statement
    key, is_header, has_header = "", False, False
    for token in _TOKEN.finditer(text + "\n"):
        match token[0]:
            case "=" if depth == 0 and not key and not has_header:
                (key,) = tomllib.loads(f"{text[start : token.start()]}= 0")
                found.setdefault(key, []).append(line)
            case "[" if depth == 0 and not text[start : token.start()].strip():
                is_header = has_header = True
                depth += 1
            case "[" | "{" as bracket:
                if bracket == "{" and depth == 1 and key:
                    found[key].append(line)
                depth += 1
            case "]" | "}":
                depth -= 1
            case "\n" if depth == 0:
                if is_header:
                    ((name, content),) = tomllib.loads(text[start : token.start()]).items()
                    numbers = found.setdefault(name, [line])
                    if isinstance(content, list):
                        numbers.append(line)
                key, is_header, start = "", False, token.end()
        line += token[0].count("\n")
    return found
