"""Checks before arming and start, including gyro calibration and detection of stillness."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from trimtab.firmware_model.flight.condition_monitor import Box, within
from trimtab.firmware_model.flight.supervisor import Event
from trimtab.firmware_model.flight.track import Track
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.estimator import converges
from trimtab.firmware_model.law.step import GYRO_COUNTS, TICK_S

WINDOW_US = 500_000
"""Time at rest for a gyro calibration."""
STILL_FORCE = 1.0
"""Greatest deviation of the specific force's magnitude from g (m/s^2) in a gyro calibration."""
REST_US = 100_000
"""Time at rest before arming. After a kill in the air the specific force stays near g until the thrust has
decayed; three rotor lags outlast that."""
REST_SPEED = 0.5
"""Greatest estimated speed (m/s) at rest. Poses tilted by 10 deg cause an apparent speed of 0.3 m/s."""
REST_FORCE = 2.0
"""Greatest deviation of the specific force's magnitude from g (m/s^2) at rest; STILL_FORCE is stricter."""
IDLE_SHARE = 0.5
"""Greatest idle thrust of the rotors as a share of the weight: with more, the vehicle could not descend and
keep control."""
THRUST_FLOOR_MAX = 0.7
"""Greatest THRUST_FLOOR: with more, the vehicle could not descend."""
CURVE = (0.8, 1.25)
"""Bounds of THRUST_C1 + THRUST_C2, the thrust at full command over THRUST_MAX."""
_FORCE_GAIN = 0.05  # of the smoothed specific force in each update: a time constant of 0.2 s


