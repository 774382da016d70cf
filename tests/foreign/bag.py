"""ROS bags, written by rosbags."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

ACTUATORS = "actuator_msgs/msg/Actuators"
ACTUATORS_FIELDS = "std_msgs/Header header\nfloat64[] position\nfloat64[] velocity\nfloat64[] normalized\n"
EPOCH_NS = 1_772_660_536_000_000_000


def typed(store: Any, name: str, **fields: Any) -> Any:
    return store.types[name](**fields)


def header(store: Any, t_ns: int, ros1: bool) -> Any:
    stamp = typed(store, "builtin_interfaces/msg/Time", sec=t_ns // 10**9, nanosec=t_ns % 10**9)
    more = {"seq": 0} if ros1 else {}
    return typed(store, "std_msgs/msg/Header", stamp=stamp, frame_id="world", **more)


def messages(store: Any, flight: Any, ros1: bool, vehicles: int) -> Iterator[tuple[str, str, int, Any]]:
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
        empty = np.zeros(0)
        command = typed(
            store,
            ACTUATORS,
            header=head,
            position=empty,
            velocity=empty,
            normalized=np.ascontiguousarray(flight.motor[k]),
        )
        yield "/cf0/motors", ACTUATORS, t_ns + 3_000_000, command


def write_bag(flight: Any, path: Path, kind: str, vehicles: int = 1, *, compressed: bool = False) -> None:
    """The flight, in nwu and flu, as a bag of a kind: ros1, sqlite3 or mcap. The latter is a folder.

    Chunks of ros1 and mcap can be compressed.
    """
    from rosbags import rosbag1, rosbag2, typesys

    ros1 = kind == "ros1"
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if ros1 else typesys.Stores.ROS2_HUMBLE)
    writer: Any
    if ros1:
        writer = rosbag1.Writer(path)
        if compressed:
            writer.set_compression(writer.CompressionFormat.LZ4)
    else:
        plugin = rosbag2.StoragePlugin.MCAP if kind == "mcap" else rosbag2.StoragePlugin.SQLITE3
        writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
        if compressed:
            writer.set_compression(rosbag2.CompressionMode.STORAGE, rosbag2.CompressionFormat.ZSTD)
    store.register(typesys.get_types_from_msg(ACTUATORS_FIELDS, ACTUATORS))
    connections: dict[str, Any] = {}
    with writer:
        for name, kind_of, at_ns, message in messages(store, flight, ros1, vehicles):
            if name not in connections:
                connections[name] = writer.add_connection(name, kind_of, typestore=store)
            serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
            writer.write(connections[name], at_ns, serialize(message, kind_of))
