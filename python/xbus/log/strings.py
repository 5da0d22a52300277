"""The string outputs of a log."""

from __future__ import annotations

import datetime
from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.extras import require
from xbus.log.arrivals import Arrivals
from xbus.protocol.strings import LAYOUTS
from xbus.protocol.values import StringType
from xbus.wire.strings import String, one_type, string_types, type_at

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["Strings"]


class Strings(Sequence[String]):
    """The string outputs of a log, in order; each is made when it is asked for.

    Attributes:
        offset: Where each begins, in bytes from the start of the input, ``(n,)`` int64.
        sample: Index of the next sample, ``(n,)`` int64.
    """

    def __init__(self, core: _core.Part, arrivals: Arrivals | None = None) -> None:
        strings = core.strings
        self.offset, self.sample = strings.offset, strings.sample
        self._place, self._ends, self._bytes = strings.place, strings.ends, strings.data
        self._arrivals = arrivals

    def __len__(self) -> int:
        return len(self._place)

    @overload
    def __getitem__(self, index: int) -> String: ...
    @overload
    def __getitem__(self, index: slice) -> list[String]: ...
    def __getitem__(self, index: int | slice) -> String | list[String]:
        if isinstance(index, slice):
            return [self[it] for it in range(*index.indices(len(self)))]
        at = range(len(self))[index]
        start = int(self._ends[at - 1]) if at else 0
        data = self._bytes[start : int(self._ends[at])].tobytes()
        kind = type_at(int(self._place[at]))
        return String(kind, data, int(self.offset[at]), int(self.sample[at]))

    @property
    def counts(self) -> dict[str, int]:
        """How many there are, by name; the name of those that the manual does not list is empty."""
        places, counts = np.unique(self._place, return_counts=True)
        kinds = [type_at(it) for it in places.tolist()]
        names = ["" if it is None else str(it.name) for it in kinds]
        return dict(zip(names, counts.tolist(), strict=True))

    @cached_property
    def end(self) -> npt.NDArray[np.int64]:
        """Where each ends, in bytes from the start of the input, ``(n,)`` int64."""
        ends = np.concatenate([[0], self._ends.astype(np.int64)])
        end = np.asarray(self.offset + np.diff(ends), np.int64)
        end.flags.writeable = False
        return end

    @cached_property
    def host_time(self) -> npt.NDArray[np.float64]:
        """When the last byte of each came, seconds since 1970, ``(n,)`` float64; NaN where that is unknown.

        From the side file of a recording; see `Log.host_time`.
        """
        times = np.full(len(self), np.nan)
        if self._arrivals is not None:
            arrived = self._arrivals.of(self.end)
            times[: len(arrived)] = arrived / 1e9
        times.flags.writeable = False
        return times

    def named(self, *kinds: StringType | str) -> list[String]:
        """The strings of these types."""
        return [self[it] for it in self._indices(kinds).tolist()]

    def _indices(self, kinds: Iterable[StringType | str]) -> npt.NDArray[np.int64]:
        places = [it.bit_length() - 1 for it in string_types(kinds)]
        return np.flatnonzero(np.isin(self._place, places))

    def table(self, kind: StringType | str) -> npt.NDArray[Any]:
        """All strings of a type, a row each, in order: ``(n,)``, structured.

        The fields are ``index`` (in this sequence), ``sample``, ``host_time``, and those of the type: numbers
        as float64 in their units, times of day as ``timedelta64[us]``, dates as ``datetime64[D]``, letters as
        text. NaN, NaT and the empty text are what is not available, and all that a string says whose fields
        are not those of its type.

        Raises:
            ValueError: No such string.

        >>> import xbus
        >>> log = xbus.read_log(xbus.encode_string("HEHDT", {"heading": 12.5}) * 3)
        >>> log.strings.table("HEHDT")["heading"]
        array([12.5, 12.5, 12.5])
        """
        one = one_type(kind)
        fields = [it for it in LAYOUTS[one].fields if it.name]
        indices = self._indices([one])
        rows: list[dict[str, Any]] = []
        for index in indices.tolist():
            try:
                rows.append(self[index].values)
            except ValueError:
                rows.append({})
        columns = {
            it.name: np.array(
                [_cell(row.get(it.name), it.form.dtype) for row in rows], it.form.dtype
            )
            for it in fields
        }
        dtype = [("index", "i8"), ("sample", "i8"), ("host_time", "f8")]
        table = np.zeros(
            len(indices), [*dtype, *((it, made.dtype) for it, made in columns.items())]
        )
        table["index"], table["sample"] = indices, self.sample[indices]
        table["host_time"] = self.host_time[indices]
        for name, made in columns.items():
            table[name] = made
        table.flags.writeable = False
        return table

    def to_arrow(self, kind: StringType | str) -> pa.Table:
        """`table` as a pyarrow table: nulls for what is not available, units in the fields' metadata.

        Raises:
            ImportError: The extra ``arrow`` is not installed.
            ValueError: No such string.
        """
        arrow = require("pyarrow", "arrow", "to make Arrow tables")
        table = self.table(kind)
        units = {it.name: it.unit for it in LAYOUTS[one_type(kind)].fields}
        columns, fields = [], []
        for name in table.dtype.names or ():
            # Empty texts, too, stand for what is not available.
            values: Any = table[name]
            kind_of = {"U": arrow.string(), "m": arrow.time64("us")}.get(values.dtype.kind)
            if values.dtype.kind == "U":
                values = [it or None for it in values.tolist()]
            elif values.dtype.kind == "m":
                # A time of day, which Arrow does not take for a duration.
                values = np.ma.masked_array(values.astype(np.int64), np.isnat(values))
            column = arrow.array(values, kind_of, from_pandas=True)
            unit = {"unit": units[name]} if units.get(name) else None
            fields.append(arrow.field(name, column.type, metadata=unit))
            columns.append(column)
        made: pa.Table = arrow.table(columns, schema=arrow.schema(fields))
        return made

    def __repr__(self) -> str:
        kinds = ", ".join(f"{name or 'others'}: {count}" for name, count in self.counts.items())
        return f"<Strings {len(self)}: {kinds}>" if kinds else "<Strings 0>"


def _cell(value: Any, dtype: str) -> Any:
    if value is None:
        return np.nan if dtype == "f8" else "" if dtype[0] == "U" else np.array("NaT", dtype)
    if isinstance(value, datetime.time):
        seconds = (value.hour * 60 + value.minute) * 60 + value.second
        return np.timedelta64(seconds * 10**6 + value.microsecond, "us")
    return value
