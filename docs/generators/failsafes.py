"""Generate docs/reference/failsafes.md, on modes, failsafes and arming checks, from the tables themselves.

`python docs/generators/failsafes.py FILE` writes it. A test compares the page with the code.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

from trimtab.firmware_model.flight.condition_monitor import CLEAR_HEIGHT
from trimtab.firmware_model.flight.dead_reckoning import DRIFT, NEAR_M
from trimtab.firmware_model.flight.envelope import (
    IMPACT_SPEED,
    RISING_SHARE,
    SIDEWAYS_TILT_DEG,
    THRUST_SHARE,
)
from trimtab.firmware_model.flight.failsafe import CONDITIONS, Action, Condition, Failsafe
from trimtab.firmware_model.flight.flight import AFTER_DIRECT_US, OFF_TRACK_M, UPDATE_TICKS
from trimtab.firmware_model.flight.gate import POSES_IN_A_ROW
from trimtab.firmware_model.flight.invariants import INVARIANTS, Invariant
from trimtab.firmware_model.flight.phases import TAKEOFF_HEIGHT_MIN
from trimtab.firmware_model.flight.readiness import (
    CHECKS,
    CURVE,
    IDLE_SHARE,
    REST_FORCE,
    REST_SPEED,
    REST_US,
    THRUST_FLOOR_MAX,
)
from trimtab.firmware_model.flight.setpoints import SHORTEST_S
from trimtab.firmware_model.flight.supervisor import COMMANDS, FAILURES, Event, State, update
from trimtab.firmware_model.flight.track import FAST_SPEED, SLOW_HEIGHT
from trimtab.firmware_model.flight.verdict import BATTERY_LOW_CELL_V
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.estimator import INTERVAL_MAX_S
from trimtab.protocol.parameters import BY_NAME
from trimtab.protocol.telemetry import TICK_US

_HEAD = """# Modes, failsafes, arming checks

<!-- Made by `make docs` from firmware_model; change it there. -->

All times are on the vehicle's clock. The vehicle checks the conditions every {look_ms} ms.

## Failsafes

| condition | bound | time | action | why | what clears it |
|---|---|---|---|---|---|
"""

_BEHIND = """
- Times and bounds are parameters with the defaults given. A condition must last for its time without a
  break. "Over" gives the time over which a value is smoothed or counted.
- Actions rank as {ranks}.
  While an action is under way, only a higher one replaces it. FC_STATUS names the first failure until the
  next arming.
- `FC_STATUS.conditions` has bit k set while a row of TRIMTAB_FAILSAFE k is active, on the floor too.
- If the action is to land in place during a landing, the landing continues. Armed on the floor, every
  failure disarms. In standby, most of these conditions refuse arming.
- "In place" is where the reference stops. A vehicle that is pushed away from there returns when the push
  ends. The distance is the acceleration of the push over POS_P, with the default 0.17 m for each m/s^2.
- "Level descent" keeps attitude and sink rate by dead reckoning, not position. Its velocity is that of the
  accelerometer, less the bias that the poses showed before. Poses that come back are not used. From a height
  the vehicle sinks at up to {fast:g} m/s, and at `FS_SINK_SPEED` from {slow:g} m above the floor. After
  `FS_BLIND_S` it relies on thrust alone, sinks faster, and stops the rotors at the latest `FS_BLIND_END_S`
  later.
- A level descent ends when the floor carries the vehicle, that is, when the force exceeds, by a step, what
  thrust has produced so far in the descent. Before `FS_BLIND_S` this counts only below a dead-reckoned height
  of {near:g} m, plus {drift:g} m for each second since the last pose: higher up, it is air.
- An attitude error accelerates a level descent sideways, by {tilted:.2f} m/s^2 for each degree. If the camera
  frame or the markers slipped shortly before, the touchdown may be at several m/s.

## Arming checks

`MAV_CMD_RUN_PREARM_CHECKS` reports every reason at once, each after "not ready:". A refusal of arming gives
the first reason.

| check | text |
|---|---|
"""

_REFERENCE = """
- **Tilt** must be within {tilt}.
- **Rest** means that the vehicle has been slower than {speed:g} m/s for {rest:g} s and has measured g within
  {force:g} m/s^2.
- **Poses' vertical**: arming is refused if the vertical of the poses differs from the accelerometer's by
  over {askew}. Then the camera frame is not level, or the rigid body was defined on a slope.
- **mocap**: at least {row} poses in a row must have arrived, the last within `FS_MOCAP_S`. A single pose may
  be one of another source.
