"""The formats of other software that ``xbus decode`` writes, and their options."""

from __future__ import annotations

import functools
import importlib
import os
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from xbus.cli.number_type import NumberRange

if TYPE_CHECKING:
    from xbus.export.format import Format

__all__ = ["EXPORTS", "FormatOptions", "format_options", "suffix_of"]

#: The class of each format by suffix, as module and name: imported when it is used.
EXPORTS: dict[str, tuple[str, str]] = {
    ".mat": ("xbus.export.matlab", "Matlab"),
    ".h5": ("xbus.export.hdf5", "Hdf5"),
    ".xlsx": ("xbus.export.excel", "Excel"),
    ".gpx": ("xbus.export.gpx", "Gpx"),
    ".kml": ("xbus.export.kml", "Kml"),
    ".geojson": ("xbus.export.geojson", "GeoJson"),
    ".sto": ("xbus.export.sto", "Sto"),
    ".txt": ("xbus.export.mt_manager", "MtManager"),
    ".nmea": ("xbus.export.nmea", "Nmea"),
    ".mcap": ("xbus.export.ros.mcap", "Mcap"),
    ".rrd": ("xbus.export.rerun.rrd", "Rrd"),
}

#: The suffixes of maps.
MAPS = (".gpx", ".kml", ".geojson")

#: For each option of the command the suffixes that it applies to, and the option. Its name is that of an
#: attribute of their classes.
OPTIONS: dict[str, tuple[tuple[str, ...], Callable[..., Any]]] = {
    "source": (
        (*MAPS, ".nmea"),
        click.option(
            "--source",
            type=click.Choice(["filter", "gnss"]),
            help="Positions on a map or in sentences: of the filter (lat_lon and altitude) or of the GNSS "
            "receiver (gnss_pvt_data).  [default: filter if IN has its positions; gnss for .nmea]",
        ),
    ),
    "every_seconds": (
        MAPS,
        click.option(
            "--every-seconds",
            type=NumberRange(min=0, min_open=True),
            metavar="SECONDS",
            help="On a map, leave out points that are closer in time to the previous one.",
        ),
    ),
    "every_metres": (
        MAPS,
        click.option(
            "--every-metres",
            type=NumberRange(min=0, min_open=True),
            metavar="METRES",
            help="On a map, leave out points that are closer to the previous one.",
        ),
    ),
    "sto_names": (
        (".sto",),
        click.option(
            "--sto-names",
            metavar="ID=NAME,...",
            help="Names of the devices for OpenSim, by device identifier: 0080001E=pelvis,0080001F=torso.",
        ),
    ),
    "mtm": (
        (".txt",),
        click.option(
            "--mtm",
            type=click.Choice(["2022", "4.8", "4.x", "3.x"]),
            default="2022",
            show_default=True,
            help="Generation of MT Manager whose text format .txt has.",
        ),
    ),
    "separator": (
        (".txt",),
        click.option(
            "--separator",
            type=click.Choice(["tab", "comma", "semicolon", "space"]),
            default="tab",
            show_default=True,
            help="Separator between the columns of a .txt file.",
        ),
    ),
    "missing": (
        (".txt",),
        click.option(
            "--missing",
            metavar="TEXT",
            help="Text in place of a missing value in a .txt file.  [default: NaN for --mtm 2022, otherwise "
            "nothing]",
        ),
    ),
    "ros_style": (
        (".mcap",),
        click.option(
            "--ros-style",
            type=click.Choice(["rep", "driver"]),
            default="rep",
            show_default=True,
            help="Messages that follow REP-103, 105 and 145, or those of the vendor's ROS 2 driver.",
        ),
    ),
    "rosbag2": (
        (".mcap",),
        click.option(
            "--rosbag2",
            is_flag=True,
            is_eager=True,  # -o depends on it
            help="Write a new folder of rosbag2 named OUT: an .mcap file and its metadata.yaml.",
        ),
    ),
    "frame_id": (
        (".mcap",),
        click.option(
            "--frame-id",
            metavar="NAME",
            default="imu_link",
            show_default=True,
            help="Frame id of the sensor.",
        ),
    ),
    "topic_prefix": (
        (".mcap",),
        click.option(
            "--topic-prefix",
            metavar="NAME",
            default="",
            help="Prefix of the names of ROS topics: /imu1.",
        ),
    ),
    "keep_coordinates": (
        (".mcap",),
        click.option(
            "--keep-coordinates",
            is_flag=True,
            help="Keep NED and NWU instead of converting them to ENU; frame ids say so: imu_link_ned.",
        ),
    ),
    "mag_norm": (
        (".mcap",),
        click.option(
            "--mag-norm",
            type=float,
            metavar="TESLA",
            help="Scale the magnetic field: tesla of its norm at calibration, such as 49e-6.",
        ),
    ),
    "compression": (
        (".mcap",),
        click.option(
            "--compression",
            type=click.Choice(["zstd", "lz4", "none"]),
            default="zstd",
            show_default=True,
            help="Compression of an .mcap file.",
        ),
    ),
}


def suffix_of(path: str) -> str:
    """Returns the suffix of a path, in lower case."""
    return os.path.splitext(path)[1].lower()  # noqa: PTH122 - pathlib is slow to import


def _option(name: str) -> str:
    """Returns the option with a name in Python."""
    return "--" + name.replace("_", "-")


def _with_options(message: str) -> str:
    """Replaces the names of attributes in a message; names of one word may be words of its sentence."""
    names = "|".join(name for name in OPTIONS if "_" in name)
    return re.sub(rf"\b({names})\b", lambda found: _option(found[0]), message)


@dataclass(frozen=True)
class FormatOptions:
    """The options that apply to some formats only.

    Attributes:
        values: The value of each option, by its name.
        given: The names of those on the command line.
    """

    values: dict[str, Any] = field(default_factory=dict)
    given: frozenset[str] = frozenset()

    @property
    def writes_folder(self) -> bool:
        """Whether the format is a folder."""
        return bool(self.values.get("rosbag2"))

    def suffix(self, out: str) -> str:
        """Returns the suffix that determines the format of OUT; a folder of rosbag2 may have any name."""
        return ".mcap" if self.writes_folder else suffix_of(out)

    def check(self, suffix: str) -> None:
        """Checks that the options on the command line apply to a format, and to each other.

        Raises:
            UsageError: One does not.
        """
        for name in sorted(self.given):
            suffixes, _ = OPTIONS[name]
            if suffix not in suffixes:
                raise click.UsageError(
                    f"{_option(name)} applies to {' and '.join(suffixes)}, not to {suffix}"
                )
        try:
            self.format_of(suffix)
        except ValueError as error:
            raise click.UsageError(_with_options(str(error))) from error

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
