"""Findings of a trace, as codes with numbers; `trimtab.host.trace.sentences` words them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Any

from trimtab.host.base.errors import UsageError


class Verdict(StrEnum):
    """The verdict of a trace."""

    TRACED = "traced"
    NOTHING_MISSING = "nothing-missing"
    UNDECIDED = "undecided"
    OUTSIDE_LIBRARY = "outside-library"


class Code(StrEnum):
    """Kinds of findings. The values are part of the JSON of `trimtab trace`."""

    # The unexplained residual has a cause outside the library.
    FLIGHTS_REPEAT = "flights-repeat"
    FLIGHTS_WORSENED = "flights-worsened"
    FORCE_REPEATS = "force-repeats"
    TORQUE_REPEATS = "torque-repeats"
    FORCE_RINGS = "force-rings"
    TORQUE_RINGS = "torque-rings"
    FORCE_PULSES = "force-pulses"
    # Doubts about the flights as a whole.
    TRACKING_TOO_SHORT = "tracking-too-short"
    HOVER_ONLY = "hover-only"
    POSES_TOO_SLOW = "poses-too-slow"
    EXCESS_FORCE = "excess-force"
    EXCESS_TORQUE = "excess-torque"
    BETTER_BUT_INADMISSIBLE = "better-but-inadmissible"
    SEGMENTS_DISAGREE = "segments-disagree"
    ONLY_HOVER = "only-hover"
    TIME_RAN_LATE = "time-ran-late"
    # Effects that the data does not exclude or would not show.
    ALIAS = "alias"
    EXACT_ALIAS = "exact-alias"
    POSSIBLE = "possible"
    SOMETHING_MISSING = "something-missing"
    HIDDEN = "hidden"
    # What the model took up without naming it.
    ADJUSTED_FAR = "adjusted-far"
    # Quality of one log.
    NO_REPEAT = "no-twin"  # older JSON code, kept for compatibility
    NO_INPUTS = "no-inputs"
    NO_REFERENCE = "no-reference"
    NO_GYRO = "no-gyro"
    SAMPLED_COMMANDS = "sampled-commands"
    SLOW_COMMANDS = "slow-commands"
    RATE_DROPS = "rate-drops"
    REPEATED_STAMPS = "repeated-stamps"
    CLOCK_DRIFT = "clock-drift"
    ROTORS_SATURATED = "rotors-saturated"
    SEGMENTS_LEFT_OUT = "segments-left-out"
    SEGMENTS_WITH_GAPS = "segments-with-gaps"
    # Stretches of a flight that are not used.
    CLOCK_JUMP = "clock-jump"
    LATE_POSES = "late-poses"
    MOTOR_AT_LIMIT = "motor-at-limit"
    PITCH_SINGULAR = "pitch-singular"
    IMPACT = "impact"
    GAP_IN_COMMANDS = "gap-in-commands"
    GAP_IN_POSES = "gap-in-poses"
    GROUND_CONTACT = "ground-contact"
    TILTED = "tilted"
    # Logs that are refused.
    MIXED_VEHICLES = "mixed-vehicles"
    LOG_GIVEN_TWICE = "log-given-twice"
    HELD_OUT_REFERENCE_USED = "held-out-reference-used"
    TOO_FEW_SEGMENTS = "too-few-segments"
    MIXED_INPUTS = "mixed-inputs"
    TOO_FEW_POSES = "too-few-poses"
    NO_TRACKING = "no-tracking"
    UNDEFINED_UNKNOWN = "undefined-unknown"
    BASELINE_OF_ANOTHER_VEHICLE = "baseline-of-another-vehicle"
    BASELINE_OUTSIDE_LIBRARY = "baseline-outside-library"
    SETS_SHARE_A_FLIGHT = "sets-share-a-flight"
    SETS_DIFFER_IN_TOPICS = "sets-differ-in-topics"


CHANNEL_UNITS = {"force": "m/s^2", "torque": "rad/s^2"}
"""Units of the residual force and torque, which are divided by mass and inertia."""

OUTSIDE_LIBRARY_CODES = frozenset(
    {
        Code.FLIGHTS_REPEAT,
        Code.FLIGHTS_WORSENED,
        Code.FORCE_REPEATS,
        Code.TORQUE_REPEATS,
        Code.FORCE_RINGS,
        Code.TORQUE_RINGS,
        Code.FORCE_PULSES,
    }
)
"""Findings that put the cause outside the library; the JSON's `reasons` are their sentences."""

DOUBTS = frozenset(
    {
        Code.TRACKING_TOO_SHORT,
        Code.HOVER_ONLY,
        Code.POSES_TOO_SLOW,
        Code.EXCESS_FORCE,
        Code.EXCESS_TORQUE,
        Code.BETTER_BUT_INADMISSIBLE,
        Code.SEGMENTS_DISAGREE,
        Code.ONLY_HOVER,
        Code.TIME_RAN_LATE,
    }
)
"""Findings on shortcomings of the flights as a whole; the JSON's `doubts` are their sentences."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One finding: a comparison of a number with a threshold, or a fact about the logs.

    Parameters
    ----------
    code
        Kind of the finding.
    value, bound
        Number that was compared with a threshold, and the threshold; None if nothing was compared.
    unit
        Unit of both.
    subject
        Names of effects, a topic, or the code of a stretch; empty if there is none.
    log
        Name of the log; None if the finding is about all flights.
    details
        Further numbers that the sentence shows, by name.
    """

    code: Code
    value: float | None = None
    bound: float | None = None
    unit: str = "1"
    subject: tuple[str, ...] = ()
    log: str | None = None
    details: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    def to_json(self) -> dict[str, Any]:
        """Return an entry of the JSON list `findings`."""
        return {
            "code": str(self.code),
            "value": self.value,
            "bound": self.bound,
            "unit": self.unit,
            "subject": list(self.subject),
            "log": self.log,
            "details": dict(self.details),
        }


class LogsRefused(UsageError):
    """Error for logs that cannot be traced, alone or together. Its JSON holds the code of the reason."""

    def __init__(self, code: Code, message: str) -> None:
        super().__init__(message)
        self.details = {"code": str(code)}
