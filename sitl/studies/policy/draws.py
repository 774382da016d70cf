"""Random setpoints, parameters and references of a sequence."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from random import Random
from typing import NamedTuple

from trimtab.firmware_model.flight.track import Track
from trimtab.firmware_model.law.reference import septic
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import NEUTRAL_BLOCK, FeedForward, Node, Reference, YawNode
from trimtab.protocol.messages import Message, mavlink
from trimtab.protocol.parameters import PARAMETERS, Parameter

REAL32 = mavlink.MAV_PARAM_TYPE_REAL32
_REST = (0.0,) * 9
_POSITION, _VELOCITY, _ACCELERATION = 0b111, 0b111 << 3, 0b111 << 6
_YAW, _YAW_RATE = 1 << 10, 1 << 11
_FRAMES = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_LOCAL_OFFSET_NED, mavlink.MAV_FRAME_BODY_NED)
_STRANGE = (math.nan, math.inf, -math.inf, 1e30, -1e6)

RANGES: dict[str, tuple[float, float]] = {
    "FS_TILT_DEG": (60.0, 120.0), "FS_TILT_S": (0.1, 1.0), "FS_MOCAP_S": (0.2, 2.0), "FS_LINK_S": (0.5, 5.0),
    "FS_AGE_S": (0.05, 0.3), "FS_LATE_S": (0.3, 3.0), "FS_OFFB_S": (0.1, 10.0), "FS_OFFB_HOLD_S": (0.0, 5.0),
    "FS_BAT_SHARE": (0.0, 0.3), "FS_SAT_S": (0.3, 5.0), "FS_IMU_S": (0.0, 0.2), "FS_FENCE_M": (0.1, 1.5),
    "FS_FENCE_S": (0.0, 2.0), "LIM_SPEED": (1.0, 10.0), "LIM_TILT_DEG": (20.0, 60.0),
    "LIM_RATE_X": (2.0, 10.0), "LIM_RATE_Y": (2.0, 10.0), "LIM_RATE_Z": (1.0, 5.0),
    "LIM_JERK": (20.0, 200.0), "FENCE_N_MIN": (-10.0, -1.5), "FENCE_N_MAX": (1.5, 10.0),
    "FENCE_E_MIN": (-10.0, -1.5), "FENCE_E_MAX": (1.5, 10.0), "FENCE_D_MIN": (-8.0, -1.0),
    "FENCE_D_MAX": (0.1, 1.0), "TAKEOFF_SPEED": (0.5, 3.0), "TAKEOFF_HEIGHT": (0.4, 5.0),
    "HOVER_S": (0.0, 1.0), "HOLD_S": (0.0, 3.0), "LAND_SPEED": (0.3, 0.7), "LAND_DECEL": (1.0, 10.0),
    "OFFB_ACCEL": (1.0, 8.0), "OFFB_TURN": (0.3, 3.0), "OFFB_HEIGHT": (0.1, 0.6), "ARM_TILT_DEG": (5.0, 30.0),
    "EST_JUMP_M": (0.2, 1.0), "EST_JUMP_SPEED": (1.0, 5.0), "OBS_GAIN": (0.0, 4.0), "IDLE_S": (1.0, 30.0),
    "OWN_OTHERS": (0, 2), "FS_LOOP_MAX": (20, 200), "EST_CLASH": (0, 20),
}  # fmt: skip
"""Parameters that a sequence changes on the floor, and their ranges. Within them all invariants hold.

