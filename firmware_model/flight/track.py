"""Tracks: timelines of septic position pieces and cubic yaw pieces.

A flight follows one track after another: climb and hover, the live reference, hold, descent. Each track is
built once, when its phase starts. A tick then only advances the time inside the current piece. Positions are
in m, NED. A node is p, v, a, j, three values each.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from trimtab.firmware_model.flight.braking import (
    ZERO,
    Brakes,
    Node,
    Room,
    Vector,
    braked,
    duration_s,
    node_at_rest,
    position_of,
    seconds_us,
)
from trimtab.firmware_model.law.checks import REST, REST_YAW_RATE
from trimtab.firmware_model.law.reference import (
    CUBIC_SIZE,
    SEPTIC_SIZE,
    cubic_at,
    cubic_coefficients,
    septic_at,
    septic_coefficients,
)

YawState = tuple[float, float]
"""Yaw and yaw rate."""

SEPTIC_PEAK = 35.0 / 16.0
"""Peak over mean speed of a septic from rest to rest."""
FAST_SPEED = 2.0
"""Greatest speed (m/s) of a landing from a height. Faster, a small rotor would sink into its own wake."""
SLOW_HEIGHT = 1.0
"""Height (m) above the floor from which a landing has its final speed."""
CHANGE_US = 1_000_000
"""Time of a change of speed in a descent."""
TURN_US = 500_000
"""Time in which a turn ends without a new command."""
SINK = 1.5
"""Thrust below hover (m/s^2) in a descent without velocity."""
ENDLESS_US = 1_000_000_000_000
"""Duration of a track that only an event ends: more than eleven days."""


@dataclass(frozen=True, kw_only=True)
class Track:
    """A timeline from 0 to `end_us`: piece k applies from starts_us[k] until the next piece starts.

    blocks[k] is the law's input `piece`: the time inside the piece, 0 here, and the coefficients; likewise
    yaw_blocks[k]. ends_at_rest: whether both ends are at rest.
    """

    starts_us: tuple[int, ...]
    blocks: tuple[memoryview, ...]
    yaw_starts_us: tuple[int, ...]
    yaw_blocks: tuple[memoryview, ...]
    end_us: int
    start_ned: Vector
    end_ned: Vector
    start_yaw: float
    end_yaw: float
    ends_at_rest: bool

    def __post_init__(self) -> None:
        for starts, blocks, size in (
            (self.starts_us, self.blocks, 1 + SEPTIC_SIZE),
            (self.yaw_starts_us, self.yaw_blocks, 1 + CUBIC_SIZE),
        ):
            if not starts or starts[0] != 0 or len(starts) != len(blocks):
                raise ValueError("a track starts with a piece at 0 and has one start for each piece")
            for start_us, end_us in pairwise((*starts, self.end_us)):
                duration_s(start_us, end_us)
            if any(len(block) != size for block in blocks):
                raise ValueError(f"a block must have {size} values")

    def state_at(self, t_us: int) -> tuple[float, ...]:
        """Return p, v, a, j (NED), yaw and yaw rate at a time from 0 to the end."""
        k, y = bisect_right(self.starts_us, t_us) - 1, bisect_right(self.yaw_starts_us, t_us) - 1
        p, v, a, j, _ = septic_at(self.blocks[k][1:], (t_us - self.starts_us[k]) * 1e-6)
        return *p, *v, *a, *j, *cubic_at(self.yaw_blocks[y][1:], (t_us - self.yaw_starts_us[y]) * 1e-6)


def track(
    nodes: Sequence[tuple[int, Node]],
    yaw_nodes: Sequence[tuple[int, float, float]],
) -> Track:
    """Return a Track through nodes (t_us, 12 values) and yaw nodes (t_us, yaw, rate).

    The track lasts from the first node to the last. Yaw is constant before the first and after the last yaw
    node.
    """
    if len(nodes) < 2:
        raise ValueError("a track needs at least two nodes")
    first_us, end_us = nodes[0][0], nodes[-1][0]
    starts = []
    blocks = []
    for (t0, node0), (t1, node1) in pairwise(nodes):
        starts.append(t0 - first_us)
        blocks.append(_block(septic_coefficients(duration_s(t0, t1), node0, node1)))
    yaw_starts: list[int] = []
    yaw_blocks: list[memoryview] = []
    pieces = _yaw_pieces(yaw_nodes, first_us, end_us)
    for t0, t1, *values in pieces:
        yaw_starts.append(int(t0) - first_us)
        yaw_blocks.append(_block(cubic_coefficients(duration_s(t0, t1), *values)))
    t0, t1, _, _, end_yaw, end_rate = pieces[-1]
    if t1 > end_us:  # the track ends inside the piece
        end_yaw, end_rate = cubic_at(yaw_blocks[-1][1:], (end_us - t0) * 1e-6)
    return Track(
        starts_us=tuple(starts),
        blocks=tuple(blocks),
        yaw_starts_us=tuple(yaw_starts),
        yaw_blocks=tuple(yaw_blocks),
        end_us=end_us - first_us,
        start_ned=position_of(nodes[0][1]),
        end_ned=position_of(nodes[-1][1]),
        start_yaw=pieces[0][2],
        end_yaw=end_yaw,
        ends_at_rest=_at_rest(nodes[0][1], pieces[0][3]) and _at_rest(nodes[-1][1], end_rate),
    )


def climb(
    p: Vector, yaw: float, target: Vector, yaw_end: float, *, speed: float, clear: float, hover_us: int
) -> Track:
    """Return a climb from rest at `p` to rest at `target` by septic pieces, then a hover of `hover_us`.

    If the horizontal distance to the target exceeds `clear`, the vehicle first climbs vertically to its
    height. The peak speed is `speed`, but no piece is shorter than 1.5 s. Yaw turns in the shorter direction.
    """
    corners = [target]
    if math.hypot(target[0] - p[0], target[1] - p[1]) > clear:
        corners.insert(0, (p[0], p[1], target[2]))
    return _legs([(0, node_at_rest(p))], (yaw, 0.0), corners, yaw_end, speed=speed, hover_us=hover_us)


def transit(
    stop: list[tuple[int, Node]],
    yaw: YawState,
    target: Vector,
    yaw_end: float,
    *,
    speed: float,
    hover_us: int,
    climb_first: bool = False,
) -> Track:
    """Return a stop, a straight path to `target`, and a hover.

    stop: nodes of the stop, as `braked` returns them. climb_first: climb vertically to the target's height
    first. Speeds, times and yaw are as in `climb`.
    """
    north, east, _ = position_of(stop[-1][1])
    corners = [(north, east, target[2]), target] if climb_first else [target]
    return _legs(stop, yaw, corners, yaw_end, speed=speed, hover_us=hover_us)


def _legs(
    nodes: list[tuple[int, Node]],
    yaw: YawState,
    corners: Sequence[Vector],
    yaw_end: float,
    *,
    speed: float,
    hover_us: int,
) -> Track:
    """Return a track from the last node through the corners, at rest at each of them, then a hover."""
    turn_us, turn_from, _ = turning = _turning(*yaw)[-1]
    t_us, last = nodes[-1]
    p = position_of(last)
    for corner in corners:
        t_us += seconds_us(max(1.5, SEPTIC_PEAK * math.dist(p, corner) / speed))
        nodes.append((t_us, node_at_rest(corner)))
        p = corner
    nodes.append((t_us + hover_us, node_at_rest(p)))
    yaws = [(0, *yaw), turning] if turn_us else [turning]
    turn = math.remainder(yaw_end - turn_from, 2.0 * math.pi)
    # Shift the yaw nodes by whole turns, so the track ends at yaw_end.
    yaws = [(at_us, yaw_end - turn + (value - turn_from), rate) for at_us, value, rate in yaws]
    return track(nodes, [*yaws, (t_us, yaw_end, 0.0)])


def hold(p: Vector, yaw: float, duration_us: int) -> Track:
    """Return a track at rest at `p` for `duration_us`."""
    return track([(0, node_at_rest(p)), (duration_us, node_at_rest(p))], [(0, yaw, 0.0)])


def stop(state: Node, yaw: YawState, *, brakes: Brakes, room: Room, hold_us: int = ENDLESS_US) -> Track:
    """Return a stop from the reference state (p, v, a, j), then rest for `hold_us`."""
    nodes = braked(state, brakes, room)
    t_us, last = nodes[-1]
    nodes[-1] = (t_us, node_at_rest(position_of(last)))
    return track([*nodes, (t_us + hold_us, nodes[-1][1])], _turning(*yaw))


def land(state: Node, yaw: YawState, *, floor: float, speed: float, brakes: Brakes, room: Room) -> Track:
    """Return a stop from the reference state (p, v, a, j), then a descent at `speed` to 1 m below `floor`.

    A vehicle at rest descends immediately, and from a height first at up to FAST_SPEED, down to SLOW_HEIGHT.
    The end of the track is the latest time for a touchdown; after it the motors stop.
    """
    nodes = _stop_and_sink(state, floor=floor, speed=speed, brakes=brakes, room=room, latest_us=ENDLESS_US)
    t_us, last = nodes[-1]
    p = position_of(last)
    descent_us = seconds_us(max(1.0, (floor + 1.0 - p[2]) / speed))
    p = _below(p, speed * descent_us * 1e-6)
    nodes.append((t_us + descent_us, (*p, 0.0, 0.0, speed, *ZERO, *ZERO)))
    return track(nodes, _turning(*yaw))


def level_descent(
    state: Node,
    yaw: float,
    *,
    floor: float,
    speed: float,
    brakes: Brakes,
    room: Room,
    damped_us: int,
    end_us: int,
) -> Track:
    """Return a stop and a vertical descent for a vehicle without position feedback.

    It begins like `land`: as hard as the room needs, then from a height at up to FAST_SPEED, down to
    SLOW_HEIGHT, then at `speed` until `damped_us`. In the next second thrust decreases by SINK and is
    constant until `end_us`. This last part needs no velocity feedback.
    """
    nodes = _stop_and_sink(state, floor=floor, speed=speed, brakes=brakes, room=room, latest_us=damped_us)
    t_us, last = nodes[-1]
    damped_us = max(damped_us, t_us + 100_000)
    p2 = _below(position_of(last), speed * (damped_us - t_us) * 1e-6)
    p3 = _below(p2, speed + 0.15 * SINK)  # 3 s^2 - 2 s^3, integrated twice
    fall_us = damped_us + 1_000_000
    end_us = max(end_us, fall_us + 1_000_000)
    fall_s = (end_us - fall_us) * 1e-6
    fall = speed + 0.5 * SINK
    p4 = _below(p3, (fall + 0.5 * SINK * fall_s) * fall_s)
    nodes += [
        (damped_us, (*p2, 0.0, 0.0, speed, *ZERO, *ZERO)),
        (fall_us, (*p3, 0.0, 0.0, fall, 0.0, 0.0, SINK, *ZERO)),
        (end_us, (*p4, 0.0, 0.0, fall + SINK * fall_s, 0.0, 0.0, SINK, *ZERO)),
    ]
    return track(nodes, [(0, yaw, 0.0)])


def _stop_and_sink(
    state: Node, *, floor: float, speed: float, brakes: Brakes, room: Room, latest_us: int
) -> list[tuple[int, Node]]:
    """Return nodes of a stop and of a descent, to the point from which it sinks at `speed`.

    That is SLOW_HEIGHT above the floor for a descent from a height, unless `latest_us` is earlier.
    """
    nodes = braked(state, brakes, room, still=0.05)
    t_us, last = nodes[-1]
    p = position_of(last)
    fast = _fast(floor - p[2], speed)
    if t_us + 2 * CHANGE_US > latest_us:
        fast = speed
    p = _below(p, 0.5 * fast)
    t_us += CHANGE_US
    nodes.append((t_us, (*p, 0.0, 0.0, fast, *ZERO, *ZERO)))
    if fast > speed:
        _sink_fast(nodes, p, floor=floor, fast=fast, speed=speed, latest_us=latest_us)
    return nodes


def _fast(height: float, speed: float) -> float:
    """Return the greatest speed of a descent from a height: a second to it, a second from it to `speed`."""
    return max(speed, min(FAST_SPEED, height - SLOW_HEIGHT - 0.5 * speed))


def _sink_fast(
    nodes: list[tuple[int, Node]], p: Vector, *, floor: float, fast: float, speed: float, latest_us: int
) -> None:
    """Append nodes from `fast` at p to `speed` at SLOW_HEIGHT above the floor, or earlier at `latest_us`."""
    t_us = nodes[-1][0]
    coast_us = seconds_us((floor - p[2] - SLOW_HEIGHT - 0.5 * (fast + speed)) / fast)
    coast_us = min(coast_us, latest_us - CHANGE_US - t_us)
    if coast_us > 0:
        t_us += coast_us
        p = _below(p, fast * coast_us * 1e-6)
        nodes.append((t_us, (*p, 0.0, 0.0, fast, *ZERO, *ZERO)))
    nodes.append((t_us + CHANGE_US, (*_below(p, 0.5 * (fast + speed)), 0.0, 0.0, speed, *ZERO, *ZERO)))


def _turning(yaw: float, rate: float) -> list[tuple[int, float, float]]:
    """Return yaw nodes from this yaw and rate to a constant yaw."""
    if rate == 0.0:
        return [(0, yaw, 0.0)]
    return [(0, yaw, rate), (TURN_US, yaw + 0.5e-6 * TURN_US * rate, 0.0)]


def _at_rest(node: Node, yaw_rate: float) -> bool:
    speeds = zip((node[3:6], node[6:9], node[9:12]), REST, strict=True)
    return abs(yaw_rate) <= REST_YAW_RATE and all(math.hypot(*vector) <= bound for vector, bound in speeds)


def _below(p: Vector, depth: float) -> Vector:
    return (p[0], p[1], p[2] + depth)


def _block(coefficients: Sequence[float]) -> memoryview:
    return memoryview(array("d", [0.0, *coefficients]))


def _yaw_pieces(
    yaw_nodes: Sequence[tuple[int, float, float]], first_us: int, end_us: int
) -> list[tuple[int, int, float, float, float, float]]:
    """Return pieces (t0, t1, y0, r0, y1, r1) from first_us to end_us; yaw is constant outside the nodes."""
    rows = []
    start_us, start_yaw, _ = yaw_nodes[0]
    if start_us > first_us:
        rows.append((first_us, min(start_us, end_us), start_yaw, 0.0, start_yaw, 0.0))
    rows.extend((a[0], b[0], a[1], a[2], b[1], b[2]) for a, b in pairwise(yaw_nodes))
    last_us, last_yaw, _ = yaw_nodes[-1]
    if last_us < end_us:
        rows.append((max(last_us, first_us), end_us, last_yaw, 0.0, last_yaw, 0.0))
    return [row for row in rows if row[0] < end_us and row[1] > first_us]
