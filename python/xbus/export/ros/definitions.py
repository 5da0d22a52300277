"""The message types: definition, hash and quality of service. Each is declared here and nowhere else."""

from __future__ import annotations

import re

__all__ = ["DEFINITIONS", "HASHES", "TF_DEPTH", "TOPIC_DEPTH", "definition_of", "qos"]

#: The fields of each type, in the language of ROS 2 (``.msg``). A type of ROS is written with its package.
DEFINITIONS: dict[str, str] = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/QuaternionStamped": "std_msgs/Header header\ngeometry_msgs/Quaternion quaternion",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    "geometry_msgs/TwistStamped": "std_msgs/Header header\ngeometry_msgs/Twist twist",
    "geometry_msgs/Vector3Stamped": "std_msgs/Header header\ngeometry_msgs/Vector3 vector",
    "nmea_msgs/Sentence": "std_msgs/Header header\nstring sentence",
    "sensor_msgs/FluidPressure": "std_msgs/Header header\nfloat64 fluid_pressure\nfloat64 variance",
    "sensor_msgs/Imu": (
        "std_msgs/Header header\n"
        "geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance"
    ),
    "sensor_msgs/MagneticField": (
        "std_msgs/Header header\n"
        "geometry_msgs/Vector3 magnetic_field\nfloat64[9] magnetic_field_covariance"
    ),
    "sensor_msgs/NavSatStatus": (
        "int8 STATUS_NO_FIX=-1\nint8 STATUS_FIX=0\nint8 STATUS_SBAS_FIX=1\nint8 STATUS_GBAS_FIX=2\n"
        "int8 status\n"
        "uint16 SERVICE_GPS=1\nuint16 SERVICE_GLONASS=2\nuint16 SERVICE_COMPASS=4\n"
        "uint16 SERVICE_GALILEO=8\n"
        "uint16 service"
    ),
    "sensor_msgs/NavSatFix": (
        "std_msgs/Header header\nsensor_msgs/NavSatStatus status\n"
        "float64 latitude\nfloat64 longitude\nfloat64 altitude\nfloat64[9] position_covariance\n"
        "uint8 COVARIANCE_TYPE_UNKNOWN=0\nuint8 COVARIANCE_TYPE_APPROXIMATED=1\n"
        "uint8 COVARIANCE_TYPE_DIAGONAL_KNOWN=2\nuint8 COVARIANCE_TYPE_KNOWN=3\n"
        "uint8 position_covariance_type"
    ),
    "sensor_msgs/Temperature": "std_msgs/Header header\nfloat64 temperature\nfloat64 variance",
    "sensor_msgs/TimeReference": (
        "std_msgs/Header header\nbuiltin_interfaces/Time time_ref\nstring source"
    ),
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "xsens_mti_ros2_driver/XsStatusWord": (
        "bool selftest\nbool filter_valid\nbool gnss_fix\nuint8 no_rotation_update_status\n"
        "bool representative_motion\nbool clock_bias_estimation\n"
        "bool clipflag_acc_x\nbool clipflag_acc_y\nbool clipflag_acc_z\n"
        "bool clipflag_gyr_x\nbool clipflag_gyr_y\nbool clipflag_gyr_z\n"
        "bool clipflag_mag_x\nbool clipflag_mag_y\nbool clipflag_mag_z\n"
        "bool clipping_indication\nbool syncin_marker\nbool syncout_marker\nuint8 filter_mode\n"
        "bool have_gnss_time_pulse\nuint8 rtk_status"
    ),
}

#: RIHS01 hashes of the types of topics: they identify a type to ROS 2 from Iron on.
HASHES = {
    "geometry_msgs/PoseStamped": "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
    "geometry_msgs/QuaternionStamped": "381add86c6c3160644d228ca342182c7fd6c7fab11c7a85ad817a9cc22dbac6e",
    "geometry_msgs/TwistStamped": "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    "geometry_msgs/Vector3Stamped": "d4829622288cbb443886e7ea94ea5671a3b1be6bab4ad04224432a65f7d7887a",
    "nmea_msgs/Sentence": "67d3d300e23d1d018584731cd9642ffb4c78d12da1f483d3f2be3a9396c40984",
    "sensor_msgs/FluidPressure": "22dfb2b145a0bd5a31a1ac3882a1b32148b51d9b2f3bab250290d66f3595bc32",
    "sensor_msgs/Imu": "7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
    "sensor_msgs/MagneticField": "e80f32f56a20486c9923008fc1a1db07bbb273cbbf6a5b3bfa00835ee00e4dff",
    "sensor_msgs/NavSatFix": "62223ab3fe210a15976021da7afddc9e200dc9ec75231c1b6a557fc598a65404",
    "sensor_msgs/Temperature": "72514a14126ab9f8a9abec974c78e5610a367b59db5da355ff1fb982d5bad4b8",
    "sensor_msgs/TimeReference": "dd66e84cf40bbb5d5a40472e6ecf2675a031334d4c426abdb2ad41801a8efc99",
    "tf2_msgs/TFMessage": "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    "xsens_mti_ros2_driver/XsStatusWord": "7a21f81ce2435b305585508f8a797077d56ce957e9e7619656eb57af91c8a800",
}

#: Messages that a publisher of the vendor's driver keeps for late readers, and the broadcaster of ``/tf``.
TOPIC_DEPTH, TF_DEPTH = 5, 100

SEPARATOR = "=" * 80


def _types_in(name: str) -> list[str]:
    """Returns the types that a type uses, each once, those of a field after the field."""
    found: dict[str, None] = {}
    for used in re.findall(r"^(\w+/\w+)", DEFINITIONS[name], re.MULTILINE):
        found |= dict.fromkeys([used, *_types_in(used)])
    return list(found)


def definition_of(name: str) -> str:
    """Returns the definition of a type with those of the types that it uses (``ros2msg``).

    >>> print(definition_of("std_msgs/Header"))
    builtin_interfaces/Time stamp
    string frame_id
    ================================================================================
    MSG: builtin_interfaces/Time
    int32 sec
    uint32 nanosec
    """
    others = (f"{SEPARATOR}\nMSG: {used}\n{DEFINITIONS[used]}" for used in _types_in(name))
    return "\n".join([DEFINITIONS[name], *others])


def qos(depth: int) -> str:
    """Returns a quality of service as YAML: reliable, volatile, with this depth. As of metadata version 5."""
    periods = "".join(
        f"  {name}:\n    sec: 0\n    nsec: 0\n"
        for name in ("deadline", "lifespan", "liveliness_lease_duration")
    )
    return (
        f"- history: 1\n  depth: {depth}\n  reliability: 1\n  durability: 2\n{periods}"
        "  liveliness: 1\n  avoid_ros_namespace_conventions: false"
    )