They leave the vehicle's own data and the gains of the control law as they are.
"""


class Stream(NamedTuple):
    """Setpoints that a station sends: the interval, the end, and the function that makes one."""

    interval_us: int
    until_us: int
    make: Callable[[], Message]


def _rarely_strange(rng: Random, value: float) -> float:
    return rng.choice(_STRANGE) if rng.random() < 0.01 else value


def position_target(rng: Random) -> Message:
    """Return a SET_POSITION_TARGET_LOCAL_NED of a random kind."""
    kind = rng.randrange(10)
    frame = mavlink.MAV_FRAME_LOCAL_NED
    if kind < 3:
        mask = _VELOCITY | _ACCELERATION
    elif kind < 7:
        mask, frame = _POSITION | _ACCELERATION, rng.choice(_FRAMES)
    elif kind == 7:
        mask = rng.choice((_ACCELERATION, 0))
    else:
        mask, frame = rng.getrandbits(9), rng.choice((*_FRAMES, 9, 0))
    mask |= rng.choice((_YAW | _YAW_RATE, _YAW, _YAW_RATE))
    reach = rng.choice((1.0, 3.0, 12.0))
    speed = rng.choice((0.5, 2.0, 8.0))
    numbers = (
        *(rng.uniform(-reach, reach) for _ in range(2)),
        rng.uniform(-1.5 * reach, 0.5),
        *(rng.uniform(-speed, speed) for _ in range(3)),
        *(rng.uniform(-5.0, 5.0) for _ in range(3)),
        rng.uniform(-4.0, 4.0),
        rng.uniform(-2.0, 2.0),
    )
    return m.SetPositionTarget(0, 1, 1, frame, mask, *(_rarely_strange(rng, each) for each in numbers))


def attitude_target(rng: Random) -> Message:
    """Return a SET_ATTITUDE_TARGET of a random kind: mostly an attitude, sometimes body rates."""
    tilt = math.radians(rng.choice((0.0, 10.0, 30.0, 60.0)))
    axis, yaw = rng.uniform(-math.pi, math.pi), rng.choice((0.0, rng.uniform(-math.pi, math.pi)))
    cos_half, sin_half = math.cos(0.5 * tilt), math.sin(0.5 * tilt)
    c, s = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    x, y = sin_half * math.cos(axis), sin_half * math.sin(axis)
    q = [c * cos_half, c * x - s * y, c * y + s * x, s * cos_half]
    thrust = rng.choice((rng.uniform(0.15, 0.3), rng.uniform(0.15, 0.3), rng.random(), 0.0, 1.0))
    kind = rng.randrange(20)
    most = rng.choice((0.3, 1.0, 6.0)) if kind < 3 else 0.0
    rates = [rng.uniform(-most, most) for _ in range(3)]
    mask = 0b1000_0000 if kind < 3 else 0
    if kind == 19:
        mask = rng.getrandbits(8)
    values = [_rarely_strange(rng, each) for each in (*q, *rates, thrust)]
    return m.SetAttitudeTarget(0, 1, 1, mask, values[:4], *values[4:])


def stream(rng: Random, now_us: int, attitudes: float) -> Stream:
    """Return a stream of setpoints that are the same, or random each; attitudes: share of that kind."""
    make = attitude_target if rng.random() < attitudes else position_target
    message = make(rng)
    until_us = now_us + round(1e6 * rng.choice((0.05, 0.3, 1.0, 3.0)))
    interval_us = rng.choice((10_000, 20_000, 50_000, 200_000))
    if rng.random() < 0.25:
        return Stream(interval_us, until_us, lambda: make(rng))
    return Stream(interval_us, until_us, lambda: message)


def parameter(rng: Random, *, flying: bool) -> Message:
    """Return a PARAM_SET: of RANGES on the floor, of any in flight, and sometimes one to be refused."""
    if flying:
        row = rng.choice(PARAMETERS)
        value = _allowed(rng, row)
    else:
        name = rng.choice(list(RANGES))
        low, high = RANGES[name]
        row = next(each for each in PARAMETERS if each.name == name)
        value = float(rng.randint(int(low), int(high))) if row.integer else rng.uniform(low, high)
    if rng.random() < 0.1:
        value = rng.choice((math.nan, math.inf, -1e30, row.max + 1.0 + abs(row.max)))
    name = row.name if rng.random() < 0.98 else "NO_SUCH"
    return m.ParamSet(1, 1, name.encode(), value, REAL32)


def _allowed(rng: Random, row: Parameter) -> float:
    value = rng.choice((row.default * rng.uniform(0.8, 1.2), rng.uniform(row.min, row.max)))
    value = min(max(value, row.min), row.max)
    return float(round(value)) if row.integer else value


@lru_cache(maxsize=256)
def reference(vehicle_id: str, number: int) -> Reference:
    """Return a reference of random legs, at rest at both ends; `number` decides."""
    rng = Random(number)
    nodes: list[Node] = []
    start, t_us = _place(rng), 0
    for _ in range(rng.randint(1, 3)):
        end = _place(rng)
        seconds = max(0.8, math.dist(start, end) * rng.choice((0.4, 0.8, 1.5)))
        us = round(1e6 * seconds)
        for k in range(8):
            p, v, a, j, _ = septic(seconds, seconds * k / 8, (*start, *_REST), (*end, *_REST))
            nodes.append(Node(t_us + us * k // 8, (*p, *v, *a, *j)))
        start, t_us = end, t_us + us
    nodes.append(Node(t_us, (*start, *_REST)))
    yaws = (YawNode(0, 0.0, 0.0), YawNode(t_us, rng.uniform(-1.0, 1.0), 0.0))
    return Reference(vehicle_id=vehicle_id, origin_ned=(0.0, 0.0, 0.0), nodes=tuple(nodes), yaws=yaws)


def _place(rng: Random) -> tuple[float, float, float]:
    return rng.uniform(-1.5, 1.5), rng.uniform(-1.5, 1.5), rng.uniform(-2.5, -0.6)


def following(rng: Random, vehicle_id: str, live: Track, at_us: int) -> Reference:
    """Return a reference that goes on from `live` at a time, to rest at a random place."""
    state = live.state_at(at_us)
    end, seconds = (*_place(rng), *_REST), rng.uniform(1.5, 3.0)
    us = round(1e6 * seconds)
    nodes = []
    for k in range(13):
        p, v, a, j, _ = septic(seconds, seconds * k / 12, state[:12], end)
        nodes.append(Node(us * k // 12, (*p, *v, *a, *j)))
    yaws = (YawNode(0, state[12], state[13]), YawNode(us, state[12], 0.0))
    return Reference(
        vehicle_id=vehicle_id, origin_ned=(0.0, 0.0, 0.0), nodes=tuple(nodes), yaws=yaws, free_ends=True
    )


def feedforward(rng: Random, vehicle_id: str) -> FeedForward:
    """Return a feed-forward with a gain near 1 and a small bias."""
    bias = tuple(rng.uniform(-0.3, 0.3) for _ in range(3))
    block = (rng.uniform(0.9, 1.1), *bias, *NEUTRAL_BLOCK[4:])
    return FeedForward(vehicle_id=vehicle_id, model_id="0123456789ab", block=block)


def damaged(rng: Random, blob: bytes) -> bytes:
    """Return a blob with one bit flipped."""
    data = bytearray(blob)
    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


def shifted(blob: Reference, rng: Random) -> Reference:
    """Return a reference elsewhere, mostly outside the fence."""
    return replace(blob, origin_ned=tuple(rng.uniform(-12.0, 12.0) for _ in range(3)))
