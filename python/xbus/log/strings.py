"""The string outputs of a log."""

from __future__ import annotations

import datetime
from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.export import tables
from xbus.log.arrays import identical, read_only
from xbus.log.arrivals import HostTimes
from xbus.log.messages import piece
from xbus.protocol.strings import STRING_FIELDS
from xbus.protocol.values import StringType
from xbus.wire.strings import String, one_type, string_types, type_at

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["Strings"]


class Strings(Sequence[String]):
    """The string outputs of a log, in order. Each `String` is made on access.

    Can be pickled; two are equal if all strings and their host times are.

    Attributes:
        offset: Byte offsets in the input at which the strings begin, ``(n,)`` int64, read-only as all
            arrays here.
        sample: Index of the next sample after each string, ``(n,)`` int64.
    """

    def __init__(
        self,
        place: npt.NDArray[np.uint8],
        offset: npt.NDArray[np.int64],
        sample: npt.NDArray[np.int64],
        ends: npt.NDArray[np.uint64],
        data: npt.NDArray[np.uint8],
        host_times: HostTimes | None = None,
    ) -> None:
        self.offset, self.sample = read_only(offset), read_only(sample)
        self._place, self._ends, self._bytes = read_only(place), read_only(ends), read_only(data)
        self._host_times = host_times

    def __len__(self) -> int:
        return len(self._place)

    @overload
    def __getitem__(self, index: int) -> String: ...
    @overload
    def __getitem__(self, index: slice) -> list[String]: ...
    def __getitem__(self, index: int | slice) -> String | list[String]:
        if isinstance(index, slice):
            return [self[row] for row in range(*index.indices(len(self)))]
        row = range(len(self))[index]
        kind = type_at(int(self._place[row]))
        data = piece(self._bytes, self._ends, row)
        return String(kind, data, int(self.offset[row]), int(self.sample[row]))

    @property
    def counts(self) -> dict[str, int]:
        """Number of strings by name; the name of those that the manual does not list is empty."""
        places, counts = np.unique(self._place, return_counts=True)
        kinds = [type_at(place) for place in places.tolist()]
        names = ["" if kind is None else str(kind.name) for kind in kinds]
        return dict(zip(names, counts.tolist(), strict=True))

    @cached_property
    def end(self) -> npt.NDArray[np.int64]:
        """Byte offsets in the input at which the strings end, ``(n,)`` int64."""
        sizes = np.diff(self._ends.astype(np.int64), prepend=0)
        return read_only(np.asarray(self.offset + sizes, np.int64))

    @cached_property
    def host_time(self) -> npt.NDArray[np.float64]:
        """When the last byte of each arrived, seconds since 1970, ``(n,)`` float64; NaN if not known.

        From the side file of a recording; see `Log.host_time`.
        """
        if self._host_times is None:
            return read_only(np.full(len(self), np.nan))
        return self._host_times.strings

    def named(self, *kinds: StringType | str) -> list[String]:
        """Returns the strings of these types."""
        return [self[index] for index in self._indices(kinds).tolist()]

    def _indices(self, kinds: Iterable[StringType | str]) -> npt.NDArray[np.int64]:
        places = [kind.bit_length() - 1 for kind in string_types(kinds)]
        return np.flatnonzero(np.isin(self._place, places))

    def table(self, kind: StringType | str) -> npt.NDArray[Any]:
        """Returns all strings of a type as a structured array ``(n,)``, one row per string, read-only.

        The fields are ``index`` (in this sequence), ``sample``, ``host_time``, and those of the type:
        numbers as float64 in their units, times of day as ``timedelta64[us]``, dates as ``datetime64[D]``,
        letters as text. A value that is not available is NaN, NaT or the empty text; so is every value of a
        string whose fields do not fit its type.

        Raises:
            ValueError: No string type has this name.

        >>> import xbus
        >>> log = xbus.read_log(xbus.encode_string("HEHDT", {"heading": 12.5}) * 3)
        >>> log.strings.table("HEHDT")["heading"]
        array([12.5, 12.5, 12.5])
        """
        one = one_type(kind)
        fields = [field for field in STRING_FIELDS[one].fields if field.name]
        indices = self._indices([one])
        rows: list[dict[str, Any]] = []
        for index in indices.tolist():
            try:
                rows.append(self[index].values)
            except ValueError:
                rows.append({})
        dtypes = {field.name: field.form.dtype for field in fields}
        columns = {
            name: np.array([_cell(row.get(name), dtype) for row in rows], dtype)
            for name, dtype in dtypes.items()
        }
        head = [("index", "i8"), ("sample", "i8"), ("host_time", "f8")]
        table = np.zeros(
            len(indices), [*head, *((name, column.dtype) for name, column in columns.items())]
        )
        table["index"], table["sample"] = indices, self.sample[indices]
        table["host_time"] = self.host_time[indices]
        for name, column in columns.items():
            table[name] = column
        return read_only(table)

    def to_arrow(self, kind: StringType | str) -> pa.Table:
        """Returns `table` as a pyarrow table, with nulls for values that are not available.

        The fields' metadata have the units.

        Raises:
            ImportError: The extra ``arrow`` is not installed.
            ValueError: No string type has this name.
        """
        table: pa.Table = tables.arrow(self.arrow_stream(kind))
        return table

    def arrow_stream(self, kind: StringType | str) -> _core.ArrowStream:
        """Returns the table of `to_arrow` as a stream for libraries that speak the Arrow C interface."""
        table = self.table(kind)
        units = {field.name: field.unit for field in STRING_FIELDS[one_type(kind)].fields}
        return tables.stream_of(
            (name, table[name], {"unit": units[name]} if units.get(name) else {})
            for name in table.dtype.names or ()
        )

    def _arrays(self) -> tuple[npt.NDArray[Any], ...]:
        return self._place, self.offset, self.sample, self._ends, self._bytes

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Strings):
            return NotImplemented
        return all(map(identical, self._arrays(), other._arrays())) and identical(
            self.host_time, other.host_time
        )

    __hash__ = None  # type: ignore[assignment]

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (self.host_time, *self._arrays())

    def __repr__(self) -> str:
        kinds = ", ".join(f"{name or 'others'}: {count}" for name, count in self.counts.items())
        return f"<Strings {len(self)}: {kinds}>" if kinds else "<Strings 0>"


def _unpickled(host_time: npt.NDArray[np.float64], *arrays: Any) -> Strings:
    strings = Strings(*arrays)
    strings.host_time = read_only(host_time)
    return strings


def _cell(value: Any, dtype: str) -> Any:
    if value is None:
        return np.nan if dtype == "f8" else "" if dtype[0] == "U" else np.array("NaT", dtype)
    if isinstance(value, datetime.time):
        seconds = (value.hour * 60 + value.minute) * 60 + value.second
        return np.timedelta64(seconds * 10**6 + value.microsecond, "us")
    return value
