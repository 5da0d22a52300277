"""Keys: how a quantity is named, and mappings by quantity."""

from __future__ import annotations

from collections.abc import ItemsView, Iterable, Iterator, KeysView, Mapping, ValuesView
from typing import Any, Generic, NamedTuple, TypeVar, overload

from xbus.protocol.formats import format_of
from xbus.protocol.ids import Coordinates, Precision
from xbus.protocol.tables import COLUMN_QUANTITIES, Quantity

__all__ = ["ByQuantity", "EntryKey", "Key", "KeyIndex", "QuantityKey", "key_of", "resolve_key"]

#: A quantity: its name or data identifier, or a tuple of that and, in any order, coordinates and precision:
#: ``"acceleration"``, ``DataId.Acceleration``, ``("quaternion", "NED")``,
#: ``(DataId.Quaternion, Coordinates.NED, Precision.Fp1632)``. Format bits in an identifier count.
Key = str | int | tuple[str | int, ...]
#: The keys that a `ByQuantity` yields: a name, or ``(name, coordinates)`` where one quantity occurs in
#: several coordinate systems.
EntryKey = str | tuple[str, str]

V = TypeVar("V")
D = TypeVar("D")


class QuantityKey(NamedTuple):
    """A resolved key.

    Attributes:
        name: Name of the quantity.
        coordinates: Name of the coordinate system, or None if the key names none.
        precision: Name of the precision, or None if the key names none.
    """

    name: str
    coordinates: str | None = None
    precision: str | None = None

    @property
    def quantity(self) -> Quantity:
        """The row of the table."""
        return COLUMN_QUANTITIES[self.name]


def resolve_key(key: Key) -> QuantityKey:
    """Returns what a key names.

    Raises:
        TypeError: The key is not of a type that `Key` lists.
        ValueError: No quantity has this name or identifier, or the formats do not fit the quantity.

    >>> from xbus import Coordinates, DataId
    >>> resolve_key((DataId.Quaternion, Coordinates.NED))
    QuantityKey(name='quaternion', coordinates='NED', precision=None)
    >>> resolve_key(0x2014) == resolve_key(("quaternion", "NED"))
    True
    """
    subject, *formats = key if isinstance(key, tuple) and key else (key,)
    if isinstance(subject, str):
        if (row := COLUMN_QUANTITIES.get(subject)) is None:
            hint = _suggestion(subject, COLUMN_QUANTITIES, "xbus quantities lists them")
            raise ValueError(f"no quantity is called {subject!r}; {hint}")
    elif isinstance(subject, int) and not isinstance(subject, bool | Coordinates | Precision):
        row, precision, system = format_of(subject)
        if row is None:
            raise ValueError(f"no quantity has the data identifier 0x{subject:04X}")
        if precision:
            formats.append(precision)
        if system:
            if not isinstance(system, Coordinates):
                raise ValueError(
                    f"0x{subject:04X} has format bits that are not a coordinate system"
                )
            formats.append(system)
    else:
        raise TypeError(
            "a key is a name, a DataId, or a tuple of one of these with coordinates and precision, "
            f"not {key!r}"
        )
    coordinates = [name for value in formats if (name := _format(Coordinates, value))]
    precisions = [name for value in formats if (name := _format(Precision, value))]
    if len(coordinates) + len(precisions) != len(formats):
        systems, numbers = ", ".join(Coordinates.__members__), ", ".join(Precision.__members__)
        raise ValueError(
            f"{key!r}: a format is a coordinate system ({systems}) or a precision ({numbers})"
        )
    if len(coordinates) > 1 or len(precisions) > 1:
        raise ValueError(f"{key!r}: a key has at most one coordinate system and one precision")
    if (coordinates and not row.coordinates) or (precisions and row.kind != "real"):
        raise ValueError(
            f"{key!r}: {row.name} has no {'coordinates' if coordinates else 'precision'}"
        )
    return QuantityKey(row.name, next(iter(coordinates), None), next(iter(precisions), None))


def key_of(data_id: int) -> QuantityKey:
    """Returns the key of a packet with this data identifier; all format bits count, also zeros.

    Raises:
        ValueError: The tables do not explain the identifier.

    >>> key_of(0x2010), resolve_key(0x2010)[:2]
    (QuantityKey(name='quaternion', coordinates='ENU', precision='Float32'), ('quaternion', None))
    """
    row, precision, system = format_of(data_id)
    if row is None or (system is not None and not isinstance(system, Coordinates)):
        raise ValueError(f"the tables do not explain the data identifier 0x{data_id:04X}")
    return QuantityKey(
        row.name,
        None if system is None else system.name,
        None if precision is None else precision.name,
    )


