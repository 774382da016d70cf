"""Reader of ROS 1 and ROS 2 bags by rosbags: .bag, .db3, .mcap, and folders of rosbag2.

Topics are chosen by the type of their messages, and by their rate if several have one type. ROS's own types
have a z-up world (nwu here) and an FLU body; those of px4_msgs have NED and FRD. Messages are read one at a
time, and only those of the chosen topics.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import Field, model_validator

from trimtab.host.base.bounds import TooLarge
from trimtab.host.base.extras import optional
from trimtab.host.base.text import escaped
from trimtab.host.imports.contents import Contents, topic
from trimtab.host.imports.formats.bag_bounds import bounded
from trimtab.host.imports.formats.ulog import CORNERS as PX4_CORNERS
from trimtab.host.imports.formats.ulog import UNKNOWN
from trimtab.host.imports.frames import Body, World, q_ned_frd, to_frd, to_ned, turn_from_quaternion
from trimtab.host.imports.recording import (
    Corner,
    ImportFormatError,
    MissingFile,
    Recording,
    fresh,
)
from trimtab.host.imports.tracks import Track, command_shares, sound_track, turns_at
from trimtab.host.vehicle.files import read_text
from trimtab.host.vehicle.strict_toml import Strict, read_strict

Quantity = Literal["pose", "position", "attitude", "imu", "motors", "voltage", "reference"]

QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)

_ROTORS = 4

MAGICS = (b"#ROSBAG V", b"\x89MCAP0\r\n", b"SQLite format 3\x00")
OWN_LIBRARY = b"trimtab"
"""What the head of a Trimtab log holds."""

REPAIRS = {".bag": "rosbag reindex", ".mcap": "mcap recover"}
"""Commands that repair a bag whose index is damaged or missing; a rosbag2 folder has another."""

STAMPED_US = 1_000_000
"""A topic whose stamps differ from the time of their reception by more has another clock."""

_SIMILAR = 0.5
"""Two topics with message counts closer than this ratio may both be the vehicle."""


class TopicMap(Strict):
    """Topics of a bag to read instead of the guessed ones, and what their types do not tell."""

    pose: str | None = None
    position: str | None = None
    attitude: str | None = None
    imu: str | None = None
    motors: str | None = None
    voltage: str | None = None
    reference: str | None = None
    world: World | None = None
    """Axes of positions, instead of those of the type."""
    body: Body | None = None
    """Axes of the body, instead of those of the type."""
    motor_command_full: Annotated[float, Field(gt=0.0)] = 1.0
    """Value of a full motor command."""
    motor_command_zero: float = 0.0
    """Value of no motor command."""

    @model_validator(mode="after")
    def _has_a_range(self) -> TopicMap:
        if not self.motor_command_zero < self.motor_command_full:
            raise ValueError("motor_command_zero has to be below motor_command_full")
        return self

    def topic(self, quantity: Quantity) -> str | None:
        """Return the topic that is given for a quantity; None for a guess."""
        given: str | None = getattr(self, quantity)
        return given


GUESSED = TopicMap()
"""A map that gives nothing."""


@dataclass(frozen=True, kw_only=True)
class Kind:
    """What a type of message holds: a quantity, its axes, and how to take its numbers from a message.

    A pose is a position and a quaternion with w first; imu is a body rate and a specific force.
    """

    quantity: Quantity
    take: Callable[[Any], Sequence[float]]
    world: World = "nwu"
    body: Body = "flu"
    corners: tuple[Corner, Corner, Corner, Corner] | None = None


def _pose(pose: Any) -> tuple[float, ...]:
    p, q = pose.position, pose.orientation
    return p.x, p.y, p.z, q.w, q.x, q.y, q.z


def _transform(t: Any) -> tuple[float, ...]:
    p, q = t.translation, t.rotation
    return p.x, p.y, p.z, q.w, q.x, q.y, q.z


def _imu(m: Any) -> tuple[float, ...]:
    w, f = m.angular_velocity, m.linear_acceleration
    return w.x, w.y, w.z, f.x, f.y, f.z


KINDS: dict[str, Kind] = {
    "geometry_msgs/msg/PoseStamped": Kind(quantity="pose", take=lambda m: _pose(m.pose)),
    "geometry_msgs/msg/TransformStamped": Kind(quantity="pose", take=lambda m: _transform(m.transform)),
    "nav_msgs/msg/Odometry": Kind(quantity="pose", take=lambda m: _pose(m.pose.pose)),
    "geometry_msgs/msg/PoseWithCovarianceStamped": Kind(quantity="pose", take=lambda m: _pose(m.pose.pose)),
    "px4_msgs/msg/VehicleOdometry": Kind(
        quantity="pose", take=lambda m: (*m.position, *m.q), world="ned", body="frd"
    ),
    "px4_msgs/msg/VehicleLocalPosition": Kind(
        quantity="position", take=lambda m: (m.x, m.y, m.z), world="ned"
    ),
    "px4_msgs/msg/VehicleAttitude": Kind(
        quantity="attitude", take=lambda m: tuple(m.q), world="ned", body="frd"
    ),
    "sensor_msgs/msg/Imu": Kind(quantity="imu", take=_imu),
    "px4_msgs/msg/SensorCombined": Kind(
        quantity="imu", take=lambda m: (*m.gyro_rad, *m.accelerometer_m_s2), body="frd"
    ),
    "px4_msgs/msg/ActuatorMotors": Kind(
        quantity="motors", take=lambda m: tuple(m.control[:_ROTORS]), corners=PX4_CORNERS
    ),
    "actuator_msgs/msg/Actuators": Kind(quantity="motors", take=lambda m: tuple(m.normalized[:_ROTORS])),
    "mav_msgs/msg/Actuators": Kind(quantity="motors", take=lambda m: tuple(m.normalized[:_ROTORS])),
    "sensor_msgs/msg/BatteryState": Kind(quantity="voltage", take=lambda m: (m.voltage,)),
    "px4_msgs/msg/BatteryStatus": Kind(quantity="voltage", take=lambda m: (m.voltage_v,)),
    "px4_msgs/msg/TrajectorySetpoint": Kind(
        quantity="reference", take=lambda m: tuple(m.position), world="ned"
    ),
}
"""By type of message, for each quantity in order of preference."""


def recognises(path: Path, head: bytes) -> bool:
    """Return whether the file is a bag, or the folder one of rosbag2. A Trimtab log is none."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return head.startswith(MAGICS) and OWN_LIBRARY not in head[:200]


