"""The topics of the vendor's ROS 2 driver, and how their messages follow from samples.

Topics are in the order in which the driver publishes those of one sample.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from xbus.export.part import Part
from xbus.export.ros.cdr import DOUBLES, Layout, bare, stamped, transform
from xbus.export.ros.fixes import navsat_fields, navsat_rows, sentences
from xbus.export.ros.measured import Measured, Rows, columns_of, inner, outer, xyzw
from xbus.export.ros.stamps import END
from xbus.geometry import quaternion
from xbus.geometry.earth import geodetic_to_ecef
from xbus.protocol.tables import STATUS_FLAGS, UTC_VALID

__all__ = ["TOPICS", "Bodies", "Frames", "Style", "Topic"]

ORIENTATION = ("quaternion", "rotation_matrix", "euler_angles")
#: What the element 0 of a covariance is if a message has no measurement.
ABSENT = -1.0
#: Ticks of SampleTimeFine in a second, and nanoseconds of one.
TICKS, TICK = 10_000, 100_000
SECOND = 10**9
#: The flags of a status that the message does not have. It has all others, in their order.
LACKING = ("filter_input_start", "retransmitted", "interpolated")
FLAGS = [flag for flag in STATUS_FLAGS.values() if flag.name not in LACKING]


@dataclass(frozen=True)
class Style:
    """How measurements become messages.

    Attributes:
        is_driver: Whether messages are those of the vendor's driver; otherwise they follow the REPs.
        mag_norm: Tesla of one unit of the magnetic field, or None to keep the unit of the sensor.
    """

    is_driver: bool
    mag_norm: float | None = None


class Frames(NamedTuple):
    """The frame ids of a device.

    Attributes:
        sensor: The sensor.
        parent: The local frame, in transforms to the sensor.
        world: The local frame, in other messages.
        free: The local frame of free acceleration.
        earth: The Earth.
        antenna: The antenna of the GNSS receiver.
    """

    sensor: str
    parent: str
    world: str
    free: str
    earth: str
    antenna: str


class Bodies(NamedTuple):
    """The bodies of the messages of some samples.

    Attributes:
        sample: As in `Rows`.
        values: One element or row for each.
        ends: Where each one ends if they have several sizes; then `values` is all of them joined, in bytes.
    """

    sample: npt.NDArray[np.int64]
    values: npt.NDArray[Any]
    ends: npt.NDArray[np.uint64] | None = None


class Topic(NamedTuple):
    """A topic.

    Attributes:
        name: Its name.
        type: The type of its messages.
        needs: Groups of quantities. Messages need one of each group.
        layout: Returns the layout of the messages for the frames of a device.
        bodies: Returns the bodies of the messages of a part.
    """

    name: str
    type: str
    needs: tuple[tuple[str, ...], ...]
    layout: Callable[[Frames], Layout]
    bodies: Callable[[Measured, Style, Layout], Bodies]

    def is_in(self, shape: Part) -> bool:
        """Returns whether a log with these columns can have messages."""
        return all(any(columns_of(shape, name) for name in group) for group in self.needs)


# Layouts

Place = Callable[[Frames], str]
_sensor: Place = attrgetter("sensor")
_world: Place = attrgetter("world")
_free: Place = attrgetter("free")
_earth: Place = attrgetter("earth")


def _doubles(count: int, place: Place) -> Callable[[Frames], Layout]:
    return lambda frames: Layout.of(stamped(place(frames)), [("values", DOUBLES, (count,))])


def _transform(frames: Frames) -> Layout:
    return Layout.of(transform(frames.parent, frames.sensor), [("values", DOUBLES, (7,))])


def _time_reference(frames: Frames) -> Layout:  # noqa: ARG001 - as the others
    fields = [
        ("sec", "<i4", ()),
        ("nanosec", "<u4", ()),
        ("length", "<u4", ()),
        ("source", "u1", (1,)),
    ]
    return Layout.of(stamped(""), fields)


def _status(frames: Frames) -> Layout:  # noqa: ARG001
    return Layout.of(bare(), [("flags", "u1", (len(FLAGS),))])


def _navsat(frames: Frames) -> Layout:
    return Layout.of(stamped(frames.antenna), navsat_fields())


def _sentence(frames: Frames) -> Layout:
    return Layout.of(stamped(frames.antenna), [("length", "<u4", ())])


# Messages


def _columns(*columns: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Returns rows of doubles, little-endian."""
    flat = [column[:, np.newaxis] if column.ndim == 1 else column for column in columns]
    return np.ascontiguousarray(np.concatenate(flat, axis=1), DOUBLES)


