"""Invariants of a flight: one table for the page, for the study of random sequences, and for tests.

Each row bounds one measure. A checker builds a `Moment` for every update of the vehicle and evaluates every
row on it. Motion is the true one, measured from outside, so a fault of the estimate hides nothing. What a row
does not promise stands in its `condition`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from trimtab.firmware_model.flight.failsafe import Action
from trimtab.firmware_model.flight.supervisor import COMMANDS, FAILURES, FLYING, Event, State, update
from trimtab.protocol.messages import Station

OFF_M = 0.1
"""Greatest height (m) at which the rotors may stop."""
CONTACT_M = 0.02
"""Height (m) at which a descending vehicle counts as touching the floor."""
DESCENT_S = 30.0
"""Greatest time of a descent, from its start to motors off."""
OVERTURNED_DEG = 80.0
"""Tilt beyond which a vehicle cannot brake its sinking."""
LAND_SPEED_MIN, LAND_SPEED_MAX = 0.3, 0.7
"""Values of LAND_SPEED (m/s) between which landings take no longer than DESCENT_S, and are soft."""
CEILING_MAX = 10.0
"""Greatest height (m) of the ceiling from which a descent takes no longer than DESCENT_S."""
UPDATE_S = 0.03
"""Time from the end of a timeout to its effect: two updates, and the way of the last message."""

_HOLD_ENDS = frozenset((Event.SETPOINTS_LOST, Event.REFERENCE_ENDED))
_UNDER_COMMAND = frozenset((State.TAKEOFF, State.TRACKING, State.HOLD, State.OFFBOARD))

Parameters = Mapping[str, float]


class Transition(NamedTuple):
    """A change of the state.

    by: station that commanded it. owner: owner of the flight before it. failing_checks: number of arming
    checks that failed at this time.
    """

    before: State
    event: Event
    after: State
    by: Station | None = None
    owner: Station | None = None
    failing_checks: int = 0


class Moment(NamedTuple):
    """A vehicle at one update, and what has happened since the update before.

    Attributes
    ----------
    parameters
        Values on board.
    p, v
        True position and velocity, m and m/s, NED; the floor is at 0.
    before, state, action_before, action
        State and action of the failsafes at the last update and at this one.
    rotors_on_before, rotors_on
        Whether any rotor was and is commanded to turn.
    transitions
        Changes of the state since the last update.
    changed_parameters
        Number of parameters that have changed since then.
    not_finite
        Number of commands to the rotors and values of the reference that are not finite.
    silent_s, pose_s, setpoint_s, state_s
        Time since the owner's last message, the last true pose, the owner's last setpoint, and the last
        change of the state.
    entered_by
        Event that led into the state.
    poses_true
        Whether no wrong pose has arrived since a second before arming, except single outliers and repetitions
        of the last pose.
    attitude
        Whether the owner has sent attitudes or body rates since arming.
    released
        Whether KILL, TILTED or IMU_STUCK has stopped the rotors in the air since arming.
    blind
        Whether the vehicle has descended without poses since arming.
    overturned
        Whether the vehicle has tilted by more than OVERTURNED_DEG since arming.
    impact_m_s, sinking_m_s
        Speed at which the vehicle has met the floor since the last update, None if it has not, and the part
        of it that is vertical.
    """

    parameters: Parameters
    p: tuple[float, float, float] = (0.0, 0.0, 0.0)
    v: tuple[float, float, float] = (0.0, 0.0, 0.0)
    before: State = State.STANDBY
    state: State = State.STANDBY
    action_before: Action = Action.NONE
    action: Action = Action.NONE
    rotors_on_before: bool = False
    rotors_on: bool = False
    transitions: tuple[Transition, ...] = ()
    changed_parameters: int = 0
    not_finite: int = 0
    silent_s: float = 0.0
    pose_s: float = 0.0
    setpoint_s: float = 0.0
    state_s: float = 0.0
    entered_by: Event | None = None
    poses_true: bool = True
    attitude: bool = False
    released: bool = False
    blind: bool = False
    overturned: bool = False
    impact_m_s: float | None = None
    sinking_m_s: float = 0.0

    @property
    def height_m(self) -> float:
        """True height above the floor."""
        return -self.p[2]

    @property
    def flying(self) -> bool:
        """Whether the rotors may turn, or a fall with stopped rotors has not ended."""
        return self.state in FLYING

    @property
    def located(self) -> bool:
        """Whether the vehicle flies with rotors on, and knows where it is."""
        return self.state in FLYING and self.poses_true and not self.blind and not self.released


@dataclass(frozen=True, kw_only=True)
class Invariant:
    """One row: `measure(moment) <= bound(parameters)` whenever `applies(moment)`.

    Parameters
    ----------
    name
        Identifier.
    statement
        What the row promises.
    formula, unit
        The bound, in words and names of parameters, and its unit; empty for a count.
    condition
        When the row holds.
    """

    name: str
    statement: str
    formula: str
    unit: str
    condition: str
    bound: Callable[[Parameters], float]
    applies: Callable[[Moment], bool]
    measure: Callable[[Moment], float]


def above_ceiling(moment: Moment) -> float:
    """Return how far the vehicle is above the ceiling, m; negative below it."""
    return moment.parameters["FENCE_D_MIN"] - moment.p[2]


def past_walls(moment: Moment) -> float:
    """Return how far the vehicle is past the walls, m; negative inside."""
    values, (north, east, _) = moment.parameters, moment.p
    return max(
        north - values["FENCE_N_MAX"],
        values["FENCE_N_MIN"] - north,
        east - values["FENCE_E_MAX"],
        values["FENCE_E_MIN"] - east,
    )


def _constant(value: float) -> Callable[[Parameters], float]:
    return lambda parameters: value


def _impact(moment: Moment) -> float:
    return moment.impact_m_s or 0.0


def _soft(moment: Moment) -> bool:
    """Return whether the vehicle has met the floor with its rotors in use, at a gentle LAND_SPEED."""
    return (
        moment.impact_m_s is not None
        and not moment.released
        and moment.parameters["LAND_SPEED"] <= LAND_SPEED_MAX
    )


def _soft_after_attitude(moment: Moment) -> bool:
    return _soft(moment) and moment.poses_true and moment.attitude and not moment.overturned


def _stopped_rotors(moment: Moment) -> bool:
    return moment.rotors_on_before and not moment.rotors_on and not moment.released


def _forbidden(moment: Moment) -> float:
    """Return the number of transitions that the table of modes does not have."""
    count = 0
    for before, event, after, *_ in moment.transitions:
        outcome = update(before, event)
        count += outcome.refusal is not None or outcome.state is not after
    return count


def _is_foreign(moment: Moment, transition: Transition) -> bool:
    """Return whether a station has commanded a transition of a flight that is not its own."""
    _, event, _, by, owner, _ = transition
    if event not in COMMANDS or owner is None or by == owner:
        return False
    others = moment.parameters["OWN_OTHERS"]
    return not ((event is Event.LAND and others >= 1.0) or (event is Event.KILL and others >= 2.0))


def _failing_checks(moment: Moment) -> float:
    """Return the number of reasons against arming, at the moment of arming."""
    failing = max(each.failing_checks for each in moment.transitions if each.event is Event.ARM)
    stale = moment.pose_s > moment.parameters["FS_MOCAP_S"] + UPDATE_S
    outside = moment.poses_true and max(above_ceiling(moment), past_walls(moment)) > OFF_M
    return failing + stale + outside


def _never(**fields: Any) -> Invariant:
    """Return a row that counts what must not happen."""
    return Invariant(formula="none", unit="", bound=_constant(0.0), **fields)


_ENDED = "not after KILL, TILT or IMU_STUCK"
_UPRIGHT = f"never tilted by more than {OVERTURNED_DEG:g} deg"
_SOFT = f"true poses; LAND_SPEED at most {LAND_SPEED_MAX:g} m/s; {_ENDED}"

INVARIANTS: tuple[Invariant, ...] = (
    Invariant(
        name="ceiling",
        statement="The vehicle stays below the ceiling, with a margin.",
        formula="`FS_FENCE_M` + 0.5",
        unit="m",
        condition="in flight with true poses",
        bound=lambda values: values["FS_FENCE_M"] + 0.5,
        applies=lambda moment: moment.located,
        measure=above_ceiling,
    ),
    Invariant(
        name="walls",
        statement="The vehicle stays between the walls, with a margin.",
        formula="`FS_FENCE_M` + 1.0",
        unit="m",
        condition="in flight with true poses",
        bound=lambda values: values["FS_FENCE_M"] + 1.0,
        applies=lambda moment: moment.located,
        measure=past_walls,
    ),
    Invariant(
        name="impact",
        statement="The vehicle meets the floor softly after setpoints of position and velocity.",
        formula="1.0",
        unit="m/s",
        condition=_SOFT,
        bound=_constant(1.0),
        applies=lambda moment: _soft(moment) and moment.poses_true and not (moment.attitude or moment.blind),
        measure=_impact,
    ),
    Invariant(
        name="impact-attitude",
        statement="The vehicle meets the floor softly after attitudes and body rates.",
        formula="1.3",
        unit="m/s",
        condition=f"speed of sinking; {_UPRIGHT}; {_SOFT}",
        bound=_constant(1.3),
        applies=_soft_after_attitude,
        measure=lambda moment: moment.sinking_m_s,
    ),
    Invariant(
        name="slide-attitude",
        statement="The vehicle slides slowly where it meets the floor after attitudes and body rates.",
        formula="2.5",
        unit="m/s",
        condition=f"speed sideways: a tilt close above the floor leaves no room to stop; {_UPRIGHT}; {_SOFT}",
        bound=_constant(2.5),
        applies=_soft_after_attitude,
        measure=lambda moment: math.sqrt(max(0.0, _impact(moment) ** 2 - moment.sinking_m_s**2)),
    ),
    Invariant(
        name="impact-blind",
        statement="The vehicle meets the floor softly after a descent without poses.",
        formula="1.2",
        unit="m/s",
        condition="after setpoints of position and velocity; FS_MOCAP_S at most 1 s; no wrong poses before; "
        f"{_ENDED}",
        bound=_constant(1.2),
        applies=lambda moment: (
            _soft(moment)
            and moment.poses_true
            and moment.blind
            and moment.parameters["FS_MOCAP_S"] <= 1.0
            and not moment.attitude
        ),
        measure=_impact,
    ),
    Invariant(
        name="motors-off",
        statement="The rotors stop on the floor only.",
        formula=f"{OFF_M:g}",
        unit="m",
        condition="true poses; not for KILL, TILT or IMU_STUCK",
        bound=_constant(OFF_M),
        applies=lambda moment: _stopped_rotors(moment) and moment.poses_true,
        measure=lambda moment: moment.height_m,
    ),
    Invariant(
        name="descent",
        statement="A landing, and every failsafe, ends on the floor with the motors off.",
        formula=f"{DESCENT_S:g}",
        unit="s",
        condition=f"LAND_SPEED at least {LAND_SPEED_MIN:g} m/s; ceiling at most {CEILING_MAX:g} m up",
        bound=_constant(DESCENT_S),
        applies=lambda moment: (
            moment.state in (State.LANDING, State.FAILSAFE)
            and moment.parameters["LAND_SPEED"] >= 0.3
            and moment.parameters["FENCE_D_MIN"] >= -10.0
        ),
        measure=lambda moment: moment.state_s,
    ),
    Invariant(
        name="link-lost",
        statement="A vehicle whose owner is silent lands, or disarms on the floor.",
        formula="`FS_LINK_S`",
        unit="s",
        condition="armed, outside landings and failsafes",
        bound=lambda values: values["FS_LINK_S"] + UPDATE_S,
        applies=lambda moment: moment.state in _UNDER_COMMAND or moment.state is State.ARMED,
        measure=lambda moment: moment.silent_s,
    ),
    Invariant(
        name="setpoints-lost",
        statement="A vehicle in OFFBOARD without setpoints holds.",
        formula="`FS_OFFB_S`",
        unit="s",
        condition="in OFFBOARD",
        bound=lambda values: values["FS_OFFB_S"] + UPDATE_S,
        applies=lambda moment: moment.state is State.OFFBOARD,
        measure=lambda moment: moment.setpoint_s,
    ),
    Invariant(
        name="hold-ends",
        statement="A hold after lost setpoints, or after a reference, ends with a landing.",
        formula="max(`FS_OFFB_HOLD_S`, `HOLD_S`) + 10",
        unit="s",
        condition="in HOLD, entered by either event",
        bound=lambda values: max(values["FS_OFFB_HOLD_S"], values["HOLD_S"]) + 10.0,
        applies=lambda moment: moment.state is State.HOLD and moment.entered_by in _HOLD_ENDS,
        measure=lambda moment: moment.state_s,
    ),
    Invariant(
        name="poses-lost",
        statement="A vehicle in flight without poses descends level.",
        formula="`FS_MOCAP_S`",
        unit="s",
        condition="in flight, level descent and motors off excepted",
        bound=lambda values: values["FS_MOCAP_S"] + UPDATE_S,
        applies=lambda moment: moment.flying and moment.action < Action.LEVEL_DESCENT,
        measure=lambda moment: moment.pose_s,
    ),
    _never(
        name="rank",
        statement="Only a higher action replaces the action of a failsafe.",
        condition="in FAILSAFE",
        applies=lambda moment: moment.before is moment.state is State.FAILSAFE,
        measure=lambda moment: moment.action_before - moment.action,
    ),
    _never(
        name="modes",
        statement="The state changes by the tables of modes and events only.",
        condition="always",
        applies=lambda moment: bool(moment.transitions),
        measure=_forbidden,
    ),
    _never(
        name="failures",
        statement="A failure in flight ends it; it never returns to normal flight.",
        condition="always",
        applies=lambda moment: any(each.event in FAILURES for each in moment.transitions),
        measure=lambda moment: sum(
            each.event in FAILURES and each.after in _UNDER_COMMAND for each in moment.transitions
        ),
    ),
    _never(
        name="owner",
        statement="Only the owner commands a flight.",
        condition="except for what OWN_OTHERS allows: to land, or to terminate",
        applies=lambda moment: any(each.event in COMMANDS for each in moment.transitions),
        measure=lambda moment: sum(_is_foreign(moment, each) for each in moment.transitions),
    ),
    _never(
        name="arming",
        statement="The vehicle does not arm while an arming check fails.",
        condition="always",
        applies=lambda moment: any(each.event is Event.ARM for each in moment.transitions),
        measure=_failing_checks,
    ),
    _never(
        name="parameters",
        statement="No parameter changes outside STANDBY.",
        condition="always",
        applies=lambda moment: State.STANDBY not in (moment.before, moment.state),
        measure=lambda moment: moment.changed_parameters,
    ),
    _never(
        name="rotors",
        statement="The rotors turn in flight only.",
        condition="in BOOT, STANDBY and ARMED",
        applies=lambda moment: (
            not (
                moment.before in FLYING
                or moment.flying
                or any(each.after in FLYING for each in moment.transitions)
            )
        ),
        measure=lambda moment: float(moment.rotors_on),
    ),
    _never(
        name="finite",
        statement="No command to the rotors and no reference is infinite or not a number.",
        condition="always",
        applies=lambda moment: True,
        measure=lambda moment: moment.not_finite,
    ),
)
"""All invariants, in the order of the page."""

BY_NAME: Mapping[str, Invariant] = {row.name: row for row in INVARIANTS}


def excess(row: Invariant, moment: Moment) -> float | None:
    """Return by how much a moment breaks a row; at most 0 if it holds, None if the row does not apply."""
    if not row.applies(moment):
        return None
    value = row.measure(moment)
    return math.inf if math.isnan(value) else value - row.bound(moment.parameters)


def broken(moment: Moment) -> list[Invariant]:
    """Return the rows that a moment breaks."""
    return [row for row in INVARIANTS if (excess(row, moment) or 0.0) > 0.0]
