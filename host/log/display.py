"""The topics of a log that viewers draw, in Foxglove's well-known schemas.

Values are those of the other topics, in the same frames: `ned`, and `body_frd`, which moves with the vehicle.
Viewers draw z upwards. The root is therefore the frame `world` (x east, y north, z up), and one transform
places `ned` in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from math import dist, hypot, isfinite, sqrt
from pathlib import Path
from typing import Any

from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.timestamp_pb2 import Timestamp

from trimtab.host.log import topics
from trimtab.host.log.residual import NominalResidual
from trimtab.host.vehicle import Vehicle

FOXGLOVE_LAYOUT = Path(__file__).with_name("foxglove.json")
"""Layout of Foxglove's panels for a flight log."""
WORLD = "world"
NED = "ned"
BODY = "body_frd"
PERIOD_US = 50_000
"""At most one message of a topic in each period of this length."""
_WORLD_FROM_NED = (0.0, sqrt(0.5), sqrt(0.5), 0.0)
"""w first; half a turn about the diagonal between x and y."""
_ARROW_LIFETIME_US = 4 * PERIOD_US
_ROTOR_RADIUS = 0.4
"""Radius that rotors are drawn with, as a share of the smallest distance between two of them."""
_FRONT = Color(r=0.9, g=0.2, b=0.2, a=0.8)
_REAR = Color(r=0.3, g=0.35, b=0.4, a=0.8)
_ARMS = Color(r=0.3, g=0.35, b=0.4, a=1.0)
_RESIDUAL = Color(r=1.0, g=0.55, b=0.0, a=1.0)

Write = Callable[[str, Any, int, int], bool]
"""Writes topic, message, log time and publish time, us."""


class Display:
    """Writes the display topics of one log with `write`: vehicle and frames now, the path at the end.

    Of each topic, the first message of every period is written. Times are us from arm.
    """

    def __init__(self, write: Write, vehicle: Vehicle) -> None:
        self._write = write
        self._periods: dict[str, int] = {}
        self._path_ned: list[Sequence[float]] = []
        self._transform = FrameTransform(parent_frame_id=NED, child_frame_id=BODY)
        self._reference = PoseInFrame(frame_id=NED)
        self._arrow = _ResidualArrow(vehicle)
        world = FrameTransform(parent_frame_id=WORLD, child_frame_id=NED, timestamp=Timestamp())
        world.translation.SetInParent()
        _set_orientation(world.rotation, _WORLD_FROM_NED)
        write(topics.DISPLAY_WORLD, world, 0, 0)
        write(topics.DISPLAY_VEHICLE, SceneUpdate(entities=[_drawn(vehicle)]), 0, 0)

    def pose(self, log_us: int, publish_us: int, p_ned: Sequence[float], q_ned_frd: Sequence[float]) -> None:
        """Write `/display/pose`: the place of the body frame. Leave out a pose that is not finite."""
        if not (isfinite(sum(p_ned) + sum(q_ned_frd)) and self._is_due(topics.DISPLAY_POSE, publish_us)):
            return
        message = self._transform
        stamp(message.timestamp, publish_us)
        _set_vector(message.translation, p_ned)
        _set_orientation(message.rotation, q_ned_frd)
        if self._write(topics.DISPLAY_POSE, message, log_us, publish_us):
            self._path_ned.append(tuple(p_ned))

    def reference(
        self, log_us: int, publish_us: int, p_ned: Sequence[float], q_ned_frd: Sequence[float]
    ) -> None:
        """Write `/display/reference`: position and heading of the reference now."""
        if not self._is_due(topics.DISPLAY_REFERENCE, publish_us):
            return
        message = self._reference
        stamp(message.timestamp, publish_us)
        _set_vector(message.pose.position, p_ned)
        _set_orientation(message.pose.orientation, q_ned_frd)
        self._write(topics.DISPLAY_REFERENCE, message, log_us, publish_us)

    def reference_path(self, log_us: int, path_ned: Sequence[Sequence[float]]) -> None:
        """Write `/display/reference_path`: the path that is flown from now on, (points, 3)."""
        self._write(topics.DISPLAY_REFERENCE_PATH, _path(log_us, path_ned), log_us, log_us)

    def residual(self, log_us: int, publish_us: int, interval_us: int, means: Sequence[float]) -> None:
        """Write `/display/residual` from the means of one interval of `/fc/control`.

        means: motor (4,), gyro (3,), specific force (3,), FRD. The arrow shows the mean since the last one.
        """
        self._arrow.add(interval_us, means)
        if self._is_due(topics.DISPLAY_RESIDUAL, publish_us):
            self._write(topics.DISPLAY_RESIDUAL, self._arrow.take(publish_us), log_us, publish_us)

    def finish(self) -> None:
        """Write `/display/path`, with the time of the begin, so that viewers show it from there on."""
        if self._path_ned:
            self._write(topics.DISPLAY_PATH, _path(0, self._path_ned), 0, 0)

    def _is_due(self, topic: str, publish_us: int) -> bool:
        """Return whether the topic's last message was in another period."""
        period = publish_us // PERIOD_US
        if self._periods.get(topic) == period:
            return False
        self._periods[topic] = period
        return True