def _vector(name: str) -> Callable[[Measured, Style, Layout], Bodies]:
    def bodies(measured: Measured, style: Style, layout: Layout) -> Bodies:  # noqa: ARG001
        sample, values = measured.numbers(name)
        return Bodies(sample, _columns(values))

    return bodies


def _local_vector(name: str) -> Callable[[Measured, Style, Layout], Bodies]:
    def bodies(measured: Measured, style: Style, layout: Layout) -> Bodies:  # noqa: ARG001
        sample, values = measured.vectors(name)
        return Bodies(sample, _columns(values))

    return bodies


def _scalar(name: str) -> Callable[[Measured, Style, Layout], Bodies]:
    def bodies(measured: Measured, style: Style, layout: Layout) -> Bodies:  # noqa: ARG001
        sample, values = measured.numbers(name)
        return Bodies(sample, _columns(values, np.zeros(len(sample))))

    return bodies


def _magnetic_field(measured: Measured, style: Style, layout: Layout) -> Bodies:  # noqa: ARG001
    sample, values = measured.numbers("magnetic_field")
    field = values if style.mag_norm is None else values * style.mag_norm
    return Bodies(sample, _columns(field, np.zeros((len(sample), 9))))


def _increment(measured: Measured, style: Style, layout: Layout) -> Bodies:  # noqa: ARG001
    sample, values = measured.numbers("delta_q")
    return Bodies(sample, _columns(xyzw(values)))


def _sample_time(measured: Measured, style: Style, layout: Layout) -> Bodies:  # noqa: ARG001
    sample, ticks = measured.rows("sample_time_fine")
    coarse = measured.rows("sample_time_coarse")
    seconds = ticks // TICKS
    if len(coarse.sample):
        both = inner(Rows(sample, ticks), coarse)
        seconds[np.searchsorted(sample, both)] = coarse.at(both)
    return _references(sample, seconds.astype(np.int64), ticks % TICKS * TICK, layout)


def _utc(measured: Measured, style: Style, layout: Layout) -> Bodies:
    sample, records = measured.rows("utc_time")
    if not style.is_driver:
        times = measured.times("utc_time")
        is_valid = (records["valid"] & UTC_VALID == UTC_VALID) & (times >= 0) & (times < END)
        seconds, nanoseconds = np.divmod(times[is_valid], SECOND)
        return _references(sample[is_valid], seconds, nanoseconds, layout)
    # Dates that do not exist, such as month 0, continue the calendar, as in C.
    months = (records["year"].astype(np.int64) - 1970) * 12 + records["month"] - 1
    days = months.astype("M8[M]").astype("M8[D]").astype(np.int64) + records["day"] - 1
    hours = days * 24 + records["hour"]
    seconds = (hours * 60 + records["minute"]) * 60 + records["second"]
    return _references(sample, np.maximum(seconds, 0), records["ns"], layout)


def _references(
    sample: npt.NDArray[np.int64],
    seconds: npt.NDArray[np.int64],
    nanoseconds: npt.NDArray[Any],
    layout: Layout,
) -> Bodies:
    bodies = layout.bodies(len(sample))
    bodies["sec"], bodies["nanosec"] = seconds.astype(np.int32), nanoseconds
    bodies["length"] = 1  # an empty string ends with a zero
    return Bodies(sample, bodies)


def _flags(measured: Measured, style: Style, layout: Layout) -> Bodies:  # noqa: ARG001
    sample, word = status_of(measured)
    bodies = layout.bodies(len(sample))
    bodies["flags"] = np.stack([flag.of(word) for flag in FLAGS], axis=1)
    return Bodies(sample, bodies)


def status_of(measured: Measured) -> Rows:
    """Returns the status word of samples, otherwise the status byte, as uint32."""
    word, byte = measured.rows("status_word"), measured.rows("status_byte")
    sample = outer(word, byte)
    values = np.zeros(len(sample), np.uint32)
    for rows in (byte, word):
        values[np.searchsorted(sample, rows.sample)] = rows.values.reshape(-1)
    return Rows(sample, values)


