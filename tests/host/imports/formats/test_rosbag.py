"""Bags that rosbags wrote: ROS 1, ROS 2 with SQLite and MCAP."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.narrowing import not_none
from trimtab.host.imports import ImportFormatError
from trimtab.host.imports.formats import recognise, rosbag
from trimtab.host.imports.formats.rosbag import read, read_map
from trimtab.host.vehicle import ConfigurationError

rosbag1 = pytest.importorskip(
    "rosbags.rosbag1", reason="rosbags is not installed; pip install 'trimtab[logs]'"
)
rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

EPOCH_NS = 1_772_660_536_000_000_000
Bag = Callable[..., Path]


def typed(store: Any, name: str, **fields: Any) -> Any:
    return store.types[name](**fields)


def header(store: Any, t_ns: int, ros1: bool) -> Any:
    stamp = typed(store, "builtin_interfaces/msg/Time", sec=t_ns // 10**9, nanosec=t_ns % 10**9)
    more = {"seq": 0} if ros1 else {}
    return typed(store, "std_msgs/msg/Header", stamp=stamp, frame_id="world", **more)


def messages(store: Any, flight: Any, ros1: bool, vehicles: int = 1) -> Any:
    """Topic, type, time of reception and message, in the order of reception."""
    xyz = "xyz"
    for k, t in enumerate(flight.t.tolist()):
        t_ns = EPOCH_NS + round(1e9 * t)
        head = header(store, t_ns, ros1)
        p = typed(store, "geometry_msgs/msg/Point", **dict(zip(xyz, flight.p[k].tolist(), strict=True)))
        q = typed(
            store,
            "geometry_msgs/msg/Quaternion",
            **dict(zip("xyzw", flight.turn[k].as_quat().tolist(), strict=True)),
        )
        pose = typed(store, "geometry_msgs/msg/Pose", position=p, orientation=q)
        if k % 2 == 0:
            for n in range(vehicles):
                yield (
                    f"/cf{n}/pose",
                    "geometry_msgs/msg/PoseStamped",
                    t_ns + 3_000_000,
                    typed(store, "geometry_msgs/msg/PoseStamped", header=head, pose=pose),
                )
        vector = "geometry_msgs/msg/Vector3"
        imu = typed(
            store,
            "sensor_msgs/msg/Imu",
            header=head,
            orientation=q,
            orientation_covariance=np.zeros(9),
            angular_velocity=typed(store, vector, **dict(zip(xyz, flight.gyro[k].tolist(), strict=True))),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=typed(store, vector, **dict(zip(xyz, flight.force[k].tolist(), strict=True))),
            linear_acceleration_covariance=np.zeros(9),
        )
        yield "/cf0/imu", "sensor_msgs/msg/Imu", t_ns + 3_000_000, imu


@pytest.fixture
def bag(tmp_path: Path, made_up: Any, foreign: Any) -> Bag:
    """Writes the flight as a bag of a kind, ros1, sqlite3 or mcap."""

    def write(kind: str, vehicles: int = 1) -> Path:
        flight = foreign.in_axes(made_up, "nwu", "flu")
        ros1 = kind == "ros1"
        store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if ros1 else typesys.Stores.ROS2_HUMBLE)
        path = tmp_path / ("flight.bag" if ros1 else "flight")
        if ros1:
            writer = rosbag1.Writer(path)
        else:
            plugin = rosbag2.StoragePlugin.MCAP if kind == "mcap" else rosbag2.StoragePlugin.SQLITE3
            writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
        connections: dict[str, Any] = {}
        with writer:
            for name, kind_of, at_ns, message in messages(store, flight, ros1, vehicles):
                if name not in connections:
                    connections[name] = writer.add_connection(name, kind_of, typestore=store)
                serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
                writer.write(connections[name], at_ns, serialize(message, kind_of))
        return path

    return write


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
def test_bag_is_read_at_the_rates_and_stamps_of_its_topics(bag: Bag, made_up: Any, kind: str) -> None:
    path = bag(kind)
    assert recognise(path) == "rosbag"
    found = read(path)
    np.testing.assert_array_equal(found.pose_us, np.round(1e6 * made_up.t[::2]))
    np.testing.assert_allclose(found.p_ned, made_up.p[::2], atol=1e-12)
    apart = Rotation.from_quat(found.q_ned_frd, scalar_first=True).inv() * made_up.turn[::2]
    assert apart.magnitude().max() < 1e-9
    np.testing.assert_array_equal(not_none(found.imu_us), np.round(1e6 * made_up.t))
    np.testing.assert_allclose(not_none(found.gyro), made_up.gyro, atol=1e-12)
    np.testing.assert_allclose(not_none(found.specific_force), made_up.force, atol=1e-12)
    rates = {topic.name.partition(" ")[0]: topic.rate_hz for topic in rosbag.contents(path).topics}
    assert rates == {"/cf0/imu": pytest.approx(100.0, rel=0.01), "/cf0/pose": pytest.approx(50.0, rel=0.01)}


def test_mcap_file_alone_is_a_bag(bag: Bag, made_up: Any) -> None:
    (file,) = bag("mcap").glob("*.mcap")
    assert recognise(file) == "rosbag"
    np.testing.assert_allclose(read(file).p_ned, made_up.p[::2], atol=1e-12)


def test_two_vehicles_in_one_bag_are_named(bag: Bag) -> None:
    with pytest.raises(ImportFormatError, match=r"flight: several vehicles \(/cf0/pose, /cf1/pose\)"):
        read(bag("sqlite3", vehicles=2))


def test_topic_map_chooses_the_vehicle_and_the_axes(bag: Bag, made_up: Any, tmp_path: Path) -> None:
    path, chosen = bag("sqlite3", vehicles=2), tmp_path / "map.toml"
    chosen.write_text('pose = "/cf1/pose"\nworld = "enu"\n')
    found = read(path, read_map(chosen))
    # The file's axes are nwu: read as enu, west counts as north.
    np.testing.assert_allclose(found.p_ned, made_up.p[::2] @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('pose = "/cf7/pose"', "no topic /cf7/pose with messages for pose"),
        ('pose = "/cf0/imu"', "no topic /cf0/imu with messages for pose"),
        ('poses = "/cf0/pose"', "poses: unknown key"),
        ("motor_command_full = 0.5\nmotor_command_zero = 1", "motor_command_zero has to be below"),
    ],
)
def test_topic_map_that_does_not_fit_is_refused(bag: Bag, tmp_path: Path, text: str, said: str) -> None:
    chosen = tmp_path / "map.toml"
    chosen.write_text(text)
    with pytest.raises((ImportFormatError, ConfigurationError), match=said):
        read(bag("sqlite3"), read_map(chosen))


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(at=st.floats(0.0, 1.0), junk=st.binary(max_size=40), length=st.floats(0.0, 1.0))
def test_damaged_bag_is_refused_or_read(
    tmp_path: Path, whole: bytes, at: float, junk: bytes, length: float
) -> None:
    k = int(at * len(whole))
    data = whole[:k] + junk + whole[k + len(junk) :]
    path = tmp_path / "hurt.bag"
    path.write_bytes(data[: int(length * len(data))])
    try:
        read(path)
    except ImportFormatError as error:
        assert "hurt.bag" in str(error)  # noqa: PT017 (either outcome is good)


@pytest.fixture
def whole(bag: Bag) -> bytes:
    return bag("ros1").read_bytes()