- **Reference**: arming needs no reference, but warns if there is none. A start needs a reference that is at
  rest at its ends.
- **Battery**: with a live reference on board, arming and start are refused below BAT_EMPTY_V + {cell:g} V a
  cell. No reference is accepted below it either. A measured 0 V counts as no measurement.

Parameters are consistent if all of these hold:

- BAT_EMPTY_V is below BAT_FULL_V.
- 4 THRUST_MAX LIM_THR_HI is above the weight, and 4 THRUST_MIN is below {idle:g} of it.
- THRUST_FLOOR is at most {floor:g}, and THRUST_C1 + THRUST_C2 is between {low:g} and {high:g}.
- EST_POS, EST_VEL and EST_ATT are above 0.
- The estimator's errors die out with poses at least every h = {interval:g} s:
  2 h EST_POS + h^2 EST_VEL < 4, 2 h EST_ATT + h^2 EST_BIAS < 4.

## Modes

The table gives the state after each command. `-` means that the command is refused with a reason.

"""

_EVENTS = """
- **Takeoff** (MAV_CMD_NAV_TAKEOFF) climbs to its height above the floor and hovers. Without a height in the
  command, TAKEOFF_HEIGHT applies. The height is at least {least:g} m and at most that of the fence. A lower
  height is denied; if the fence leaves less, the command is refused.
- **Start** (MAV_CMD_MISSION_START) flies to the first node and tracks the live reference, once for each
  arming.
- **Mode** (MAV_CMD_DO_SET_MODE) takes PX4's numbers: main mode 6 is offboard, 4 with sub mode 3 is hold, 4
  with 6 is land.
- **Hold** lasts until the next command, except for {hold_s} after a reference and {lost_s} after lost
  setpoints. Then the vehicle lands.

Events that end a state, and failures:

"""

_OFFBOARD = """
## Setpoints

The vehicle enters OFFBOARD while setpoints arrive, that is, while the last one is at most FS_OFFB_S old. It
can do so in the air, in a takeoff, or armed on the floor. On the floor, the rotors turn and the reference
begins at rest where the vehicle stands. Below {clear:g} m it only rises; then it follows the setpoints. A
setpoint that does not command a height leaves the vehicle on the floor.

| message | what the vehicle follows |
|---|---|
| SET_POSITION_TARGET_LOCAL_NED, frame 1 | position, velocity or both on each axis; acceleration; yaw, rate |
| frame 7, 8 | velocity in NED or along the heading; no position |
| SET_ATTITUDE_TARGET | thrust, as a share of 4 THRUST_MAX, with body rate or attitude (rates on top) |

Fields that are masked out or not finite are ignored. If the remaining fields form no setpoint, it is refused.
Each reason is reported once.

The reference never steps. Every setpoint begins a polynomial in the present position, velocity, acceleration
and jerk of the reference, at least {shortest:g} s long, within LIM_SPEED and OFFB_ACCEL. A stream of
positions alone is followed about 0.3 s late.

Positions end at the fence and `OFFB_HEIGHT` above the floor. A velocity stops there by itself, at any value
of FS_OFFB_S. If no such path is gentle and stays inside, the vehicle first reduces the acceleration to
zero, or stops and then continues.

With SET_ATTITUDE_TARGET no position is held. Rates stay within LIM_RATE_* and thrust above THRUST_FLOOR.
A setpoint that arrives less than {clear:g} m above the floor is flown without tilt; yaw and thrust apply.
Every 10 ms the vehicle predicts where a stop would end that began now, from its speed, its acceleration, and
the thrust and tilt that are left. If that is outside the fence, or on the floor at over {impact:g} m/s, it
lands in place at once. The same holds for {after:g} s after the last attitude for setpoints of position and
velocity. The prediction also applies to a vehicle that is more than {off_track:g} m from its reference; there
the stop may end `FS_FENCE_M` outside the fence. A body rate that turns the vehicle over far from fence and
floor still ends with the motors off (TILT).

A stop (hold, land, landing in place) brakes by LAND_DECEL, sideways and in height each in its own time. If it
would lead through the fence or below `OFFB_HEIGHT`, the vehicle brakes harder: sideways up to a tilt of
{tilt:g} deg (at most LIM_TILT_DEG), in a climb with {rising:.0%} of what gravity gives above
THRUST_FLOOR, in a descent with {share:.0%} of its greatest thrust.