def _imu(measured: Measured, style: Style, layout: Layout) -> Bodies:  # noqa: ARG001
    orientation = Rows(measured.orientation.sample, xyzw(measured.orientation.values))
    rate, acceleration = measured.numbers("rate_of_turn"), measured.numbers("acceleration")
    sample = outer(orientation, rate, acceleration)
    values = np.zeros((len(sample), 37), DOUBLES)
    values[:, 3] = 1  # the identity
    for rows, start, covariance in ((orientation, 0, 4), (rate, 13, 16), (acceleration, 25, 28)):
        if len(rows.sample):
            has = rows.has(sample)
            values[has, start : start + rows.values.shape[1]] = rows.values
            values[~has, covariance] = ABSENT
        else:
            values[:, covariance] = ABSENT
    return Bodies(sample, values)


def _quaternion(measured: Measured, style: Style, layout: Layout) -> Bodies:  # noqa: ARG001
    sample, values = measured.orientation
    return Bodies(sample, _columns(xyzw(values)))


def _euler(measured: Measured, style: Style, layout: Layout) -> Bodies:  # noqa: ARG001
    sample, values = measured.euler
    return Bodies(sample, _columns(values if style.is_driver else np.radians(values)))


def _rotation(measured: Measured, style: Style, layout: Layout) -> Bodies:  # noqa: ARG001
    sample, values = measured.orientation
    return Bodies(sample, _columns(np.zeros((len(sample), 3)), xyzw(values)))


def _fix(measured: Measured, style: Style, layout: Layout) -> Bodies:
    sample, records = measured.rows("gnss_pvt_data")
    return Bodies(sample, navsat_rows(records, layout, is_driver=style.is_driver))


def _lat_lon(measured: Measured, style: Style) -> Rows:
    """Returns the positions of the filter: for the driver those without a fix, too."""
    return measured.numbers("lat_lon") if style.is_driver else measured.positions


def _position(measured: Measured, style: Style, layout: Layout) -> Bodies:  # noqa: ARG001
    lat_lon, altitude = _lat_lon(measured, style), measured.numbers("altitude_ellipsoid")
    sample = inner(lat_lon, altitude)
    return Bodies(sample, _columns(lat_lon.at(sample), altitude.at(sample)))


def _twist(measured: Measured, style: Style, layout: Layout) -> Bodies:  # noqa: ARG001
    velocity, rate = measured.vectors("velocity_xyz"), measured.numbers("rate_of_turn")
    sample = inner(velocity, rate)
    linear, angular = velocity.at(sample), rate.at(sample)
    if not style.is_driver:
        # Both in the local frame, which the header names.
        sample = inner(Rows(sample, linear), measured.orientation)
        linear = velocity.at(sample)
        angular = quaternion.rotate(measured.orientation.at(sample), rate.at(sample))
    return Bodies(sample, _columns(linear, angular))


def _nmea(measured: Measured, style: Style, layout: Layout) -> Bodies:  # noqa: ARG001
    pvt, status = measured.rows("gnss_pvt_data"), status_of(measured)
    sample = inner(pvt, status) if style.is_driver else pvt.sample
    records = pvt.at(sample)
    texts = sentences(records, status.at(sample) if style.is_driver else None)
    pieces = [len(text).to_bytes(4, "little") + text for text in texts]
    ends = np.cumsum([len(piece) for piece in pieces], dtype=np.uint64)
    return Bodies(sample, np.frombuffer(b"".join(pieces), np.uint8), ends)


def _pose(measured: Measured, style: Style, layout: Layout) -> Bodies:  # noqa: ARG001
    lat_lon, altitude = _lat_lon(measured, style), measured.numbers("altitude_ellipsoid")
    orientation = measured.orientation if style.is_driver else measured.enu_orientation
    sample = inner(lat_lon, altitude, orientation)
    lat, lon = lat_lon.at(sample).reshape(-1, 2).T
    height, q = altitude.at(sample), orientation.at(sample)
    if style.is_driver:
        return Bodies(sample, _columns(lat, lon, height, xyzw(q)))
    position = geodetic_to_ecef(lat, lon, height)
    return Bodies(sample, _columns(position, xyzw(quaternion.multiply(_enu_to_ecef(lat, lon), q))))


