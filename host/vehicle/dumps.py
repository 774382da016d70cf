"""What the parameter dump of an autopilot tells of a quadrotor: rotors, spins, thrust curve, hover thrust.

Two autopilots and their files are known: PX4 (QGroundControl's .params) and ArduPilot (.param or .parm of
Mission Planner and MAVProxy, or QGroundControl's .params).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from trimtab.host.base.errors import UsageError
from trimtab.host.vehicle.model import Rotor

LARGEST_BYTES = 1_000_000
_QGC_COLUMNS = 5

_CCW, _CW = "ccw", "cw"
_X = (45.0, -135.0, -45.0, 135.0)
_PLUS = (90.0, -90.0, 0.0, 180.0)
ARDUPILOT_QUADS: Mapping[int, tuple[str, tuple[float, ...], tuple[str, ...]]] = {
    0: ("plus", _PLUS, (_CCW, _CCW, _CW, _CW)),
    1: ("X", _X, (_CCW, _CCW, _CW, _CW)),
    3: ("H", _X, (_CW, _CW, _CCW, _CCW)),
    6: ("plus, reversed", _PLUS, (_CW, _CW, _CCW, _CCW)),
    12: ("Betaflight X", (135.0, 45.0, -135.0, -45.0), (_CW, _CCW, _CCW, _CW)),
    13: ("DJI X", (45.0, -45.0, -135.0, 135.0), (_CCW, _CW, _CCW, _CW)),
    14: ("clockwise X", (45.0, 135.0, -135.0, -45.0), (_CCW, _CW, _CCW, _CW)),
    18: ("Betaflight X, reversed", (135.0, 45.0, -135.0, -45.0), (_CCW, _CW, _CW, _CCW)),
}
"""FRAME_TYPE of FRAME_CLASS 1 to name, angle of each motor from ahead to the right (deg), and its spin.

Source: AP_MotorsMatrix::setup_quad_matrix of ArduPilot.
"""

HOVER_DEFAULTS = {"MPC_THR_HOVER": 0.5, "MOT_THST_HOVER": 0.35}
"""Values that the firmware starts with: a dump that has them does not know the hover thrust."""

_HOVER_RANGE = (0.05, 0.9)


@dataclass(frozen=True, kw_only=True)
class Dump:
    """What a dump tells. None: it does not tell.

    Attributes
    ----------
    autopilot, frame
        Words for the user.
    rotors
        Spins, and positions that are in m if `has_size`, else of arms of 1 m.
    thrust_curve
        [c1, c2] of the vehicle file.
    hover_share
        Share of its greatest thrust at which a rotor hovers.
    pwm_us
        Pulses that correspond to a motor command of 0 and 1.
    """

    autopilot: str
    frame: str
    rotors: tuple[Rotor, ...]
    has_size: bool
    thrust_curve: tuple[float, float] | None
    hover_share: float | None
    pwm_us: tuple[float, float] | None

    def with_arm(self, arm_m: float) -> tuple[Rotor, ...]:
        """Return the rotors scaled to this mean distance from the centre of mass, m."""
        mean = sum(math.hypot(*rotor.position_m[:2]) for rotor in self.rotors) / len(self.rotors)
        return tuple(
            _rotor(tuple(value * arm_m / mean for value in rotor.position_m), rotor.spin)
            for rotor in self.rotors
        )


def read_dump(path: Path) -> Dump:
    """Return what a parameter dump tells. Raises UsageError, in one line, if it tells no quadrotor."""
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST_BYTES + 1)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}); check --parameters") from None
    return parse_dump(data, str(path))


def parse_dump(data: bytes, source: str) -> Dump:
    """Return what the bytes of a parameter dump tell; `source` names them. Raises UsageError, in one line."""
    values = parse_values(data, source)
    if "CA_ROTOR_COUNT" in values:
        return _px4(values, source)
    if "FRAME_CLASS" in values:
        return _ardupilot(values, source)
    raise UsageError(
        f"{source}: neither CA_ROTOR_COUNT (PX4) nor FRAME_CLASS (ArduPilot) is among its "
        f"{len(values)} parameters; save all parameters of the vehicle"
    )


def parse_values(data: bytes, source: str) -> dict[str, float]:
    """Return the parameters of a dump by name. Raises UsageError with the line that cannot be read."""
    if len(data) > LARGEST_BYTES:
        raise UsageError(f"{source}: more than {LARGEST_BYTES} bytes; a parameter dump is smaller")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UsageError(f"{source}: not UTF-8 text at byte {error.start}; give a parameter dump") from None
    values: dict[str, float] = {}
    for number, line in enumerate(text.split("\n"), start=1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        pair = words[2:4] if len(words) == _QGC_COLUMNS else words
        value = _number(pair[1]) if len(pair) == 2 else None
        if value is None:
            raise UsageError(
                f"{source}:{number}: not a parameter; a line is NAME,VALUE or a row of QGroundControl"
            )
        if values.setdefault(pair[0], value) != value:
            raise UsageError(f"{source}:{number}: a second value; keep the parameters of one vehicle")
    return values


def _number(text: str) -> float | None:
    """Return a finite number, or None."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _px4(values: Mapping[str, float], source: str) -> Dump:
    if values.get("CA_AIRFRAME", 0.0) != 0.0 or values["CA_ROTOR_COUNT"] != 4.0:
        raise UsageError(
            f"{source}: CA_AIRFRAME {values.get('CA_AIRFRAME', 0.0):g} with {values['CA_ROTOR_COUNT']:g} "
            "rotors is not a quadrotor; Trimtab flies quadrotors"
        )
    rotors = []
    for i in range(4):
        x, y, km = (_needed(values, f"CA_ROTOR{i}_{part}", source) for part in ("PX", "PY", "KM"))
        z = values.get(f"CA_ROTOR{i}_PZ", 0.0)
        tilt = max(abs(values.get(f"CA_ROTOR{i}_{part}", 0.0)) for part in ("AX", "AY"))
        if tilt > 0.0 or values.get(f"CA_ROTOR{i}_AZ", -1.0) >= 0.0:
            raise UsageError(
                f"{source}: the axis CA_ROTOR{i}_AX, AY, AZ is not straight up; Trimtab flies quadrotors "
                "whose rotors are level"
            )
        if km == 0.0:
            raise UsageError(f"{source}: CA_ROTOR{i}_KM is 0; its sign is the rotor's direction")
        if not 0.0 < math.hypot(x, y) < 10.0:
            raise UsageError(f"{source}: CA_ROTOR{i}_PX, PY are {x:g}, {y:g} m; correct them")
        rotors.append(_rotor((x, y, z), _CCW if km > 0.0 else _CW))
    factor = values.get("THR_MDL_FAC")
    return Dump(
        autopilot="PX4",
        frame="rotors of CA_ROTOR*",
        rotors=tuple(rotors),
        has_size=True,
        thrust_curve=None if factor is None else _curve("THR_MDL_FAC", factor, source),
        hover_share=_hover(values, "MPC_THR_HOVER", source),
        pwm_us=None,
    )


