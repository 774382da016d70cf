"""Make docs/reference/failsafes.md, on modes, failsafes and arming checks, from the tables themselves.

`python docs/generators/failsafes.py FILE` writes it; a test holds the page against the code.
"""

from __future__ import annotations

import sys
from pathlib import Path

from trimtab.firmware_model.flight.failsafe import CONDITIONS, Action, Condition, Failsafe
from trimtab.firmware_model.flight.flight import UPDATE_TICKS
from trimtab.firmware_model.flight.phases import CLEAR_HEIGHT, TAKEOFF_HEIGHT_MIN
from trimtab.firmware_model.flight.readiness import (
    CHECKS,
    CURVE,
    FLOOR_MAX,
    IDLE_SHARE,
    REST_FORCE,
    REST_SPEED,
    REST_US,
)
from trimtab.firmware_model.flight.setpoints import SHORTEST_S
from trimtab.firmware_model.flight.supervisor import COMMANDS, FAILURES, Event, State, update
from trimtab.firmware_model.flight.verdict import BATTERY_LOW_CELL_V
from trimtab.firmware_model.law.estimator import INTERVAL_MAX_S
from trimtab.protocol.parameters import BY_NAME
from trimtab.protocol.telemetry import TICK_US

_HEAD = """# Modes, failsafes, arming checks

<!-- Made by `make docs` from firmware_model; change it there. -->

All times are the vehicle's own; conditions are looked at every {look_ms} ms.

## Failsafes

| condition | bound | time | action | why | who or what clears it |
|---|---|---|---|---|---|
"""

_BEHIND = """
- Times and bounds are parameters with the defaults given. A condition must last for its time without a break;
  where it says "over", that is what it is smoothed or counted over.
- Actions rank as {ranks}.
  While one is under way only a higher one replaces it, and the first failure is what FC_STATUS names until
  the next arming. `FC_STATUS.conditions` has bit k set while a row of TRIMTAB_FAILSAFE k holds, on the floor
  too.
- A landing goes on where a landing in place would be the action. Armed on the floor, every failure disarms.
  In standby the same conditions refuse arming.
- In place is where the reference stops. A vehicle that something holds off it comes back there when that
  ends: by what accelerates it (m/s^2) over POS_P, with the default 0.17 m for each m/s^2.
- Level descent: attitude and sink rate are kept, position is not; the rotors stop when something carries it,
  that is when force exceeds, by a step, what their thrust has been worth in the descent so far.

## Arming checks

`MAV_CMD_RUN_PREARM_CHECKS` tells every reason at once, each behind "not ready:"; a refusal of arming names
the first.

| check | text |
|---|---|
"""

_REFERENCE = """
Tilt must be within {tilt}. At rest is what for {rest:g} s has been slower than {speed:g} m/s and felt g
within {force:g} m/s^2. Poses are tilted if their vertical is over {askew} from the accelerometer's: the
camera frame is not level, or the rigid body was defined on a slope. Arming needs no reference (it warns
where there is none); a start needs one that is at rest at its ends. With a live reference on board both are
refused below BAT_EMPTY_V + {cell:g} V a cell, where no reference is accepted either; a measured 0 V says
nothing.

Parameters go together where BAT_EMPTY_V is below BAT_FULL_V, 4 THRUST_MAX LIM_THR_HI above the weight,
4 THRUST_MIN below {idle:g} of it, THRUST_FLOOR at most {floor:g}, THRUST_C1 + THRUST_C2 within {low:g}
and {high:g}, EST_POS, EST_VEL and EST_ATT above 0, and the estimator's errors die out with poses at least
every h = {interval:g} s: 2 h EST_POS + h^2 EST_VEL < 4, 2 h EST_ATT + h^2 EST_BIAS < 4.

## Modes

States by command; `-` is refused with a reason.

"""