A landing from a height sinks at up to {fast:g} m/s, and at `LAND_SPEED` from {slow:g} m above the floor.
"""


_INVARIANTS = """
## What is to hold in every flight

The rows below are to hold for every sequence of commands, setpoints, uploads and faults, for parameters of
limits, fence and failsafes within the ranges of `sitl/studies/policy/draws.py`, and with the vehicle's own
data and gains as in its file. [A study](../studies/envelope.md#random-sequences) measures how often they do
not: in none of 10,000 random sequences, at the commit that its page names. Heights, distances and speeds are
true ones, measured from outside. "None" means that no case is allowed.

| name | what holds | bound | when, and for what |
|---|---|---|---|
"""

_WRONG_POSES = """
While poses are wrong, nothing holds that is about places and speeds: the vehicle has no other measure of its
position. It refuses a pose that jumps by more than `EST_JUMP_M`, one that repeats the last in flight, and
poses of a second source.
"""


def page() -> str:
    """Return the page as Markdown."""
    ranks = " < ".join(_words(action.name) for action in Action)
    return "".join(
        (
            _HEAD.format(look_ms=UPDATE_TICKS * TICK_US // 1000),
            *map(_row, CONDITIONS),
            _BEHIND.format(
                ranks=ranks,
                fast=FAST_SPEED,
                slow=SLOW_HEIGHT,
                near=NEAR_M,
                drift=DRIFT,
                tilted=math.radians(GRAVITY),
            ),
            *(f"| {check.name} | {_text(check.text)} |\n" for check in CHECKS),
            _REFERENCE.format(
                row=POSES_IN_A_ROW,
                tilt=_default("ARM_TILT_DEG"),
                rest=1e-6 * REST_US,
                speed=REST_SPEED,
                force=REST_FORCE,
                askew=_default("ARM_ASKEW_DEG"),
                idle=IDLE_SHARE,
                floor=THRUST_FLOOR_MAX,
                low=CURVE[0],
                high=CURVE[1],
                interval=INTERVAL_MAX_S,
                cell=BATTERY_LOW_CELL_V,
            ),
            _table(COMMANDS),
            _EVENTS.format(
                least=TAKEOFF_HEIGHT_MIN, hold_s=_default("HOLD_S"), lost_s=_default("FS_OFFB_HOLD_S")
            ),
            _table(tuple(event for event in Event if event not in COMMANDS and event not in FAILURES)),
            "\n",
            _table(FAILURES),
            _OFFBOARD.format(
                shortest=SHORTEST_S,
                clear=CLEAR_HEIGHT,
                impact=IMPACT_SPEED,
                off_track=OFF_TRACK_M,
                after=1e-6 * AFTER_DIRECT_US,
                tilt=SIDEWAYS_TILT_DEG,
                rising=RISING_SHARE,
                share=THRUST_SHARE,
                fast=FAST_SPEED,
                slow=SLOW_HEIGHT,
            ),
            _INVARIANTS,
            *map(_invariant, INVARIANTS),
            _WRONG_POSES,
        )
    )


def _row(row: Condition) -> str:
    name = "" if row.failsafe is Failsafe.NONE else f" ({row.failsafe.name})"
    bound = "" if row.bound is None else _default(row.bound)
    time = "" if row.timeout is None else ("" if row.lasting else "over ") + _default(row.timeout)
    cells = (f"{row.description}{name}", bound, time, _words(row.action.name), row.rationale, row.clears)
    return f"| {' | '.join(cells)} |\n"


def _invariant(row: Invariant) -> str:
    bound = f"{row.formula} {row.unit}".rstrip()
    return f"| {row.name} | {row.statement} | {bound} | {row.condition} |\n"


def _default(name: str) -> str:
    parameter = BY_NAME[name]
    return f"`{name}` {parameter.default:g} {parameter.unit}".rstrip()


def _table(events: tuple[Event, ...]) -> str:
    """Return a table with a row for each state and a column for each event: the state it leads to."""
    head = "| | " + " | ".join(_words(event.name) for event in events) + " |"
    lines = [head, "|---" * (len(events) + 1) + "|"]
    for state in State:
        cells = []
        for event in events:
            outcome = update(state, event)
            cells.append("-" if outcome.refusal is not None else outcome.state.name)
        lines.append(f"| {state.name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _text(text: str) -> str:
    text = text.replace("{contradiction}", "the parameters that are inconsistent")
    return text.replace("{battery}", "battery at its voltage, below the bound")


def _words(name: str) -> str:
    return name.lower().replace("_", " ")


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