def _ardupilot(values: Mapping[str, float], source: str) -> Dump:
    kind, shape = values["FRAME_CLASS"], _needed(values, "FRAME_TYPE", source)
    if kind != 1.0 or shape not in ARDUPILOT_QUADS:
        raise UsageError(
            f"{source}: FRAME_CLASS {kind:g} with FRAME_TYPE {shape:g} is not a known quadrotor; "
            f"known are class 1 with type {', '.join(map(str, ARDUPILOT_QUADS))}"
        )
    frame, angles, spins = ARDUPILOT_QUADS[int(shape)]
    expo = values.get("MOT_THST_EXPO")
    return Dump(
        autopilot="ArduPilot",
        frame=f"quadrotor {frame}",
        rotors=tuple(
            _rotor((math.cos(math.radians(angle)), math.sin(math.radians(angle)), 0.0), spin)
            for angle, spin in zip(angles, spins, strict=True)
        ),
        has_size=False,
        thrust_curve=None if expo is None else _curve("MOT_THST_EXPO", expo, source),
        hover_share=_hover(values, "MOT_THST_HOVER", source),
        pwm_us=_pulses(values, source),
    )


def _pulses(values: Mapping[str, float], source: str) -> tuple[float, float] | None:
    """Return ArduPilot's pulses for least and greatest thrust, us."""
    names = ("MOT_PWM_MIN", "MOT_PWM_MAX", "MOT_SPIN_MIN", "MOT_SPIN_MAX")
    if not all(name in values for name in names):
        return None
    low, high, spin_min, spin_max = (values[name] for name in names)
    if low == high == 0.0:  # older versions: the range of the throttle channel
        return None
    if not (0.0 <= low < high <= 10_000.0 and 0.0 <= spin_min < spin_max <= 1.0):
        raise UsageError(
            f"{source}: MOT_PWM_MIN, MAX {low:g}, {high:g} and MOT_SPIN_MIN, MAX {spin_min:g}, "
            f"{spin_max:g} are no range; correct them"
        )
    return low + spin_min * (high - low), low + spin_max * (high - low)


def _needed(values: Mapping[str, float], name: str, source: str) -> float:
    if name not in values:
        raise UsageError(f"{source}: {name} is missing; save all parameters of the vehicle")
    return values[name]


def _curve(name: str, share: float, source: str) -> tuple[float, float]:
    """Return [c1, c2]: both autopilots state the quadratic part of the curve."""
    if not 0.0 <= share <= 1.0:
        raise UsageError(
            f"{source}: {name} {share:g} is outside 0 to 1; a vehicle file cannot hold that curve"
        )
    quadratic = round(share, 3)
    return round(1.0 - quadratic, 3), quadratic


def _hover(values: Mapping[str, float], name: str, source: str) -> float | None:
    """Return the hover thrust, or None if it is missing or still the default."""
    share = values.get(name)
    if share is None or math.isclose(share, HOVER_DEFAULTS[name], abs_tol=1e-4):
        return None
    low, high = _HOVER_RANGE
    if not low <= share <= high:
        raise UsageError(f"{source}: {name} {share:g} is outside {low:g} to {high:g}; correct it")
    return share


def _rotor(position_m: tuple[float, ...], spin: str) -> Rotor:
    return Rotor.model_validate({"position_m": position_m, "spin": spin})