def _format(kind: type[Coordinates | Precision], value: str | int) -> str | None:
    """Returns the name of the member that a value is, or names; None if it does neither."""
    if isinstance(value, kind):
        return value.name
    return value if isinstance(value, str) and value in kind.__members__ else None


def _suggestion(name: str, names: Iterable[str], otherwise: str) -> str:
    import difflib  # imported only for an error

    near = difflib.get_close_matches(name, list(names), n=1)
    return f"did you mean {near[0]!r}?" if near else otherwise


class KeyIndex:
    """Finds the entries that a key names among the quantities of a log or a sample.

    Args:
        entries: The resolved key of each entry, with coordinates and precision where the manual defines them.

    Attributes:
        entries: The same.
        keys: The key under which each entry is listed: its name, or ``(name, coordinates)`` for a quantity in
            several coordinate systems.
    """

    def __init__(self, entries: Iterable[QuantityKey]) -> None:
        self.entries = tuple(entries)
        names = [entry.name for entry in self.entries]
        self.keys: tuple[EntryKey, ...] = tuple(
            (entry.name, entry.coordinates)
            if entry.coordinates and names.count(entry.name) > 1
            else entry.name
            for entry in self.entries
        )
        self._listed, self._names = frozenset(self.keys), frozenset(names)

    def matches(self, key: Key) -> list[EntryKey]:
        """Returns the listed keys of the entries that ``key`` names: none if nothing has such a key.

        Raises:
            TypeError: As `resolve_key`.
        """
        if isinstance(key, str) and (key in self._listed or key not in self._names):
            # Programs ask each sample for what only some have: no need to resolve the name.
            return [key] if key in self._listed else []
        try:
            wanted = resolve_key(key)
        except ValueError:
            return []
        return [
            listed
            for listed, entry in zip(self.keys, self.entries, strict=True)
            if entry.name == wanted.name
            and wanted.coordinates in (None, entry.coordinates)
            and wanted.precision in (None, entry.precision)
        ]


class ByQuantity(Mapping[EntryKey, V], Generic[V]):
    """A read-only mapping by quantity.

    Iteration yields names, and ``(name, coordinates)`` for a quantity in several coordinate systems. Every
    `Key` that names exactly one of the entries can be looked up and is ``in`` the mapping.

    Args:
        index: Finds the entries.
        values: The value of each entry of ``index``.
        holder: What the entries belong to, for error messages: ``"log"``.
    """

    def __init__(self, index: KeyIndex, values: Iterable[V], holder: str) -> None:
        self._index = index
        self._values = dict(zip(index.keys, values, strict=True))
        self._holder = holder

    def resolve(self, key: Key) -> EntryKey:
        """Returns the key of the one entry that ``key`` names.

        Raises:
            KeyError: No entry fits, or several do.
            TypeError: As `resolve_key`.
        """
        matches = self._index.matches(key)
        if not matches:
            raise KeyError(self._missing(key))
        if len(matches) > 1:
            # Only entries with the same name are several: their keys are pairs.
            choices = " or ".join(
                f"{self._holder}[{', '.join(map(repr, match))}]" for match in matches
            )
            raise KeyError(
                f"{key!r} is in this {self._holder} in several coordinate systems: {choices}"
            )
        return matches[0]

    def _missing(self, key: Key) -> str:
        hint = f"it has {', '.join(map(repr, self)) or 'no quantities'}"
        if isinstance(key, str):
            hint = _suggestion(key, (entry.name for entry in self._index.entries), hint)
        return f"no {key!r} in this {self._holder}; {hint}"

    def __getitem__(self, key: Key) -> V:
        return self._values[self.resolve(key)]

    @overload
    def get(self, key: Key, /) -> V | None: ...
    @overload
    def get(self, key: Key, /, default: V | D) -> V | D: ...
    def get(self, key: Key, /, default: Any = None) -> Any:
        """Returns the value, or ``default`` if ``key`` does not name exactly one entry."""
        return self[key] if len(self._index.matches(key)) == 1 else default

    def __contains__(self, key: object) -> bool:
        try:
            return len(self._index.matches(key)) == 1  # type: ignore[arg-type]
        except TypeError:
            return False

    def __iter__(self) -> Iterator[EntryKey]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    # Views of the dict and not of the mapping: the length of a subclass may be that of something else.

    def keys(self) -> KeysView[EntryKey]:
        """Returns the key of each entry."""
        return self._values.keys()

    def values(self) -> ValuesView[V]:
        """Returns the value of each entry."""
        return self._values.values()

    def items(self) -> ItemsView[EntryKey, V]:
        """Returns the key and value of each entry."""
        return self._values.items()
