"""What must hold before the vehicle may arm or start, and the gyro calibration that is part of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from trimtab.firmware_model.flight.supervisor import Event
from trimtab.firmware_model.flight.track import Track
from trimtab.firmware_model.flight.watch import Box, within
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.estimator import converges
from trimtab.firmware_model.law.step import GYRO_COUNTS, TICK_S

WINDOW_US = 500_000
"""Stillness that a calibration takes."""
STILL_FORCE = 1.0
"""m/s^2 by which the length of the specific force may differ from g."""
REST_US = 100_000
"""Stillness that arming takes: three times a rotor's lag, so that one just killed counts as falling."""
REST_SPEED = 0.5
"""m/s of the estimate at which a vehicle moves. Poses whose down is 10 deg off look like 0.3 m/s."""
REST_FORCE = 2.0
"""m/s^2 by which the length of the specific force differs from g then; less steady, no gyro is calibrated."""
IDLE_SHARE = 0.5
"""Share of the weight that rotors at their least thrust stay below: it comes down, and can be turned."""
FLOOR_MAX = 0.7
"""Greatest THRUST_FLOOR: it comes down with that."""
CURVE = (0.8, 1.25)
"""What THRUST_C1 + THRUST_C2, thrust at full command over THRUST_MAX, lies between."""
_FELT_SHARE = 0.05  # of each look's specific force in the smoothed one: a fifth of a second


class GyroCalibration:
    """The gyro's bias as its mean over the first window in which the vehicle stood still.

    Look at it now and then with a sample and the law's running sums; the mean is over every tick in between.
    """

    def __init__(self) -> None:
        self.bias: tuple[float, float, float] | None = None
        self._start_us = -1
        self._first: Sequence[float] = ()
        self._sums: Sequence[float] = ()

    def look(
        self,
        now_us: int,
        gyro: Sequence[float],
        force: Sequence[float],
        sums: Sequence[float],
        *,
        bias_max: float,
        still_rate: float,
    ) -> bool:
        """Whether this look completed the calibration.

        Parameters
        ----------
        gyro, force
            samples of this tick, FRD. sums: the law's gyro sums, in counts, up to this tick.
        bias_max
            greatest bias (rad/s) that is believed.
        still_rate
            rad/s by which a sample may differ from the window's first.
        """
        if self.bias is not None:
            return False
        still = abs(math.hypot(*force) - GRAVITY) < STILL_FORCE
        if self._start_us >= 0:
            still = still and all(abs(a - b) < still_rate for a, b in zip(gyro, self._first, strict=True))
        if not still:
            self._start_us = -1
            return False
        if self._start_us < 0:
            self._start_us, self._first, self._sums = now_us, tuple(gyro), tuple(sums)
            return False
        elapsed_us = now_us - self._start_us
        if elapsed_us < WINDOW_US:
            return False
        per_count = TICK_S / (GYRO_COUNTS * elapsed_us * 1e-6)
        x, y, z = ((b - a) * per_count for a, b in zip(self._sums, sums, strict=True))
        if max(abs(x), abs(y), abs(z)) > bias_max:
            self._start_us = -1  # turning steadily
            return False
        self.bias = (x, y, z)
        return True


class Rest:
    """Whether the vehicle stands still, and whether poses know where down is.

    `still`: REST_US of looks found it so. `askew_deg`: angle between up and the specific force, turned by the
    estimate and smoothed.
    """

    def __init__(self) -> None:
        self.still = False
        self._since_us = 0
        self._felt: Sequence[float] = ()

    def begin(self, now_us: int) -> None:
        """Start the calibration."""
        self.still, self._since_us, self._felt = False, now_us, ()

    def look(self, now_us: int, speed: float, force_ned: Sequence[float]) -> None:
        """Take the estimated speed (m/s) and this tick's specific force (NED, by the estimate)."""
        if speed > REST_SPEED or not abs(math.hypot(*force_ned) - GRAVITY) < REST_FORCE:
            self._since_us = now_us
        self.still = now_us - self._since_us >= REST_US
        felt = self._felt or force_ned
        self._felt = tuple(a + _FELT_SHARE * (b - a) for a, b in zip(felt, force_ned, strict=True))

    @property
    def askew_deg(self) -> float:
        """See above; 0 before the first look."""
        if not self._felt:
            return 0.0
        north, east, down = self._felt
        return math.degrees(math.atan2(math.hypot(north, east), -down))


