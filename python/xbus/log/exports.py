"""The methods that write a log in the formats of other software."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Literal

from xbus.export.format import export
from xbus.export.part import Part

__all__ = ["Exports"]


class Exports:
    """Exports of a log. Each method imports its format when it is called."""

    def to_gpx(
        self: Part,
        path: str | os.PathLike[str],
        *,
        source: Literal["filter", "gnss"] | None = None,
        every_seconds: float | None = None,
        every_metres: float | None = None,
    ) -> None:
        """Writes the tracks of the devices to a GPX file, which appears whole or not at all.

        Args:
            path: Path of the file.
            source: ``"filter"`` for ``lat_lon`` (or ``position_ecef``) and altitude, ``"gnss"`` for
                ``gnss_pvt_data``. Default: the filter if the log has its positions.
            every_seconds: Shortest time between two points of a segment in s.
            every_metres: Shortest distance between two points of a segment in m.

        Raises:
            ExportError: The log has no positions with a fix; a ValueError.
            OSError: The file cannot be written.
        """
        from xbus.export.gpx import Gpx

        export(Gpx(source, every_seconds, every_metres), self, [self], path)

    def to_kml(
        self: Part,
        path: str | os.PathLike[str],
        *,
        source: Literal["filter", "gnss"] | None = None,
        every_seconds: float | None = None,
        every_metres: float | None = None,
    ) -> None:
        """Writes the tracks of the devices to a KML file. Arguments and errors are those of `to_gpx`."""
        from xbus.export.kml import Kml

        export(Kml(source, every_seconds, every_metres), self, [self], path)

    def to_geojson(
        self: Part,
        path: str | os.PathLike[str],
        *,
        source: Literal["filter", "gnss"] | None = None,
        every_seconds: float | None = None,
        every_metres: float | None = None,
    ) -> None:
        """Writes the tracks of the devices to a GeoJSON file. Arguments and errors are those of `to_gpx`."""
        from xbus.export.geojson import GeoJson

        export(GeoJson(source, every_seconds, every_metres), self, [self], path)

    def to_sto(
        self: Part, path: str | os.PathLike[str], *, names: Mapping[str, str] | None = None
    ) -> None:
        """Writes the orientations of the devices for OpenSim, to a file that appears whole or not at all.

        Args:
            path: Path of the file.
            names: Names of the devices, by device identifier as printed on the device:
                ``{"0080001E": "pelvis"}``. The columns are ``pelvis_imu`` and so on.

        Raises:
            ExportError: The log has no orientation, or a device restarts; a ValueError.
            ValueError: A name that OpenSim cannot read, or two that are the same.
            OSError: The file cannot be written.
        """
        from xbus.export.sto import Sto

        pairs = [f"{device}={name}" for device, name in (names or {}).items()]
        export(Sto(",".join(pairs) or None), self, [self], path)

    def to_mt_manager(
        self: Part,
        path: str | os.PathLike[str],
        *,
        mtm: Literal["2022", "4.8", "4.x", "3.x"] = "2022",
        separator: Literal["tab", "comma", "semicolon", "space"] = "tab",
        missing: str | None = None,
    ) -> None:
        """Writes the text that MT Manager exports, a file for each device; they appear all or not at all.

        Args:
            path: Path of the file. For several devices, ``walk.txt`` stands for ``walk_0080001E.txt`` and so
                on.
            mtm: Generation of MT Manager, which decides header and names of columns.
            separator: What stands between columns.
            missing: Text for a missing value. Default: NaN for 2022, otherwise nothing.

        Raises:
            ExportError: The log has none of the quantities, or one in several coordinates, or the header
                needs a rate and there are no time stamps; a ValueError.
            ValueError: An option that does not fit.
            OSError: A file cannot be written.
        """
        from xbus.export.mt_manager import MtManager

        export(MtManager(mtm, separator, missing), self, [self], path)

    def to_mat(self: Part, path: str | os.PathLike[str]) -> None:
        """Writes a MATLAB file with a struct for each quantity, which appears whole or not at all.

        Each struct has ``values``, ``time``, ``sample`` and ``unit``, and ``samples`` has what every sample
        has: ``time``, ``utc``, ``packet_counter``, ``bid``. With more than 64 MiB of numbers, the file has
        version 7.3.

        Args:
            path: Path of the file.

        Raises:
            ImportError: The extra ``matlab`` is not installed.
            OSError: The file cannot be written.
        """
        from xbus.export.matlab import Matlab

        export(Matlab(), self, [self], path)

    def to_hdf5(self: Part, path: str | os.PathLike[str]) -> None:
        """Writes an HDF5 file with a group for each quantity, which appears whole or not at all.

        The groups have the same arrays as the structs of `to_mat`; units and coordinates are attributes.

        Args:
            path: Path of the file.

        Raises:
            ImportError: The extra ``hdf5`` is not installed.
            OSError: The file cannot be written.
        """
        from xbus.export.hdf5 import Hdf5

        export(Hdf5(), self, [self], path)

    def to_excel(self: Part, path: str | os.PathLike[str]) -> None:
        """Writes an Excel workbook with one row for each sample, which appears whole or not at all.

        The first row has names and the second one units; UTC is a date. Numbers have 16 digits.

        Args:
            path: Path of the file.

        Raises:
            ExportError: The log has more than 1,048,574 samples; a ValueError.
            ImportError: The extra ``excel`` is not installed.
            OSError: The file cannot be written.
        """
        from xbus.export.excel import Excel

        export(Excel(), self, [self], path)

    def to_nmea(
        self: Part,
        path: str | os.PathLike[str],
        *,
        source: Literal["filter", "gnss"] | None = None,
    ) -> None:
        """Writes the strings of the log as NMEA text, or sentences made from its samples if it has none.

        Made are GGA, RMC, HDT and ZDA. A TXT sentence at the beginning says so.

        Args:
            path: Path of the file.
            source: Positions as in `to_gpx`. Default: those of the receiver if the log has them.

        Raises:
            ExportError: The log has neither strings, nor position or orientation of one device; a ValueError.
            OSError: The file cannot be written.
        """
        from xbus.export.nmea import Nmea

        export(Nmea(source), self, [self], path)

    def to_mcap(
        self: Part,
        path: str | os.PathLike[str],
        *,
        ros_style: Literal["rep", "driver"] = "rep",
        frame_id: str = "imu_link",
        topic_prefix: str = "",
        keep_coordinates: bool = False,
        mag_norm: float | None = None,
        compression: Literal["zstd", "lz4", "none"] = "zstd",
    ) -> None:
        """Writes messages of ROS 2 to an MCAP file, which appears whole or not at all.

        Args:
            path: Path of the file.
            ros_style: ``"rep"`` for messages that follow REP-103, 105 and 145, or ``"driver"`` for those that
                the vendor's ROS 2 driver publishes for the same samples.
            frame_id: Frame id of the sensor.
            topic_prefix: What the names of topics begin with: ``"/imu1"``.
            keep_coordinates: Keep NED and NWU instead of converting them to ENU; frame ids end with
                ``_ned`` or ``_nwu``. For the style ``"rep"``.
            mag_norm: Tesla of one unit of the magnetic field, such as 49e-6; None to keep the sensor's unit.
                For the style ``"rep"``.
            compression: How the file is compressed.

        Raises:
            ExportError: The log has nothing that messages can hold, or coordinates in several systems are
                to be kept; a ValueError.
            ValueError: An argument that is no name of ROS, or excludes another one.
            OSError: The file cannot be written.

        >>> import tempfile, xbus
        >>> log = xbus.read_log("tests/captures/walk.mtb")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     log.to_mcap(f"{folder}/walk.mcap", topic_prefix="/imu1")
        """
        from xbus.export.ros.mcap import Mcap

        file_format = Mcap(
            ros_style, frame_id, topic_prefix, keep_coordinates, mag_norm, compression
        )
        export(file_format, self, [self], path)

    def to_rosbag2(
        self: Part,
        path: str | os.PathLike[str],
        *,
        ros_style: Literal["rep", "driver"] = "rep",
        frame_id: str = "imu_link",
        topic_prefix: str = "",
        keep_coordinates: bool = False,
        mag_norm: float | None = None,
        compression: Literal["zstd", "lz4", "none"] = "zstd",
    ) -> None:
        """Writes a folder of rosbag2: the file of `to_mcap` with its ``metadata.yaml``, whole or not at all.

        Args:
            path: Path of the folder, which must not exist.
            ros_style: As in `to_mcap`, like all others.
            frame_id: Frame id of the sensor.
            topic_prefix: What the names of topics begin with.
            keep_coordinates: Keep NED and NWU.
            mag_norm: Tesla of one unit of the magnetic field.
            compression: How the file is compressed.

        Raises:
            FileExistsError: There is something at ``path``. The other errors are those of `to_mcap`.
        """
        from xbus.export.ros.mcap import Mcap

        file_format = Mcap(
            ros_style, frame_id, topic_prefix, keep_coordinates, mag_norm, compression, rosbag2=True
        )
        export(file_format, self, [self], path)

    def to_rrd(self: Part, path: str | os.PathLike[str]) -> None:
        """Writes a file for the viewer rerun, which appears whole or not at all.

        It has the orientation in 3D, a series for each component or field of a quantity, positions on a map,
        and a log of restarts, gaps, damage, messages and changes of the status. Entities are below the
        identifier of their device, timelines are ``sample``, ``device_time``, ``utc`` and ``host_time``.

        Args:
            path: Path of the file.

        Raises:
            ImportError: The extra ``rerun`` is not installed.
            OSError: The file cannot be written.
        """
        from xbus.export.rerun.rrd import Rrd

        export(Rrd(), self, [self], path)