def contents(path: Path) -> Contents:
    """Return the topics of the bag with their types and mean rates. Raises ImportFormatError."""
    with _Bag(path) as bag:
        return Contents(
            topics=tuple(
                topic(f"{c.topic} ({c.msgtype})", c.msgcount, bag.duration_s) for c in bag.connections
            ),
            duration_s=bag.duration_s,
            notes=bag.notes(),
        )


def read_map(path: Path) -> TopicMap:
    """Return the topic map in a TOML file. Raises ConfigurationError (exit code 2) with every problem."""
    return read_strict(read_text(path), path.name, TopicMap)


def read(path: Path | str, topics: TopicMap = GUESSED) -> Recording:
    """Return the flight in a bag. Raises ImportFormatError with the file, the problem and the remedy."""
    path = Path(path)
    with _Bag(path) as bag:
        streams = bag.streams(topics)
    if not {"pose"} <= set(streams) and not {"position", "attitude"} <= set(streams):
        types = ", ".join(name for name, kind in KINDS.items() if kind.quantity in ("pose", "position"))
        raise ImportFormatError(f"{path.name}: no topic with poses; record one of {types}")
    start_us = min(int(stream.track.t_us[0]) for stream in streams.values())
    tracks: dict[Quantity, Track] = {
        name: Track(t_us=stream.track.t_us - start_us, values=stream.track.values)
        for name, stream in streams.items()
    }
    pose_us, p_ned, q = _poses(streams, tracks, path.name)
    motors, imu, voltage, reference = (tracks.get(name) for name in ("motors", "imu", "voltage", "reference"))
    return Recording(
        source=path.name,
        pose_us=pose_us,
        p_ned=p_ned,
        q_ned_frd=q,
        input_us=None if motors is None else motors.t_us,
        motor_command=None
        if motors is None
        else command_shares(motors.values, topics.motor_command_zero, topics.motor_command_full),
        motor_corners=None if motors is None else streams["motors"].kind.corners,
        imu_us=None if imu is None else imu.t_us,
        gyro=None if imu is None else to_frd(imu.values[:, :3], streams["imu"].kind.body),
        specific_force=None if imu is None else to_frd(imu.values[:, 3:], streams["imu"].kind.body),
        battery_us=None if voltage is None else voltage.t_us,
        battery_v=None if voltage is None else voltage.values[:, 0],
        reference_us=None if reference is None else reference.t_us,
        p_ref_ned=None if reference is None else to_ned(reference.values, streams["reference"].kind.world),
        epoch_us=start_us,
        unknown=UNKNOWN,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Stream:
    """The track of one quantity, in the axes of its kind."""

    kind: Kind
    track: Track


def _poses(
    streams: Mapping[Quantity, _Stream], tracks: Mapping[Quantity, Track], source: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, positions in NED and quaternions q_ned_frd of the poses."""
    try:
        if "pose" in streams:
            kind, track = streams["pose"].kind, tracks["pose"]
            turn = turn_from_quaternion(track.values[:, 3:], scalar_first=True)
            new = fresh(track.values)
            p = to_ned(track.values[:, :3], kind.world)
            return track.t_us[new], p[new], q_ned_frd(turn, kind.world, kind.body)[new]
        kind, position, attitude = streams["attitude"].kind, tracks["position"], tracks["attitude"]
        turn = turn_from_quaternion(attitude.values, scalar_first=True)
    except ValueError as error:
        raise ImportFormatError(f"{source}: {error}; cut the bag before that message") from None
    new = fresh(position.values)
    t_us = position.t_us[new]
    q = q_ned_frd(turns_at(attitude.t_us, turn, t_us), kind.world, kind.body)
    return t_us, to_ned(position.values[new], streams["position"].kind.world), q


class _Bag:
    """An open bag. A context manager."""

    def __init__(self, path: Path) -> None:
        self._name = path.name
        if not path.exists():
            raise MissingFile(f"{path}: cannot be read (no such file); check the path")
        highlevel = optional("rosbags.highlevel", "logs")
        self._bounds, self._budget = ExitStack(), None
        try:
            self._budget = self._bounds.enter_context(bounded(path))
            self._reader: Any = highlevel.AnyReader([path], default_typestore=_types())
            self._reader.open()
        except Exception as error:
            self._bounds.close()
            raise self._damaged(error) from None
        connections: list[Any] = self._reader.connections
        if not all(isinstance(text, str) for c in connections for text in (c.topic, c.msgtype)):
            self.close()  # a cell of SQLite may have any type
            raise self._damaged(TypeError())
        self.connections = sorted(connections, key=lambda c: c.topic)
        self.duration_s = max(0.0, self._reader.duration * 1e-9) if connections else 0.0

    def __enter__(self) -> _Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the bag."""
        self._reader.close()
        self._bounds.close()

    def streams(self, topics: TopicMap) -> dict[Quantity, _Stream]:
        """Return the values of each quantity that the bag holds."""
        chosen = self._chosen(topics)
        if not chosen:
            return {}  # without connections, the reader would give all messages
        stamps = {c.id: array("q") for c in chosen.values()}
        received = {c.id: array("q") for c in chosen.values()}
        values = {c.id: array("d") for c in chosen.values()}
        try:
            for connection, at_ns, raw in self._reader.messages(connections=list(chosen.values())):
                message = self._reader.deserialize(raw, connection.msgtype)
                values[connection.id].extend(KINDS[connection.msgtype].take(message))
                received[connection.id].append(at_ns // 1000)
                stamps[connection.id].append(_stamp_us(message))
        except Exception as error:
            raise self._damaged(error) from None
        streams: dict[Quantity, _Stream] = {}
        for quantity, c in chosen.items():
            count = len(received[c.id])
            if quantity == "motors" and len(values[c.id]) != _ROTORS * count:
                continue  # not four commands in each message; see `notes`
            track = _track(stamps[c.id], received[c.id], values[c.id]) if count > 1 else None
            if track is not None and len(track.t_us) > 1:
                kind = KINDS[c.msgtype]
                axes = {"world": topics.world or kind.world, "body": topics.body or kind.body}
                streams[quantity] = _Stream(kind=replace(kind, **axes), track=track)
        return streams

    def notes(self) -> tuple[str, ...]:
        """Return a line for each topic of motors whose first message has no four motor commands."""
        motors = [c for c in self.connections if c.msgtype in KINDS and KINDS[c.msgtype].quantity == "motors"]
        lines = []
        try:
            for c in motors:
                for _, _, raw in islice(self._reader.messages(connections=[c]), 1):
                    count = len(KINDS[c.msgtype].take(self._reader.deserialize(raw, c.msgtype)))
                    if count != _ROTORS:
                        lines.append(
                            f"{escaped(c.topic)}: {count} motor commands in a message, where {_ROTORS} are "
                            "needed (angular velocities are not read); the motors are left out"
                        )
        except Exception as error:
            raise self._damaged(error) from None
        return tuple(lines)

    def _chosen(self, topics: TopicMap) -> dict[Quantity, Any]:
        """Return the topic of each quantity.

        Raises ImportFormatError if two may be the vehicle's pose, or if a given one is missing.
        """
        chosen: dict[Quantity, Any] = {}
        order = list(KINDS)
        for quantity in QUANTITIES:
            able = [
                c
                for c in self.connections
                if c.msgcount and c.msgtype in KINDS and KINDS[c.msgtype].quantity == quantity
            ]
            given = topics.topic(quantity)
            if given is not None:
                able = [c for c in able if c.topic == given]
                if not able:
                    raise ImportFormatError(
                        f"{self._name}: no topic {escaped(given)} with messages for {quantity}; "
                        "correct the topic map"
                    )
            able.sort(key=lambda c: (order.index(c.msgtype), -c.msgcount, c.topic))
            if not able:
                continue
            first, *others = able
            rivals = [
                c for c in others if c.msgtype == first.msgtype and c.msgcount > _SIMILAR * first.msgcount
            ]
            if quantity == "pose" and rivals:
                names = escaped(", ".join(c.topic for c in (first, *rivals)))
                raise ImportFormatError(f"{self._name}: several vehicles ({names}); name one in a topic map")
            chosen[quantity] = first
        return chosen

    def _damaged(self, error: Exception) -> ImportFormatError:
        broken = str(error) if isinstance(error, TooLarge) else self._budget and self._budget.problem
        if broken:
            return ImportFormatError(f"{self._name}: {broken}")
        # rosbags reports damage by its own exceptions and by those its parsers run into.
        repair = REPAIRS.get(Path(self._name).suffix, "ros2 bag reindex")
        return ImportFormatError(
            f"{self._name}: not a whole bag ({type(error).__name__}); repair it with {repair}"
        )


@cache
def _types() -> Any:
    """Return the types of a bag that does not define its own."""
    typesys = optional("rosbags.typesys", "logs")
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


def _stamp_us(message: Any) -> int:
    """Return the time that a message states, us; 0 without one."""
    header = getattr(message, "header", None)
    if header is not None:
        return int(header.stamp.sec) * 1_000_000 + int(header.stamp.nanosec) // 1000
    return int(getattr(message, "timestamp_sample", 0) or getattr(message, "timestamp", 0))


def _track(stamps: array[int], received: array[int], values: array[float]) -> Track:
    """Return the finite values at increasing times, stamped if the stamps have the receiver's clock."""
    stamp_us, at_us = np.array(stamps, dtype=np.int64), np.array(received, dtype=np.int64)
    own = abs(float(np.median(stamp_us - at_us))) < STAMPED_US
    t_us = stamp_us if own else at_us
    return sound_track(t_us, np.array(values).reshape(len(t_us), -1))