class GyroCalibration:
    """Gyro bias: mean over the first window in which the vehicle is at rest.

    Each update takes the present samples and the law's running sums; the mean covers every tick in between.
    """

    def __init__(self) -> None:
        self.bias: tuple[float, float, float] | None = None
        self._start_us = -1
        self._first: Sequence[float] = ()
        self._sums: Sequence[float] = ()

    def update(
        self,
        now_us: int,
        gyro: Sequence[float],
        force: Sequence[float],
        sums: Sequence[float],
        *,
        bias_max: float,
        still_rate: float,
    ) -> bool:
        """Continue the calibration; return whether this update completed it.

        Parameters
        ----------
        gyro, force
            Samples of this tick, FRD.
        sums
            Gyro sums of the law up to this tick, in counts.
        bias_max
            Greatest plausible bias (rad/s).
        still_rate
            Greatest difference of a sample from the first one of the window (rad/s).
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
            self._start_us = -1  # a constant rotation
            return False
        self.bias = (x, y, z)
        return True


class StillnessDetector:
    """Detects whether the vehicle is at rest, and measures the tilt error of the poses.

    `still`: whether the vehicle has been at rest for REST_US.
    """

    def __init__(self) -> None:
        self.still = False
        self._since_us = 0
        self._force_ned: Sequence[float] = ()

    def reset(self, now_us: int) -> None:
        """Restart the detection."""
        self.still, self._since_us, self._force_ned = False, now_us, ()

    def update(self, now_us: int, speed: float, force_ned: Sequence[float]) -> None:
        """Update with the estimated speed (m/s) and the specific force (NED, by the estimated attitude)."""
        if speed > REST_SPEED or not abs(math.hypot(*force_ned) - GRAVITY) < REST_FORCE:
            self._since_us = now_us
        self.still = now_us - self._since_us >= REST_US
        smoothed = self._force_ned or force_ned
        self._force_ned = tuple(a + _FORCE_GAIN * (b - a) for a, b in zip(smoothed, force_ned, strict=True))

    @property
    def pose_tilt_deg(self) -> float:
        """Angle between the smoothed specific force and the upward vertical of the poses; 0 without data."""
        if not self._force_ned:
            return 0.0
        north, east, down = self._force_ned
        return math.degrees(math.atan2(math.hypot(north, east), -down))


class ArmingState(NamedTuple):
    """State of the vehicle that the arming checks evaluate.

    Parameters
    ----------
    calibrated
        Whether the gyro is calibrated.
    has_pose
        Whether several poses in a row have arrived, the last one a short time ago.
    still, pose_tilt_deg
        Results of `StillnessDetector`; pose_tilt_max_deg is the bound of pose_tilt_deg.
    cos_tilt
        Cosine of the estimated tilt; cos_tilt_min is its bound.
    p
        Estimated position, NED.
    fence
        Flight volume.
    active
        Active conditions of the failsafe table.
    battery
        Why the live reference may not be flown with this battery, or None.
    contradiction
        First inconsistency of the parameters, or None.
    lacks_key
        Whether SIGN_REQUIRED is set and the vehicle holds no signing key.
    """

    calibrated: bool
    has_pose: bool
    still: bool
    pose_tilt_deg: float
    pose_tilt_max_deg: float
    cos_tilt: float
    cos_tilt_min: float
    p: tuple[float, float, float]
    fence: Box
    active: frozenset[Event]
    battery: str | None
    contradiction: str | None
    lacks_key: bool


class Check(NamedTuple):
    """An arming check: its subject, whether it fails, and its message for people."""

    name: str
    fails: Callable[[ArmingState], bool]
    text: str


def _is_active(event: Event) -> Callable[[ArmingState], bool]:
    return lambda state: event in state.active


CHECKS: tuple[Check, ...] = (
    Check("gyro", lambda state: not state.calibrated, "gyro not calibrated: keep still"),
    Check("IMU", _is_active(Event.IMU_STUCK), "IMU stuck: it repeats one sample"),
    Check("mocap", lambda state: not state.has_pose, "no mocap"),
    Check("age of poses", _is_active(Event.MOCAP_LATE), "mocap late"),
    Check("tilt", lambda state: not state.cos_tilt >= state.cos_tilt_min, "tilted"),
    # Before the check of rest: tilted poses make a vehicle at rest appear to move.
    Check(
        "poses' vertical",
        lambda state: state.has_pose and not state.pose_tilt_deg <= state.pose_tilt_max_deg,
        "poses tilted: fix frame or rigid body",
    ),
    Check("rest", lambda state: state.has_pose and not state.still, "moving: let it stand still"),
    Check("fence", lambda state: not within(state.p, state.fence), "outside the fence"),
    Check("battery", _is_active(Event.BATTERY_LOW), "battery low: charge it"),
    Check("battery for the live reference", lambda state: state.battery is not None, "{battery}"),
    Check("loop", _is_active(Event.LOOP_OVERRUN), "ticks too late"),
    Check("link", _is_active(Event.LINK_LOST), "no host heard"),
    Check("parameters", lambda state: state.contradiction is not None, "{contradiction}"),
    Check("signing", lambda state: state.lacks_key, "no signing key: install one"),
)
"""Arming checks in the order of their messages."""


def arming_refusals(state: ArmingState) -> list[str]:
    """Return every reason why the vehicle may not arm."""
    texts = {"battery": state.battery, "contradiction": state.contradiction}
    return [check.text.format(**texts) for check in CHECKS if check.fails(state)]


def contradiction(parameters: Mapping[str, float]) -> str | None:
    """Return the first inconsistency of parameters that are within their bounds, or None."""
    if parameters["BAT_EMPTY_V"] >= parameters["BAT_FULL_V"]:
        return "BAT_EMPTY_V not below BAT_FULL_V"
    if 4.0 * parameters["THRUST_MAX"] * parameters["LIM_THR_HI"] <= parameters["MASS"] * GRAVITY:
        return "MASS too great for THRUST_MAX"
    if not 4.0 * parameters["THRUST_MIN"] < IDLE_SHARE * parameters["MASS"] * GRAVITY:
        return "THRUST_MIN too great for MASS"
    if not parameters["THRUST_FLOOR"] <= THRUST_FLOOR_MAX:
        return f"THRUST_FLOOR above {THRUST_FLOOR_MAX:g}"
    low, high = CURVE
    if not low <= parameters["THRUST_C1"] + parameters["THRUST_C2"] <= high:
        return "THRUST_C1 + THRUST_C2 is not near 1"
    if not (parameters["EST_VEL"] > 0.0 and converges(parameters["EST_POS"], parameters["EST_VEL"])):
        return "EST_POS, EST_VEL: estimate diverges"
    if not converges(parameters["EST_ATT"], parameters["EST_BIAS"]):
        return "EST_ATT, EST_BIAS: estimate diverges"
    return None


def start_refusal(reference: Track | None, *, to_hover: bool, flown: bool, battery: str | None) -> str | None:
    """Return why the live reference may not be flown, or None.

    to_hover: whether a take-off to a hover is in progress. flown: whether the reference was flown since the
    last arming. battery: as in `ArmingState`.
    """
    if to_hover:
        return "still taking off"
    if flown:
        return "flown already: land, then arm again"
    if reference is None:
        return "no live reference: upload one"
    return battery if reference.ends_at_rest else "reference not at rest at its ends"