_EVENTS = """
Takeoff (MAV_CMD_NAV_TAKEOFF) climbs to its height above the floor, TAKEOFF_HEIGHT where it names none, at
least {least:g} m, at most to the fence, and hovers; less is denied, or refused where the fence leaves less.
Start (MAV_CMD_MISSION_START) goes to the first node and tracks the live reference, once an arming.
MAV_CMD_DO_SET_MODE takes PX4's numbers: main mode 6 is offboard, 4 with sub mode 3 hold, 4 with 6 land. A
hold lasts until told otherwise, but {hold_s} after a reference and {lost_s} after lost setpoints; then it
lands.

What ends by itself, and what fails:

"""

_OFFBOARD = """
## Setpoints

OFFBOARD is entered while setpoints arrive, that is the last is at most FS_OFFB_S old: in the air, in a
takeoff, or armed on the floor. There the rotors turn and the reference begins at rest where the vehicle
stands; below {clear:g} m it only rises, then it follows. A setpoint that asks for no height leaves it
standing.

| message | what is followed |
|---|---|
| SET_POSITION_TARGET_LOCAL_NED, frame 1 | position, velocity or both on each axis; acceleration; yaw, rate |
| frame 7, 8 | velocity in NED or along the heading; no position |
| SET_ATTITUDE_TARGET | thrust, as a share of 4 THRUST_MAX, with body rate or attitude (rates on top) |

Fields masked out or not finite are left out; what then makes no setpoint is refused, each reason told once.
The reference never steps: every setpoint begins a polynomial in its present position, velocity, acceleration
and jerk, at least {shortest:g} s long, within LIM_SPEED and OFFB_ACCEL. A stream of positions alone is
followed about 0.3 s late. Positions end at the fence and OFFB_HEIGHT above the floor, velocities stop there.
Where no such way is gentle and stays inside, it first takes out the acceleration, or stops and goes on.
Rates stay within LIM_RATE_* and thrust above THRUST_FLOOR; no position is held then.

A stop (hold, land, landing in place) brakes by LAND_DECEL, sideways and in height each in its own time; where
it would lead through the fence or below OFFB_HEIGHT, it brakes up to twice as hard.
"""


def page() -> str:
    """Return the page as Markdown."""
    ranks = " < ".join(_words(action.name) for action in Action)
    return "".join(
        (
            _HEAD.format(look_ms=UPDATE_TICKS * TICK_US // 1000),
            *map(_row, CONDITIONS),
            _BEHIND.format(ranks=ranks),
            *(f"| {check.name} | {_text(check.text)} |\n" for check in CHECKS),
            _REFERENCE.format(
                tilt=_default("ARM_TILT_DEG"),
                rest=1e-6 * REST_US,
                speed=REST_SPEED,
                force=REST_FORCE,
                askew=_default("ARM_ASKEW_DEG"),
                idle=IDLE_SHARE,
                floor=FLOOR_MAX,
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
            _OFFBOARD.format(shortest=SHORTEST_S, clear=CLEAR_HEIGHT),
        )
    )


def _row(row: Condition) -> str:
    name = "" if row.failsafe is Failsafe.NONE else f" ({row.failsafe.name})"
    bound = "" if row.bound is None else _default(row.bound)
    time = "" if row.timeout is None else ("" if row.lasting else "over ") + _default(row.timeout)
    cells = (f"{row.description}{name}", bound, time, _words(row.action.name), row.rationale, row.clears)
    return f"| {' | '.join(cells)} |\n"


def _default(name: str) -> str:
    parameter = BY_NAME[name]
    return f"`{name}` {parameter.default:g} {parameter.unit}".rstrip()


def _table(events: tuple[Event, ...]) -> str:
    """One row a state, one column an event: the state it leads to."""
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
    text = text.replace("{contradiction}", "what does not go together")
    return text.replace("{battery}", "battery at its voltage, below the bound")


def _words(name: str) -> str:
    return name.lower().replace("_", " ")


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