class _ResidualArrow:
    """The residual as an arrow at the vehicle, 1 m long for 1 m/s^2."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._residual = NominalResidual(vehicle)
        self._sum = (0.0, 0.0, 0.0)
        self._sum_us = 0
        self._message = SceneUpdate()
        entity = self._entity = self._message.entities.add(frame_id=BODY, id="residual", frame_locked=True)
        entity.lifetime.FromMicroseconds(_ARROW_LIFETIME_US)
        width = 0.15 * _rotor_radius(vehicle)
        self._arrow = entity.arrows.add(
            shaft_diameter=width, head_length=3.0 * width, head_diameter=2.0 * width, color=_RESIDUAL
        )
        self._arrow.pose.position.SetInParent()

    def add(self, interval_us: int, means: Sequence[float]) -> None:
        x, y, z = self._residual.push(interval_us, means[0:4], means[7:10])
        before = self._sum
        self._sum = before[0] + interval_us * x, before[1] + interval_us * y, before[2] + interval_us * z
        self._sum_us += interval_us

    def take(self, publish_us: int) -> SceneUpdate:
        """Return the arrow of the mean since the last one, and begin another mean."""
        x, y, z = (total / self._sum_us for total in self._sum)
        self._sum, self._sum_us = (0.0, 0.0, 0.0), 0
        stamp(self._entity.timestamp, publish_us)
        length = self._arrow.shaft_length = hypot(x, y, z)
        _set_orientation(self._arrow.pose.orientation, _turn_from_x(x, y, z, length))
        return self._message


def _turn_from_x(x: float, y: float, z: float, length: float) -> tuple[float, float, float, float]:
    """Return the shortest rotation, w first, from the x axis to a vector of this length."""
    w = length + x
    if w <= 1e-9 * length:  # the opposite direction, or no length
        return 0.0, 0.0, 0.0, 1.0
    norm = sqrt(w * w + z * z + y * y)
    return w / norm, 0.0, -z / norm, y / norm


def _drawn(vehicle: Vehicle) -> SceneEntity:
    """Return arms and rotors of a vehicle in its body frame, the front rotors in red."""
    radius = _rotor_radius(vehicle)
    entity = SceneEntity(frame_id=BODY, id=vehicle.name, frame_locked=True, timestamp=Timestamp())
    arms = entity.lines.add(type=LinePrimitive.LINE_LIST, thickness=0.15 * radius, color=_ARMS)
    arms.pose.position.SetInParent()
    arms.pose.orientation.w = 1.0
    for rotor in vehicle.rotors:
        x, y, z = rotor.position_m
        arms.points.add()
        arms.points.add(x=x, y=y, z=z)
        disc = entity.cylinders.add(bottom_scale=1.0, top_scale=1.0, color=_FRONT if x > 0.0 else _REAR)
        _set_vector(disc.pose.position, rotor.position_m)
        disc.pose.orientation.w = 1.0
        _set_vector(disc.size, (2.0 * radius, 2.0 * radius, 0.1 * radius))
    return entity


def _rotor_radius(vehicle: Vehicle) -> float:
    """Return the radius that rotors are drawn with, m. Vehicle files do not state it."""
    places = [rotor.position_m for rotor in vehicle.rotors]
    return _ROTOR_RADIUS * min(dist(a, b) for a, b in combinations(places, 2))


def _path(time_us: int, path_ned: Sequence[Sequence[float]]) -> PosesInFrame:
    message = PosesInFrame(frame_id=NED)
    stamp(message.timestamp, time_us)
    for point in path_ned:
        pose = message.poses.add()
        _set_vector(pose.position, point)
        pose.orientation.w = 1.0
    return message


def stamp(timestamp: Any, time_us: int) -> None:
    """Set a protobuf timestamp to a time from arm; to 0 if it lies before."""
    timestamp.seconds, fraction_us = divmod(max(time_us, 0), 1_000_000)
    timestamp.nanos = fraction_us * 1000


def _set_vector(message: Any, vector: Sequence[float]) -> None:
    message.x, message.y, message.z = vector


def _set_orientation(message: Any, q: Sequence[float]) -> None:
    message.w, message.x, message.y, message.z = q
