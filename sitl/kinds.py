"""What a simulated world can hold beyond the nominal vehicle: names, keys, sizes.

Written for the simulator, not read from the host's candidates: the names and keys agree because the
documentation fixes them. `tolerance` is one sigma of the deviation that every drawn world carries
unannounced; the vehicle file may override it. Blade flapping and the tether are outside the host's library.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Spread = Literal["above", "either", "turned"]
"""How sizes are drawn: each above neutral, on either side of it, or two numbers as one vector turned."""


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """One number of a kind: its key in world files, typical distance from neutral, tolerance and bounds."""

    key: str
    typical: float
    tolerance: float
    lower: float
    upper: float
    neutral: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Kind:
    """One kind of effect. `one_sided` tolerances deviate away from neutral only, as drag does."""

    name: str
    quantities: tuple[Quantity, ...]
    spread: Spread
    one_sided: bool = False
    outside: bool = False


def _number(
    key: str, typical: float, tolerance: float, lower: float, upper: float, neutral: float = 0.0
) -> Quantity:
    return Quantity(key=key, typical=typical, tolerance=tolerance, lower=lower, upper=upper, neutral=neutral)


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
        Kind(name="battery-sag", quantities=(_number("exponent", 1.7, 0.0, 0.0, 5.0),), spread="above"),
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
        Kind(
            name="blade-flapping",
            quantities=(_number("moment", 2.0, 0.0, 0.0, 20.0),),  # rad/s^2 per m/s, at hover rotor speed
            spread="above",
            outside=True,
        ),
        Kind(
            name="elastic-tether",
            quantities=(
                _number("stiffness", 0.5, 0.0, 0.0, 20.0),  # 1/s^2: N/m per kg
                _number("damping", 0.05, 0.0, 0.0, 5.0),  # 1/s
                _number("slack_m", 0.8, 0.0, 0.0, 20.0),
                _number("anchor_x_m", 0.5, 0.0, -50.0, 50.0),
                _number("anchor_y_m", 0.5, 0.0, -50.0, 50.0),
                _number("anchor_z_m", 0.0, 0.0, -50.0, 50.0),
            ),
            spread="above",
            outside=True,
        ),
    )
}
"""Every kind by name."""

BUILD_TOLERANCES = {
    ("mass", "factor"): 0.01,
    ("inertia", "x"): 0.02,
    ("inertia", "y"): 0.02,
    ("inertia", "z"): 0.04,
}
"""Shares by which mass and inertia of the build deviate: one sigma where the vehicle file states none."""

DRAG = ("linear-drag", "quadratic-drag")
"""Wind acts through one of these."""
