"""The motion of virtual devices: exact derivatives, rotations and the Earth."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pytest

import xbus
from conftest import OWN_CAPTURES
from xbus.geometry import earth, quaternion
from xbus.protocol.values import LatLonAlt
from xbus.sim.motion import COASTING, SampledTrajectory, Trajectory
from xbus.sim.trajectories import TRAJECTORIES, trajectory

FloatArray: TypeAlias = npt.NDArray[np.float64]

WALK = xbus.read_log(OWN_CAPTURES / "walk.mtb")


def sampled() -> SampledTrajectory:
    """Returns a trajectory through unevenly spaced rows, with quaternions of any sign and norm."""
    rng = np.random.default_rng(5)
    time = np.cumsum(rng.integers(1, 4, 600)) / 16
    rows = trajectory("tumble").at(time).orientation * rng.choice([-2.0, 0.5, 1.0], (600, 1))
    return SampledTrajectory(time, rows, trajectory("drive").at(time).position)


PATHS: dict[str, Callable[[], Trajectory]] = {
    **TRAJECTORIES,
    "sampled": sampled,
    "sampled at rest": lambda: SampledTrajectory([0, 60], [[1.0, 0, 0, 0], [0.9, 0.1, 0.1, 0.1]]),
    "log": lambda: SampledTrajectory.from_log(WALK),
}

#: A power of two, so that times a few steps apart are exact at any time of the day.
STEP = 2.0**-10


@pytest.fixture(params=list(PATHS))
def path(request: pytest.FixtureRequest) -> Trajectory:
    return PATHS[request.param]()


def derivative(at: Callable[[FloatArray], FloatArray], time: FloatArray) -> FloatArray:
    """Returns derivatives by central differences of fourth order."""
    near = at(time + STEP) - at(time - STEP)
    far = at(time + 2 * STEP) - at(time - 2 * STEP)
    return (8 * near - far) / (12 * STEP)


def vee(skew: FloatArray) -> FloatArray:
    return np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)


# Derivatives


@pytest.mark.parametrize("hours", [0, 1, 10])
def test_velocity_acceleration_and_rate_of_turn_are_derivatives(
    path: Trajectory, hours: int
) -> None:
    bound = 2e-6  # m/s, m/s2, rad/s
    # Third derivatives of a sampled trajectory step between its rows.
    time = 3600 * hours + np.arange(0, 70, 0.25) + 5 * STEP
    motion = path.at(time)
    velocity = derivative(lambda time: path.at(time).position, time)
    np.testing.assert_allclose(motion.velocity, velocity, rtol=0, atol=bound)
    acceleration = derivative(lambda time: path.at(time).velocity, time)
    np.testing.assert_allclose(motion.acceleration, acceleration, rtol=0, atol=bound)
    matrix = quaternion.to_matrix(motion.orientation)
    change = derivative(lambda time: quaternion.to_matrix(path.at(time).orientation), time)
    rate = vee(np.swapaxes(matrix, 1, 2) @ change)
    np.testing.assert_allclose(motion.rate_of_turn, rate, rtol=0, atol=bound)


@pytest.mark.parametrize("rate", [100, 400, 2000])
def test_the_product_of_delta_q_is_the_quaternion(path: Trajectory, rate: int) -> None:
    motion = path.at(np.arange(64 * rate + 1) / rate)
    product = quaternion.delta(motion.orientation[:-1], motion.orientation[1:])
    while len(product) > 1:
        odd = product[len(product) & ~1 :]
        product = quaternion.multiply(product[0 : len(product) & ~1 : 2], product[1::2])
        product = np.concatenate([product, odd])
    # Each product of unit quaternions changes the norm by 1e-16.
    product /= np.linalg.norm(product)
    turned = quaternion.multiply(motion.orientation[0], product[0])
    np.testing.assert_allclose(turned, motion.orientation[-1], rtol=0, atol=1e-12)


def test_delta_q_is_the_rate_of_turn_over_a_step(path: Trajectory) -> None:
    time = np.arange(0, 60, STEP)
    q = path.at(time).orientation
    middle = path.at(time[:-1] + STEP / 2).rate_of_turn
    expected = quaternion.from_rotation_vector(middle * STEP)
    # To third order in the step; the log's orientation is noisy.
    np.testing.assert_allclose(quaternion.delta(q[:-1], q[1:]), expected, rtol=0, atol=1e-6)


def test_orientations_are_unit_quaternions_of_continuous_sign(path: Trajectory) -> None:
    q = path.at(np.arange(0, 300, 0.02)).orientation
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1, rtol=0, atol=1e-15)
    assert (np.sum(q[1:] * q[:-1], axis=1) > 0.99).all()


def test_trajectories_are_bounded(path: Trajectory) -> None:
    position = path.at(np.linspace(0, 36000, 20001)).position
    assert np.abs(position).max() < 1000


def test_arrays_are_float64_of_the_stated_shapes(path: Trajectory) -> None:
    for n in (0, 1, 5):
        motion = path.at(np.arange(n, dtype=np.float64))
        shapes = {name: (array.shape, array.dtype.str) for name, array in vars(motion).items()}
        assert shapes == {
            "time": ((n,), "<f8"),
            "orientation": ((n, 4), "<f8"),
            **dict.fromkeys(
                ("rate_of_turn", "acceleration", "velocity", "position"), ((n, 3), "<f8")
            ),
        }


def test_a_result_does_not_depend_on_other_times_of_the_call(path: Trajectory) -> None:
    time = np.arange(0, 30, 0.7)
    alone = [path.at(time[i : i + 1]).orientation[0] for i in range(len(time))]
    np.testing.assert_array_equal(path.at(time).orientation, alone)


# The built-in trajectories


@pytest.mark.parametrize(
    ("name", "slowest", "fastest", "turning"),
    # m/s, m/s, rad/s
    [
        ("still", 0.0, 0.0, 0.0),
        ("turn", 0.0, 0.0, 0.53),
        ("tumble", 0.0, 0.0, 2.3),
        ("walk", 1.39, 1.5, 0.7),
        ("drive", 5.0, 25.0, 0.4),
        ("fly", 40.0, 40.2, 0.2),
        ("sail", 2.9, 3.1, 0.2),
    ],
)
def test_built_in_speeds(name: str, slowest: float, fastest: float, turning: float) -> None:
    motion = trajectory(name).at(np.arange(0, 600, 0.05))
    speed = np.linalg.norm(motion.velocity, axis=1)
    assert slowest <= speed.min() <= speed.max() <= fastest
    assert turning * 0.5 <= np.linalg.norm(motion.rate_of_turn, axis=1).max() <= turning


def test_tumble_goes_through_all_orientations() -> None:
    motion = trajectory("tumble").at(np.arange(0, 600, 0.05))
    euler = quaternion.to_euler(motion.orientation)
    assert np.abs(euler[:, 1]).max() > 89.5
    down = quaternion.rotate(quaternion.conjugate(motion.orientation), np.array([0.0, 0.0, -1.0]))
    assert {tuple(signs) for signs in np.sign(down).tolist()} >= {
        (x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)
    }


@pytest.mark.parametrize(("name", "bound"), [("drive", 1e-6), ("fly", 1e-6), ("walk", 7.0)])
def test_heading_is_the_direction_of_travel(name: str, bound: float) -> None:
    motion = trajectory(name).at(np.arange(0, 300, 0.05))
    course = np.degrees(np.arctan2(motion.velocity[:, 1], motion.velocity[:, 0]))
    apart = (quaternion.to_euler(motion.orientation)[:, 2] - course + 180) % 360 - 180
    assert np.abs(apart).max() < bound


def test_a_trajectory_by_name_or_as_it_is() -> None:
    path = sampled()
    assert trajectory(path) is path
    names = "use one of still, turn, tumble, walk, drive, fly, sail"
    with pytest.raises(ValueError, match=f"no trajectory is called 'swim'; {names}"):
        trajectory("swim")
    with pytest.raises(TypeError, match="not int"):
        trajectory(3)  # type: ignore[arg-type]


# Given rows


def test_rows_are_passed_through() -> None:
    time = np.array([0.0, 0.1, 0.35, 0.4, 1.0])
    source = trajectory("tumble").at(time)
    position = np.random.default_rng(1).normal(size=(5, 3))
    motion = SampledTrajectory(time, -3 * source.orientation, position).at(time)
    np.testing.assert_allclose(np.abs(motion.orientation), np.abs(source.orientation), atol=1e-15)
    np.testing.assert_allclose(motion.position, position, rtol=0, atol=1e-15)


def test_rows_of_a_smooth_motion_give_it_back() -> None:
    source = trajectory("walk")
    time = np.arange(0, 10.005, 0.01)
    path = SampledTrajectory(time, source.at(time).orientation, source.at(time).position)
    between = np.arange(1, 9, 0.0037)
    expected, motion = source.at(between), path.at(between)
    for name, bound in [
        ("orientation", 1e-8),
        ("rate_of_turn", 1e-5),
        ("position", 1e-7),
        ("velocity", 2e-5),
        ("acceleration", 1e-2),
    ]:
        np.testing.assert_allclose(
            getattr(motion, name), getattr(expected, name), rtol=0, atol=bound, err_msg=name
        )


def test_nothing_steps_at_rows_and_ends() -> None:
    path = sampled()
    rows = path._orientation.time
    time = np.concatenate([rows, [rows[0] - COASTING, rows[-1] + COASTING]])
    before, after = path.at(np.nextafter(time, -1e9)), path.at(np.nextafter(time, 1e9))
    for name in ("orientation", "rate_of_turn", "acceleration", "velocity", "position"):
        np.testing.assert_allclose(
            getattr(before, name), getattr(after, name), rtol=0, atol=1e-10, err_msg=name
        )


def test_comes_to_rest_after_the_last_row_and_stays() -> None:
    path = sampled()
    end = path._orientation.time[-1] + COASTING
    motion = path.at(np.array([end, end + 1, end + 1e6]))
    assert not motion.velocity.any()
    assert not motion.acceleration.any()
    assert not motion.rate_of_turn.any()
    assert (motion.position == motion.position[0]).all()
    assert (motion.orientation == motion.orientation[0]).all()


LEVEL = [[1.0, 0, 0, 0]] * 3


@pytest.mark.parametrize(
    ("time", "orientation", "position", "message"),
    [
        ([0], LEVEL[:1], None, "time must have the shape (n,) with n >= 2, not (1,)"),
        ([[0, 1, 2]], LEVEL, None, "time must have the shape (n,) with n >= 2, not (1, 3)"),
        ([0, 1, 1], LEVEL, None, "time must be finite and strictly increasing"),
        ([0, 2, 1], LEVEL, None, "time must be finite and strictly increasing"),
        ([0, 1, np.nan], LEVEL, None, "time must be finite and strictly increasing"),
        ([0, 1, np.inf], LEVEL, None, "time must be finite and strictly increasing"),
        (
            [0, 1],
            LEVEL,
            None,
            "orientation must have the shape (2, 4), one row for each time, not (3, 4)",
        ),
        (
            [0, 1],
            np.eye(3),
            None,
            "orientation must have the shape (2, 4), one row for each time, not (3, 3)",
        ),
        (
            [0, 1],
            [[1, 0, 0, 0], [0, 0, 0, 0]],
            None,
            "the quaternion in row 1 of orientation is zero",
        ),
        ([0, 1], [[1, 0, 0, 0], [0, np.nan, 0, 0]], None, "row 1 of orientation is not finite"),
        (
            [0, 1, 2],
            LEVEL,
            [0, 0, 0],
            "position must have the shape (3, 3), one row for each time, not (3,)",
        ),
        ([0, 1, 2], LEVEL, [[0, 0, np.inf]] * 3, "row 0 of position is not finite"),
    ],
)
def test_invalid_rows_are_refused(time: Any, orientation: Any, position: Any, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        SampledTrajectory(time, orientation, position)


# Logs


def recorded(rows: list[dict[Any, Any]], rate: float = 100) -> xbus.Log:
    frames = [
        xbus.encode_sample({"sample_time_fine": 5000 + round(1e4 * n / rate), **row})
        for n, row in enumerate(rows)
    ]
    return xbus.read_log(b"".join(frames))


def test_a_log_gives_the_recorded_motion() -> None:
    path = SampledTrajectory.from_log(WALK)
    motion = path.at(WALK["quaternion"].time - WALK["quaternion"].time[0])
    dots = np.sum(motion.orientation * WALK["quaternion"].values, axis=1)
    np.testing.assert_allclose(np.abs(dots), 1, rtol=0, atol=1e-6)
    assert path.origin == pytest.approx((52.2404, 6.8382, 81.5), abs=1e-9)
    lat, lon, _ = earth.enu_to_geodetic(motion.position, path.origin)
    place = np.stack([lat, lon], axis=1)
    np.testing.assert_allclose(place, WALK["lat_lon"].values, rtol=0, atol=1e-9)
    # The recorded velocity has independent noise.
    level = motion.velocity[:, :2] - WALK["velocity_xyz"].values[:, :2]
    assert np.abs(level).max() < 0.05


QUATERNIONS = trajectory("tumble").at(np.arange(100) / 100).orientation


@pytest.mark.parametrize(
    ("coordinates", "matrix"),
    # Rows: the axes of the local coordinates in east, north, up.
    [
        ("ENU", [[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        ("NED", [[0, 1, 0], [1, 0, 0], [0, 0, -1]]),
        ("NWU", [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
    ],
)
@pytest.mark.parametrize("name", ["quaternion", "rotation_matrix", "euler_angles"])
def test_orientation_in_any_form_and_coordinates(
    name: str, coordinates: str, matrix: list[list[float]]
) -> None:
    turned = np.array(matrix) @ quaternion.to_matrix(QUATERNIONS)
    forms = {
        "quaternion": quaternion.from_matrix(turned),
        "rotation_matrix": turned,
        "euler_angles": quaternion.to_euler(quaternion.from_matrix(turned)),
    }
    log = recorded([{(name, "Float64", coordinates): form} for form in forms[name]])
    motion = SampledTrajectory.from_log(log).at(np.arange(100) / 100)
    dots = np.sum(motion.orientation * QUATERNIONS, axis=1)
    np.testing.assert_allclose(np.abs(dots), 1, rtol=0, atol=1e-12)
    assert not motion.position.any()


def test_position_ecef_moves_too() -> None:
    origin = LatLonAlt(-33.0, 151.0, 12.0)
    positions = np.linspace([0, 0, 0], [30, 40, 5], 500)
    ecef = earth.enu_to_ecef(positions, origin)
    rows = [
        {"quaternion": [1, 0, 0, 0], ("position_ecef", "Float64"): position} for position in ecef
    ]
    path = SampledTrajectory.from_log(recorded(rows))
    assert path.origin == pytest.approx(origin, abs=1e-8)
    moved = path.at(np.arange(500) / 100).position
    np.testing.assert_allclose(moved, positions, rtol=0, atol=1e-7)


def test_position_steps_of_a_filter_do_not_become_shocks() -> None:
    steps = np.where(np.arange(1000) >= 500, 0.05, 0.0)[:, np.newaxis] * [1.0, 0, 0]
    ecef = earth.enu_to_ecef(steps, earth.ORIGIN)
    rows = [
        {"quaternion": [1, 0, 0, 0], ("position_ecef", "Float64"): position} for position in ecef
    ]
    motion = SampledTrajectory.from_log(recorded(rows)).at(np.arange(0, 10, 0.002))
    assert np.abs(motion.acceleration).max() < 5


def test_rows_out_of_order_or_not_finite_are_skipped() -> None:
    nan = [float("nan")] * 4
    rows = [{"quaternion": q} for q in ([1, 0, 0, 0], nan, [0, 1, 0, 0], [1, 0, 0, 0])]
    log = recorded([*rows, {"quaternion": [0, 0, 0, 1], "sample_time_fine": 5010}])
    path = SampledTrajectory.from_log(log)
    np.testing.assert_allclose(path._orientation.time, [0, 0.02, 0.03], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (
            [],
            "the log has no orientation: a trajectory needs quaternion, rotation_matrix or euler_angles",
        ),
        ([{"acceleration": [0, 0, 9.81]}], "the log has no orientation: a trajectory needs"),
        (
            [{"quaternion": [1, 0, 0, 0]}],
            "the log has 1 rows of quaternion with times; a trajectory needs two",
        ),
    ],
)
def test_logs_without_orientation_are_refused(rows: list[dict[Any, Any]], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        SampledTrajectory.from_log(recorded(rows))


# Quaternions


@pytest.mark.parametrize(
    ("euler", "expected"),
    [
        ([0, 0, 0], [1, 0, 0, 0]),
        ([90, 0, 0], [0.5**0.5, 0.5**0.5, 0, 0]),
        ([0, 90, 0], [0.5**0.5, 0, 0.5**0.5, 0]),
        ([0, 0, 90], [0.5**0.5, 0, 0, 0.5**0.5]),
        ([180, 0, 0], [0, 1, 0, 0]),
        ([90, 0, 90], [0.5, 0.5, 0.5, 0.5]),
    ],
)
def test_euler_angles(euler: list[float], expected: list[float]) -> None:
    np.testing.assert_allclose(quaternion.from_euler(euler), expected, rtol=0, atol=1e-15)


def test_forms_of_rotation_agree() -> None:
    rng = np.random.default_rng(3)
    q = rng.normal(size=(1000, 4))
    q = np.concatenate([q, np.eye(4), -np.eye(4), [[1, 1e-9, 0, 0], [1e-9, 1, 0, 1e-9]]])
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    for back in (
        quaternion.from_matrix(quaternion.to_matrix(q)),
        quaternion.from_euler(quaternion.to_euler(q)),
    ):
        np.testing.assert_allclose(np.abs(np.sum(q * back, axis=1)), 1, rtol=0, atol=1e-14)
    vector = rng.normal(size=(len(q), 3))
    np.testing.assert_allclose(
        quaternion.rotate(q, vector),
        np.einsum("nij,nj->ni", quaternion.to_matrix(q), vector),
        rtol=0,
        atol=1e-14,
    )
    p = q[::-1]
    np.testing.assert_allclose(
        quaternion.to_matrix(quaternion.multiply(p, q)),
        quaternion.to_matrix(p) @ quaternion.to_matrix(q),
        rtol=0,
        atol=1e-14,
    )


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-9, 1.0, 3.0])
def test_rotation_vectors(angle: float) -> None:
    q = quaternion.from_rotation_vector(np.array([0.0, angle, 0.0]))
    np.testing.assert_allclose(q, [np.cos(angle / 2), 0, np.sin(angle / 2), 0], rtol=1e-15)


# The Earth

PLACES = [
    (lat, lon, alt)
    for lat in (-90.0, -89.9999999, -45.0, -1e-9, 0.0, 33.3, 52.240492, 89.999, 90.0)
    for lon in (-179.9, -90.0, 0.0, 6.838217, 180.0)
    for alt in (-1000.0, 0.0, 42.0, 20000.0)
]


def test_geodetic_and_ecef_and_back() -> None:
    expected = np.array(PLACES)
    lat, lon, alt = earth.ecef_to_geodetic(earth.geodetic_to_ecef(*expected.T))
    np.testing.assert_allclose(lat, expected[:, 0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(alt, expected[:, 2], rtol=0, atol=1e-6)
    # Longitude has no meaning at the poles: compare metres.
    apart = np.radians(lon - expected[:, 1]) * np.cos(np.radians(lat)) * earth.A
    assert np.abs(apart).max() < 1e-6


@pytest.mark.parametrize(
    ("place", "ecef"),
    [
        ((0, 0, 0), (6378137.0, 0, 0)),
        ((0, 180, 1000), (-6379137.0, 0, 0)),
        ((90, 0, 0), (0, 0, 6356752.314245)),
        ((-90, 0, 10), (0, 0, -6356762.314245)),
    ],
)
def test_ecef_of_known_places(place: tuple[float, ...], ecef: tuple[float, ...]) -> None:
    np.testing.assert_allclose(earth.geodetic_to_ecef(*place), ecef, rtol=0, atol=1e-6)


@pytest.mark.parametrize("place", PLACES[::7])
def test_east_north_and_up_point_there(place: tuple[float, float, float]) -> None:
    origin = LatLonAlt(*place)
    position = np.array([[0, 0, 0], [300.0, 0, 0], [0, 300.0, 0], [0, 0, 300.0], [-2000, 900, 7]])
    ecef = earth.enu_to_ecef(position, origin)
    np.testing.assert_allclose(earth.ecef_to_enu(ecef, origin), position, rtol=0, atol=1e-8)
    np.testing.assert_allclose(
        np.linalg.norm(ecef - ecef[0], axis=1), np.linalg.norm(position, axis=1), atol=1e-8
    )
    lat, lon, alt = earth.enu_to_geodetic(position, origin)
    assert alt[3] == pytest.approx(place[2] + 300, abs=1e-6)
    if abs(place[0]) < 80:
        assert (lon[1] - lon[0]) % 360 < 1
        assert lat[2] > lat[0]


@pytest.mark.parametrize(
    ("lat", "alt", "expected"),
    # WGS84's normal gravity at the equator and the poles, and at 45 degrees; 3.086e-6 per metre.
    [
        (0, 0, 9.7803253359),
        (90, 0, 9.8321849379),
        (-90, 0, 9.8321849379),
        (45, 0, 9.8061977694),
        (45, 1000, 9.8061977694 - 3.085e-3),
    ],
)
def test_gravity(lat: float, alt: float, expected: float) -> None:
    assert earth.gravity(lat, alt) == pytest.approx(expected, abs=2e-6)


def test_magnetic_field_is_of_norm_one_and_dips_to_the_north() -> None:
    field = earth.magnetic_field()
    assert np.linalg.norm(field) == pytest.approx(1, abs=1e-15)
    assert field[0] == 0
    assert np.degrees(np.arctan2(-field[2], field[1])) == pytest.approx(67)


@pytest.mark.parametrize(
    ("alt", "pascal"),
    # ISO 2533.
    [
        (-1000, 113929),
        (0, 101325),
        (1000, 89874.6),
        (5000, 54019.9),
        (11000, 22632.1),
        (15000, 12044.6),
        (20000, 5474.9),
    ],
)
def test_pressure(alt: float, pascal: float) -> None:
    # The tables count in geopotential metres, as the formula does.
    assert earth.pressure(alt) == pytest.approx(pascal, rel=2e-5)
