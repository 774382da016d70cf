"""A ROS 2 bag of setpoints: pose, velocity and acceleration as messages of geometry_msgs.

By REP 103 the world is ENU (x east, y north, z up) and yaw is counterclockwise from east. The pose is level:
it holds the heading only. All three are in the frame `map`, also velocity and acceleration.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from trimtab.host.base.artefacts import folder_atomic
from trimtab.host.base.extras import optional
from trimtab.host.export.samples import at_rate
from trimtab.protocol.blobs import Reference

TOPICS = {
    "/setpoint/pose": "geometry_msgs/msg/PoseStamped",
    "/setpoint/velocity": "geometry_msgs/msg/TwistStamped",
    "/setpoint/acceleration": "geometry_msgs/msg/AccelStamped",
}
_VERSION = 9


def write_bag(reference: Reference, rate_hz: float, folder: Path) -> int:
    """Write a bag in the MCAP format as a new folder, whole or not at all. Return its number of setpoints.

    Message times begin at 0. Raises UsageError without the package rosbags, or if the folder cannot be made.
    """
    rosbag2, typesys = optional("rosbags.rosbag2", "logs"), optional("rosbags.typesys", "logs")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    held = at_rate(reference, rate_hz)
    p, v, a = (values[:, [1, 0, 2]] * [1.0, 1.0, -1.0] for values in (held.p_ned, held.v_ned, held.a_ned))
    yaw, times_ns = 0.5 * np.pi - held.yaw, np.rint(1e9 * held.t_s).astype(np.int64).tolist()

    def made(name: str, **fields: Any) -> Any:
        return store.types[name](**fields)

    def vector(kind: str, values: np.ndarray) -> Any:
        return made(f"geometry_msgs/msg/{kind}", **dict(zip("xyz", values.tolist(), strict=True)))

    still = vector("Vector3", np.zeros(3))
    with folder_atomic(folder) as partial:
        writer = rosbag2.Writer(partial, version=_VERSION, storage_plugin=rosbag2.StoragePlugin.MCAP)
        with writer:
            connections = [writer.add_connection(*topic, typestore=store) for topic in TOPICS.items()]
            for k, t_ns in enumerate(times_ns):
                stamp = made("builtin_interfaces/msg/Time", sec=t_ns // 10**9, nanosec=t_ns % 10**9)
                header = made("std_msgs/msg/Header", stamp=stamp, frame_id="map")
                half = 0.5 * float(yaw[k])
                turn = made(
                    "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=float(np.sin(half)), w=float(np.cos(half))
                )
                pose = made("geometry_msgs/msg/Pose", position=vector("Point", p[k]), orientation=turn)
                spin = vector("Vector3", np.array([0.0, 0.0, -held.yaw_rate[k]]))
                twist = made("geometry_msgs/msg/Twist", linear=vector("Vector3", v[k]), angular=spin)
                accel = made("geometry_msgs/msg/Accel", linear=vector("Vector3", a[k]), angular=still)
                bodies = ({"pose": pose}, {"twist": twist}, {"accel": accel})
                for connection, kind, body in zip(connections, TOPICS.values(), bodies, strict=True):
                    message = made(kind, header=header, **body)
                    writer.write(connection, t_ns, store.serialize_cdr(message, kind))
    return len(times_ns)
