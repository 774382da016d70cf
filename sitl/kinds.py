"""Kinds of effect that a simulated world can have, with names, keys and sizes.

This table is independent of the host's effect library. Names and keys agree because the documentation fixes
them. `tolerance` is one standard deviation of the deviation that every drawn world has without stating it;
the vehicle file may override it. Kinds marked `outside` are not in the host's library.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Spread = Literal["above", "either", "turned", "one"]
"""How sizes are drawn.

"above": each above neutral. "either": each on either side of neutral. "turned": the first two as a vector of
random direction, a third with half the size on either side. "one": one above neutral, the others neutral.
"""

_TURN = (-math.pi, math.pi)


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """One value of a kind: its key in world files, typical distance from neutral, tolerance and bounds.

    `drawn` is the interval of a uniform draw, for a position, a direction or a length.
    """

    key: str
    typical: float
    tolerance: float
    lower: float
    upper: float
    neutral: float = 0.0
    drawn: tuple[float, float] | None = None


@dataclass(frozen=True, kw_only=True)
class Kind:
    """One kind of effect. With `one_sided`, deviations are only above neutral, as for drag.

    `deviates` is False for kinds that a build does not have by accident.
    """

    name: str
    quantities: tuple[Quantity, ...]
    spread: Spread
    one_sided: bool = False
    deviates: bool = True
    outside: bool = False


def _number(
    key: str,
    typical: float,
    tolerance: float,
    lower: float,
    upper: float,
    neutral: float = 0.0,
    drawn: tuple[float, float] | None = None,
) -> Quantity:
    return Quantity(
        key=key, typical=typical, tolerance=tolerance, lower=lower, upper=upper, neutral=neutral, drawn=drawn
    )


def _outside(name: str, *quantities: Quantity) -> Kind:
    return Kind(name=name, quantities=quantities, spread="above", deviates=False, outside=True)


def _place(key: str, typical: float, drawn: tuple[float, float], lower: float, upper: float) -> Quantity:
    return _number(key, typical, 0.0, lower, upper, drawn=drawn)


KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind(
            name="linear-drag",
            quantities=(
                _number("dx", 0.4, 0.01, 0.0, 3.0),
                _number("dy", 0.35, 0.01, 0.0, 3.0),
                _number("dz", 0.2, 0.01, 0.0, 3.0),
            ),
            spread="above",
            one_sided=True,
        ),
        Kind(
            name="quadratic-drag",
            quantities=(_number("c", 0.03, 0.002, 0.0, 0.5),),
            spread="above",
            one_sided=True,
        ),
        Kind(
            name="wind",
            quantities=(_number("wx", 1.5, 0.05, -10.0, 10.0), _number("wy", 1.5, 0.05, -10.0, 10.0)),
            spread="turned",
        ),
        Kind(
            name="thrust-gain",
            quantities=(_number("gain", 0.08, 0.01, 0.5, 2.0, neutral=1.0),),
            spread="either",
        ),
        Kind(name="battery-sag", quantities=(_number("exponent", 1.7, 0.1, -1.0, 5.0),), spread="above"),
        Kind(name="motor-lag", quantities=(_number("extra_s", 0.015, 0.001, -0.008, 0.08),), spread="above"),
        Kind(
            name="com-offset",
            quantities=(_number("x", 0.004, 0.0002, -0.03, 0.03), _number("y", 0.004, 0.0002, -0.03, 0.03)),
            spread="turned",
        ),
        Kind(
            name="mocap-latency",
            quantities=(_number("latency_s", 0.015, 0.0005, 0.0, 0.08),),
            spread="above",
            one_sided=True,
        ),
        _outside("blade-flapping", _number("moment", 2.0, 0.0, 0.0, 20.0)),  # rad/s^2 per m/s, at hover speed
        _outside(
            "elastic-tether",
            _number("stiffness", 0.5, 0.0, 0.0, 20.0),  # 1/s^2: N/m per kg
            _number("damping", 0.05, 0.0, 0.0, 5.0),  # 1/s
            _place("slack_m", 0.8, (0.6, 1.0), 0.0, 20.0),
            _place("anchor_x_m", 0.5, (-1.0, 1.0), -50.0, 50.0),
            _place("anchor_y_m", 0.5, (-1.0, 1.0), -50.0, 50.0),
            _place("anchor_z_m", 0.0, (0.0, 0.0), -50.0, 50.0),
        ),
        Kind(
            name="mass",
            quantities=(_number("factor", 0.08, 0.01, 0.4, 2.5, neutral=1.0),),
            spread="either",
        ),
        Kind(
            name="inertia",
            quantities=(
                _number("x", 0.2, 0.02, 0.4, 2.5, neutral=1.0),
                _number("y", 0.2, 0.02, 0.4, 2.5, neutral=1.0),
                _number("z", 0.2, 0.04, 0.4, 2.5, neutral=1.0),
            ),
            spread="either",
        ),
        Kind(name="translational-lift", quantities=(_number("k", 0.015, 0.001, -0.05, 0.2),), spread="above"),
        Kind(name="thrust-inflow", quantities=(_number("k", 0.5, 0.01, -0.2, 3.0),), spread="above"),
        Kind(
            name="rotor-loss",
            quantities=tuple(_number(f"loss_{i}", 0.1, 0.004, -0.2, 0.6) for i in (1, 2, 3, 4)),
            spread="one",
        ),
        Kind(
            name="actuation-delay",
            quantities=(_number("delay_s", 0.006, 0.0003, 0.0, 0.03),),
            spread="above",
            one_sided=True,
        ),
        Kind(
            name="frame-tilt",
            quantities=(
                _number("tilt_x", 0.015, 0.001, -0.1, 0.1),
                _number("tilt_y", 0.015, 0.001, -0.1, 0.1),
            ),
            spread="turned",
        ),
        Kind(
            name="ground-effect",
            quantities=(_number("k", 0.012, 0.0005, 0.0, 0.05),),
            spread="above",
            deviates=False,
        ),
        Kind(
            name="gyroscopic",
            quantities=(_number("h", 4.0, 0.2, -2.0, 40.0),),
            spread="above",
            deviates=False,
        ),
        Kind(
            name="torque-bias",
            quantities=tuple(_number(key, 2.5, 0.3, -20.0, 20.0) for key in "xyz"),
            spread="turned",
        ),
        Kind(
            name="slung-payload",
            quantities=(
                _number("ratio", 0.08, 0.003, 0.0, 0.5),
                # Short enough not to touch the floor when references descend to half a metre.
                _number("length_m", 0.3, 0.05, 0.15, 2.0, neutral=0.6, drawn=(0.3, 0.45)),
                _number("damping", 0.05, 0.02, 0.0, 0.5, neutral=0.05, drawn=(0.02, 0.06)),
            ),
            spread="above",
            deviates=False,
        ),
        _outside(
            "motor-cant",
            *(_number(f"cant_{i}", 0.026, 0.0, 0.0, 0.2) for i in (1, 2, 3, 4)),  # rad
            *(_place(f"towards_{i}", 0.0, _TURN, *_TURN) for i in (1, 2, 3, 4)),  # rad, from x to y
        ),
        _outside(
            "fan",
            _number("push_m_s2", 1.0, 0.0, 0.0, 20.0),
            _place("width_m", 0.8, (0.7, 0.9), 0.1, 10.0),
            _place("x_m", 0.5, (-0.6, 0.6), -50.0, 50.0),
            _place("y_m", 0.3, (-0.4, 0.4), -50.0, 50.0),
            _place("towards", 0.0, _TURN, *_TURN),  # rad, from north to east
        ),
        _outside(
            "wall-suction",
            _number("pull_m_s2", 1.0, 0.0, 0.0, 20.0),  # at a metre
            _place("distance_m", 2.4, (2.2, 2.6), 0.5, 50.0),  # of the wall from the origin
            _place("towards", 0.0, _TURN, *_TURN),  # rad, from north to east
        ),
        Kind(
            name="dead-zone",
            quantities=(
                _number("width", 0.08, 0.01, 0.0, 0.6),  # half width, in thrusts at hover
                _number("centre", 0.05, 0.02, 0.3, 2.0, neutral=1.0, drawn=(0.98, 1.02)),
            ),
            spread="above",
            deviates=False,
        ),
        Kind(
            name="uneven-lag",
            # Time constant of slowing down over that of speeding up.
            quantities=(_number("ratio", 1.0, 0.1, 1.0, 10.0, neutral=1.0),),
            spread="above",
            deviates=False,
        ),
        _outside(
            "shifting-battery",
            _number("share", 0.25, 0.0, 0.0, 0.6),
            _place("stiffness", 25.0, (18.0, 35.0), 5.0, 400.0),  # 1/s^2
            _place("slope", 0.15, (0.1, 0.2), -0.5, 0.5),  # rad, positive with the front end of the tray down
        ),
        _outside(
            "sweeping-fan",
            _number("push_m_s2", 1.0, 0.0, 0.0, 20.0),
            _place("period_s", 4.0, (3.0, 5.0), 0.5, 60.0),
            _place("towards", 0.0, _TURN, *_TURN),  # rad, from north to east
        ),
        _outside(
            "dropped-load",
            _number("share", 0.1, 0.0, 0.0, 0.5),  # of the mass in the vehicle file
            _place("at_s", 7.0, (6.0, 9.0), 0.0, 3600.0),  # after lift-off
        ),
        _outside(
            "camera-slip",
            _number("tilt", 0.02, 0.0, 0.0, 0.2),  # rad
            _number("yaw", 0.02, 0.0, 0.0, 0.2),  # rad
            _place("at_s", 7.0, (6.0, 9.0), 0.0, 3600.0),  # after lift-off
            _place("towards", 0.0, _TURN, *_TURN),  # of the axis of the tilt, rad, from north to east
        ),
        _outside(
            "hidden-marker",
            _number("shift_m", 0.02, 0.0, 0.0, 0.3),
            _number("tilt", 0.02, 0.0, 0.0, 0.2),  # rad
            _place("edge_m", 0.0, (-0.2, 0.2), -50.0, 50.0),  # of the area, from the origin
            _place("towards", 0.0, _TURN, *_TURN),  # of the area, rad, from north to east
        ),
        _outside("stabilised-camera", _number("lever_m", 0.01, 0.0, 0.0, 0.1)),
        _outside(
            "stuttering-motor",
            _number("depth", 0.2, 0.0, 0.0, 0.9),  # share of the rotor speed
            _place("every_s", 1.0, (0.9, 1.3), 0.1, 60.0),
            _place("length_s", 0.08, (0.06, 0.1), 0.001, 60.0),
            _place("towards", 0.0, _TURN, *_TURN),  # of the arm, rad, from x to y
        ),
    )
}
"""Every kind by name."""

DRAG = ("linear-drag", "quadratic-drag")
"""Wind acts through one of these."""
