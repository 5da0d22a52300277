"""The plots of each quantity: a panel has one unit and a curve for each component."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from xbus.export.part import PartColumn
from xbus.export.valid import has_fix
from xbus.plots.thin import FloatArray
from xbus.protocol.tables import COLUMN_QUANTITIES

__all__ = ["MAGNETIC", "PlottedColumn", "Rows", "has_panels", "label", "panel_rows"]

#: Plots of struct quantities: title, unit and fields. Other structs have no plot.
STRUCT_PANELS: dict[str, list[tuple[str, str, tuple[str, ...]]]] = {
    "gnss_pvt_data": [
        ("fix type and satellites", "", ("fixtype", "numSV")),
        ("stated accuracy", "m", ("hAcc", "vAcc")),
        ("height", "m", ("height", "hMSL")),
        ("velocity", "m/s", ("velN", "velE", "velD", "gSpeed", "sAcc")),
        ("dilution of precision", "", ("pdop", "hdop", "vdop", "tdop")),
    ],
    "gps_dop": [("", "", ("pdop", "hdop", "vdop", "tdop"))],
    "raw_acc_gyr_mag_temp": [
        ("accelerometer", "counts", ("accX", "accY", "accZ")),
        ("gyroscope", "counts", ("gyrX", "gyrY", "gyrZ")),
        ("magnetometer", "counts", ("magX", "magY", "magZ")),
        ("temperature", "degC", ("Temp",)),
    ],
    "trigger_in1": [("polarity", "", ("polarity",))],
    "trigger_in2": [("polarity", "", ("polarity",))],
    "trigger_in3": [("polarity", "", ("polarity",))],
}
#: Plots of ``gnss_pvt_data`` that are valid without a fix.
VALID_WITHOUT_FIX = ("fix type and satellites",)
#: Quantities with a curve of their norm.
MAGNETIC = ("magnetic_field", "magnetic_field_corrected")


class PlottedColumn(PartColumn, Protocol):
    """A quantity to plot; see `xbus.log.column.Column`."""

    @property
    def satellites(self) -> npt.NDArray[Any]:
        """One row for each satellite of ``gnss_sat_info``."""
        ...

    @property
    def offsets(self) -> npt.NDArray[np.int64]:
        """Index into `satellites` at which each row begins, and their number at the end."""
        ...


class Rows(NamedTuple):
    """The rows of one panel: its title, its unit, the names of its curves, and values ``(N, k)``."""

    title: str
    unit: str
    names: tuple[str, ...]
    values: npt.NDArray[Any]


def label(name: str, title: str, unit: str) -> str:
    """Returns the text at the vertical axis of a panel of the quantity ``name``.

    >>> label("acceleration", "", "m/s2"), label("gnss_pvt_data", "height", "m")
    ('acceleration, m/s2', 'height, m')
    """
    return ", ".join(filter(None, (title or name, unit)))


def has_panels(name: str) -> bool:
    """Returns whether a quantity has a plot. Time stamps, identifiers and words of bits have none.

    >>> has_panels("acceleration"), has_panels("status_word")
    (True, False)
    """
    row = COLUMN_QUANTITIES[name]
    if row.fields:
        return name in STRUCT_PANELS or name == "gnss_sat_info"
    return row.group != "Timestamp" and row.kind != "id" and not row.has_flags


def panel_rows(column: PlottedColumn) -> Iterator[Rows]:
    """Yields the rows of each panel of a quantity; none for a quantity without a plot."""
    name = column.name
    if not has_panels(name):
        return
    if name == "gnss_sat_info":
        yield Rows("satellites", "", ("numSvs",), column.values["numSvs"][:, None])
        if len(column.satellites):
            yield Rows("signal strength", "dBHz", ("minimum", "mean", "maximum"), _signals(column))
    elif name in STRUCT_PANELS:
        for title, unit, fields in STRUCT_PANELS[name]:
            values = np.stack([column.scaled[field] for field in fields], axis=1)
            if name == "gnss_pvt_data" and title not in VALID_WITHOUT_FIX:
                # Without a fix the other fields are arbitrary.
                values = np.where(has_fix(column.values)[:, None], values, np.nan)
            yield Rows(title, unit, fields, values)
    elif name == "lat_lon":
        # On a common axis both would be flat.
        for at, title in enumerate(("latitude", "longitude")):
            yield Rows(title, column.unit, (column.fields[at],), column.values[:, at : at + 1])
    else:
        names = column.fields or (name,)
        values = column.values.reshape(len(column), len(names))
        if name in MAGNETIC:
            # The norm is constant in a field without disturbances, however the device turns.
            norm = np.linalg.norm(values, axis=1, keepdims=True)
            names, values = (*names, "norm"), np.concatenate((values, norm), axis=1)
        if name == "velocity_xyz":
            # In all coordinate systems, z is vertical.
            speed = np.linalg.norm(values[:, :2], axis=1, keepdims=True)
            names, values = (*names, "speed"), np.concatenate((values, speed), axis=1)
        yield Rows("", column.unit, names, values)


def _signals(column: PlottedColumn) -> FloatArray:
    """Returns minimum, mean and maximum C/N0 of the satellites of each row; NaN without satellites."""
    signals = column.satellites["cno"].astype(np.float64)
    starts, ends = column.offsets[:-1], column.offsets[1:]
    found = np.full((len(starts), 3), np.nan)
    some = ends > starts
    for at, reduce in enumerate((np.minimum, np.add, np.maximum)):
        found[some, at] = reduce.reduceat(signals, starts[some])
    found[some, 1] /= (ends - starts)[some]
    return found