class Facts(NamedTuple):
    """What the arming checks judge.

    Parameters
    ----------
    calibrated
        Whether the gyro is calibrated.
    posed
        Whether poses are in use.
    still, askew_deg
        Results of `Rest`; askew_max_deg is the bound of askew_deg.
    cos_tilt
        Cosine of the estimated tilt; cos_tilt_min is its bound.
    p
        Estimated position, NED.
    fence
        Flight volume.
    holding
        Conditions of the failsafe table that hold.
    battery
        Why the live reference must not be flown with this battery; None if it may.
    contradiction
        What is contradictory among the parameters; None if nothing is.
    """

    calibrated: bool
    posed: bool
    still: bool
    askew_deg: float
    askew_max_deg: float
    cos_tilt: float
    cos_tilt_min: float
    p: tuple[float, float, float]
    fence: Box
    holding: frozenset[Event]
    battery: str | None
    contradiction: str | None


class Check(NamedTuple):
    """One arming check: what is looked at, whether it fails, what people read then."""

    what: str
    fails: Callable[[Facts], bool]
    text: str


def _holds(event: Event) -> Callable[[Facts], bool]:
    return lambda facts: event in facts.holding


CHECKS: tuple[Check, ...] = (
    Check("gyro", lambda facts: not facts.calibrated, "gyro not calibrated: keep still"),
    Check("IMU", _holds(Event.IMU_STUCK), "IMU stuck: it repeats one sample"),
    Check("mocap", lambda facts: not facts.posed, "no mocap"),
    Check("age of poses", _holds(Event.MOCAP_LATE), "mocap late"),
    Check("tilt", lambda facts: not facts.cos_tilt >= facts.cos_tilt_min, "tilted"),
    # Before rest: poses askew make a vehicle that stands seem to move.
    Check(
        "poses' vertical",
        lambda facts: facts.posed and not facts.askew_deg <= facts.askew_max_deg,
        "poses askew: mend frame or rigid body",
    ),
    Check("rest", lambda facts: facts.posed and not facts.still, "moving: let it stand still"),
    Check("fence", lambda facts: not within(facts.p, facts.fence), "outside the fence"),
    Check("battery", _holds(Event.BATTERY_LOW), "battery low: charge it"),
    Check("battery for the live reference", lambda facts: facts.battery is not None, "{battery}"),
    Check("loop", _holds(Event.LOOP_OVERRUN), "ticks too late"),
    Check("link", _holds(Event.LINK_LOST), "no host heard"),
    Check("parameters", lambda facts: facts.contradiction is not None, "{contradiction}"),
)
"""In the order in which reasons are told."""


def reasons(facts: Facts) -> list[str]:
    """Every reason why the vehicle must not arm; none where it may."""
    found = {"battery": facts.battery, "contradiction": facts.contradiction}
    return [check.text.format(**found) for check in CHECKS if check.fails(facts)]


def contradiction(parameters: Mapping[str, float]) -> str | None:
    """Return what parameters that are allowed one by one do not allow together, None where all is well."""
    if parameters["BAT_EMPTY_V"] >= parameters["BAT_FULL_V"]:
        return "BAT_EMPTY_V not below BAT_FULL_V"
    if 4.0 * parameters["THRUST_MAX"] * parameters["LIM_THR_HI"] <= parameters["MASS"] * GRAVITY:
        return "MASS too great for THRUST_MAX"
    if not 4.0 * parameters["THRUST_MIN"] < IDLE_SHARE * parameters["MASS"] * GRAVITY:
        return "THRUST_MIN too great for MASS"
    if not parameters["THRUST_FLOOR"] <= FLOOR_MAX:
        return f"THRUST_FLOOR above {FLOOR_MAX:g}"
    low, high = CURVE
    if not low <= parameters["THRUST_C1"] + parameters["THRUST_C2"] <= high:
        return "THRUST_C1 + THRUST_C2 is not near 1"
    if not (parameters["EST_VEL"] > 0.0 and converges(parameters["EST_POS"], parameters["EST_VEL"])):
        return "EST_POS, EST_VEL: estimate diverges"
    if not converges(parameters["EST_ATT"], parameters["EST_BIAS"]):
        return "EST_ATT, EST_BIAS: estimate diverges"
    return None


def start_refusal(reference: Track | None, *, rising: bool, flown: bool, battery: str | None) -> str | None:
    """Why the live reference is not flown, None where it is.

    rising: a take-off to a hover is under way. flown: it has been, since the last arming. battery: as in
    Facts.
    """
    if rising:
        return "still taking off"
    if flown:
        return "flown already: land, then arm again"
    if reference is None:
        return "no live reference: upload one"
    return battery if reference.rests else "reference not at rest at its ends"
