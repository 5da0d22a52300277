"""One quantity of a log."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from xbus import _core
from xbus.log.arrivals import HostTimes
from xbus.protocol.tables import QUANTITIES, STATUS_FLAGS, Field, Quantity

__all__ = ["Column", "Flags"]


class Column:
    """Every packet of one quantity, one row each, in the order in which they were received.

    Get it from a log: ``log["acceleration"]``. Arrays are read-only views of what was decoded;
    copy one to change it.

    Attributes:
        name: Name of the quantity, as in the manual, in snake_case.
        unit: Unit of the values, empty where there is none.
        fields: Names of the components of a row, in the order of the values' last axes; of the
            fields of a struct; empty for a scalar.
        precision: ``"Float32"``, ``"Fp1220"``, ``"Fp1632"`` or ``"Float64"``; None where precisions
            are mixed and for integers.
        coordinates: ``"ENU"``, ``"NED"`` or ``"NWU"``; None where the manual defines none.
        data_id: Data identifier as received, or the base identifier where several were.

    >>> import xbus
    >>> log = xbus.read_log("tests/captures/walk.mtb")
    >>> log["acceleration"].values.shape, log["acceleration"].unit
    ((1000, 3), 'm/s2')
    """

    def __init__(
        self, core: _core.Column, part: _core.Part, hosts: HostTimes | None = None
    ) -> None:
        self._core = core
        # Not the Log: a cycle would keep the parts of a long log in memory.
        self._part = part
        self._hosts = hosts or HostTimes(part)
        assert core.name is not None  # noqa: S101 - unknown identifiers are no columns
        self._row: Quantity = QUANTITIES[core.name]
        self.name: str = core.name
        self.unit: str = self._row.unit
        self.precision: str | None = core.precision
        self.coordinates: str | None = core.coordinates
        self.data_id: int = core.data_id

    @cached_property
    def fields(self) -> tuple[str, ...]:
        """Names of the components or fields of a row."""
        if self._row.fields:
            return tuple(it.name for it in self._row.fields)
        return tuple(sorted(self._row.components)) if self._is_matrix else self._row.components

    @property
    def _is_matrix(self) -> bool:
        return self.name == "rotation_matrix"

    def __len__(self) -> int:
        return len(self._core)

    @cached_property
    def values(self) -> npt.NDArray[Any]:
        """The numbers.

        Shape ``(N, k)`` for vectors, ``(N,)`` for scalars; float32 for Float32 and float64 for the
        three precisions that float64 holds exactly; integers keep their width. ``rotation_matrix``
        is ``(N, 3, 3)``, ``values[n, i, j]`` in row i and column j. Struct quantities are structured
        arrays ``(N,)`` of raw integers under the manual's field names.
        """
        flat: npt.NDArray[Any] = self._core.values
        if self._row.fields:
            return flat.view(_dtype(self._row.fields))
        if self._is_matrix:
            # Column by column on the wire (section 5.3.6).
            return flat.reshape(-1, 3, 3).transpose(0, 2, 1)
        return flat.reshape(-1, len(self._row.components)) if self._row.components else flat

    @cached_property
    def sample(self) -> npt.NDArray[np.int64]:
        """Which sample each row belongs to, ``(N,)`` int64, counted from the beginning of the log."""
        return _frozen(self._core.sample)

    @cached_property
    def time(self) -> npt.NDArray[np.float64]:
        """Seconds on the device clock, unwrapped, ``(N,)`` float64; NaN where the sample has none."""
        return _frozen(self._part.time[self.sample - self._part.first])

    @cached_property
    def host_time(self) -> npt.NDArray[np.float64]:
        """Seconds since 1970 by the clock of the host, ``(N,)`` float64: see `Log.host_time`."""
        return _frozen(self._hosts.time[self.sample - self._part.first])

    @cached_property
    def scaled(self) -> npt.NDArray[Any]:
        """The fields of a struct quantity in SI units and degrees, as a structured array ``(N,)``.

        Fields with a scale become float64, with NaN where the receiver says "not provided"; counts,
        dates and bits stay integers. Of other quantities these are the values.
        """
        return _frozen(_scaled(self.values, self._row.fields)) if self._row.fields else self.values

    @property
    def units(self) -> dict[str, str]:
        """The unit of each field of a struct quantity in ``scaled``; empty for counts and bits."""
        return {it.name: it.unit for it in self._row.fields}

    @cached_property
    def flags(self) -> Flags:
        """The bits of ``status_word`` or ``status_byte`` by name (Table 27).

        Raises:
            AttributeError: The quantity has no flags.
        """
        if self.name not in ("status_word", "status_byte"):
            raise AttributeError(f"{self.name} has no flags; status_word and status_byte have")
        return Flags(self.values)

    @cached_property
    def datetime(self) -> npt.NDArray[np.datetime64]:
        """``utc_time`` or ``gnss_pvt_data`` as ``datetime64[ns]``, ``(N,)``; NaT for an impossible date.

        Whether the device vouches for it is in ``values["valid"] & 7`` (Tables 35 and 25); `Log.utc` has
        those for which it does.

        Raises:
            AttributeError: The quantity is neither.
        """
        if (stamps := self._core.nanoseconds) is None:
            raise AttributeError(f"{self.name} has no datetime; utc_time and gnss_pvt_data have")
        return _frozen(stamps.view("datetime64[ns]"))

    @cached_property
    def satellites(self) -> npt.NDArray[Any]:
        """One structured row (gnssId, svId, cno, flags) for each satellite of ``gnss_sat_info``.

        Those of row ``n`` are ``satellites[offsets[n]:offsets[n + 1]]`` (Table 26).

        Raises:
            AttributeError: The quantity is not ``gnss_sat_info``.
        """
        if not self._row.entry:
            raise AttributeError(f"{self.name} has no satellites; gnss_sat_info has")
        return self._core.entries.view(_dtype(self._row.entry))

    @cached_property
    def offsets(self) -> npt.NDArray[np.int64]:
        """Where in ``satellites`` those of each row begin, ``(N + 1,)`` int64.

        Raises:
            AttributeError: The quantity is not ``gnss_sat_info``.
        """
        if not self._row.entry:
            raise AttributeError(f"{self.name} has no offsets; gnss_sat_info has")
        counts = self.values[self._row.fields[1].name]
        return _frozen(np.concatenate(([0], np.cumsum(counts, dtype=np.int64))))

    @property
    def rate(self) -> float:
        """Measured rows per second between the first and the last time stamp; NaN for under two."""
        stamped = self.time[np.isfinite(self.time)]
        if len(stamped) < 2 or stamped[-1] <= stamped[0]:
            return float("nan")
        return float((len(stamped) - 1) / (stamped[-1] - stamped[0]))

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """The column as an Arrow table: sample, time and the values, one row a packet."""
        return _core.ArrowStream.rows(self._core, self._hosts.known).__arrow_c_stream__(
            requested_schema
        )

    @property
    def _about(self) -> str:
        parts = [self.precision, self.coordinates, self.unit]
        return ", ".join(it for it in parts if it)

    def __repr__(self) -> str:
        about = f", {self._about}" if self._about else ""
        return f"<Column {self.name}: {self.values.shape} {_short(self.values.dtype)}{about}>"

    def _repr_html_(self) -> str:
        import html

        shown = 6
        rows = [
            (f"{t:.4f}", *np.atleast_1d(np.asarray(v).reshape(-1)).tolist())
            for t, v in zip(self.time[:shown], self.values[:shown], strict=False)
        ]
        if self._row.fields:
            rows = [(row[0], *row[1]) for row in rows]
        names = ("time", *(self.fields or (self.name,)))
        head = "".join(f"<th>{html.escape(it)}</th>" for it in names)
        body = "".join(
            "<tr>" + "".join(f"<td>{html.escape(str(it))}</td>" for it in row) + "</tr>"
            for row in rows
        )
        more = f"<p>{len(self) - shown} more rows</p>" if len(self) > shown else ""
        return f"<p>{html.escape(repr(self))}</p><table><tr>{head}</tr>{body}</table>{more}"


class Flags(Mapping[str, npt.NDArray[Any]]):
    """The bits of status words by name: bool arrays, uint8 where a field has several bits.

    Made when asked for: ``log["status_word"].flags["filter_valid"]``.
    """

    def __init__(self, words: npt.NDArray[Any]) -> None:
        self._words = words
        bits = 8 * words.dtype.itemsize
        self._flags = {it.name: it for it in STATUS_FLAGS if it.bit + it.width <= bits}

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        flag = self._flags[name]
        value = self._words >> flag.bit & ((1 << flag.width) - 1)
        return value.astype(bool if flag.width == 1 else np.uint8)

    def __iter__(self) -> Iterator[str]:
        return iter(self._flags)

    def __len__(self) -> int:
        return len(self._flags)

    def __repr__(self) -> str:
        counts = ", ".join(f"{name}: {np.count_nonzero(self[name])}" for name in self)
        return f"<Flags of {len(self._words)} words; set in: {counts}>"


def _frozen(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    array.flags.writeable = False
    return array


def _short(dtype: np.dtype[Any]) -> str:
    return "struct" if dtype.names else str(dtype)


def _dtype(fields: tuple[Field, ...]) -> np.dtype[Any]:
    return np.dtype([(it.name, it.type) for it in fields])


def _scaled(values: npt.NDArray[Any], fields: tuple[Field, ...]) -> npt.NDArray[Any]:
    scaled = [it for it in fields if it.scale != 1]
    dtype = [(it.name, "f8" if it in scaled else it.type) for it in fields]
    out = np.empty(len(values), dtype)
    for it in fields:
        raw = values[it.name]
        if it not in scaled:
            out[it.name] = raw
            continue
        # A power of ten is exact as a divisor, not as a factor.
        per_unit = round(1 / it.scale)
        out[it.name] = raw / per_unit
        if it.missing is not None:
            out[it.name][raw == it.missing] = np.nan
    return out