def _enu_to_ecef(
    lat: npt.NDArray[np.float64], lon: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Returns the rotations from east, north and up at places in degrees to ECEF, as quaternions."""
    about_x, about_z = np.zeros((2, len(lat), 3))
    about_x[:, 0], about_z[:, 2] = np.radians(90 - lat), np.radians(90 + lon)
    return quaternion.multiply(
        quaternion.from_rotation_vector(about_z), quaternion.from_rotation_vector(about_x)
    )


#: All topics but the driver's ``/odometry``, which is off by default, and whose first message is wrong.
TOPICS = (
    Topic("/imu/acceleration", "geometry_msgs/Vector3Stamped", (("acceleration",),),
          _doubles(3, _sensor), _vector("acceleration")),
    Topic("/imu/angular_velocity", "geometry_msgs/Vector3Stamped", (("rate_of_turn",),),
          _doubles(3, _sensor), _vector("rate_of_turn")),
    Topic("/imu/mag", "sensor_msgs/MagneticField", (("magnetic_field",),),
          _doubles(12, _sensor), _magnetic_field),
    Topic("/imu/dq", "geometry_msgs/QuaternionStamped", (("delta_q",),),
          _doubles(4, _sensor), _increment),
    Topic("/imu/dv", "geometry_msgs/Vector3Stamped", (("delta_v",),),
          _doubles(3, _sensor), _vector("delta_v")),
    Topic("/imu/time_ref", "sensor_msgs/TimeReference", (("sample_time_fine",),),
          _time_reference, _sample_time),
    Topic("/temperature", "sensor_msgs/Temperature", (("temperature",),),
          _doubles(2, _sensor), _scalar("temperature")),
    Topic("/pressure", "sensor_msgs/FluidPressure", (("baro_pressure",),),
          _doubles(2, _sensor), _scalar("baro_pressure")),
    Topic("/status", "xsens_mti_ros2_driver/XsStatusWord", (("status_word", "status_byte"),),
          _status, _flags),
    Topic("/imu/utctime", "sensor_msgs/TimeReference", (("utc_time",),), _time_reference, _utc),
    Topic("/imu/acceleration_hr", "geometry_msgs/Vector3Stamped", (("acceleration_hr",),),
          _doubles(3, _sensor), _vector("acceleration_hr")),
    Topic("/imu/angular_velocity_hr", "geometry_msgs/Vector3Stamped", (("rate_of_turn_hr",),),
          _doubles(3, _sensor), _vector("rate_of_turn_hr")),
    Topic("/imu/data", "sensor_msgs/Imu", ((*ORIENTATION, "acceleration", "rate_of_turn"),),
          _doubles(37, _sensor), _imu),
    Topic("/filter/quaternion", "geometry_msgs/QuaternionStamped", (ORIENTATION,),
          _doubles(4, _world), _quaternion),
    Topic("/filter/euler", "geometry_msgs/Vector3Stamped", (ORIENTATION,),
          _doubles(3, _world), _euler),
    Topic("/filter/free_acceleration", "geometry_msgs/Vector3Stamped", (("free_acceleration",),),
          _doubles(3, _free), _local_vector("free_acceleration")),
    Topic("/tf", "tf2_msgs/TFMessage", (ORIENTATION,), _transform, _rotation),
    Topic("/gnss", "sensor_msgs/NavSatFix", (("gnss_pvt_data",),), _navsat, _fix),
    Topic("/filter/positionlla", "geometry_msgs/Vector3Stamped", (("lat_lon",), ("altitude_ellipsoid",)),
          _doubles(3, _earth), _position),
    Topic("/filter/velocity", "geometry_msgs/Vector3Stamped", (("velocity_xyz",),),
          _doubles(3, _world), _local_vector("velocity_xyz")),
    Topic("/filter/twist", "geometry_msgs/TwistStamped", (("velocity_xyz",), ("rate_of_turn",)),
          _doubles(6, _world), _twist),
    Topic("/nmea", "nmea_msgs/Sentence", (("gnss_pvt_data",),), _sentence, _nmea),
    Topic("/gnss_pose", "geometry_msgs/PoseStamped",
          (("lat_lon",), ("altitude_ellipsoid",), ORIENTATION), _doubles(7, _earth), _pose),
)  # fmt: skip
