"""The simulated rotors: their speeds, and the forces at each hub.

A rotor speed is a share of full speed; `relative` is a multiple of hover speed. `P` holds the constants of
`plant_model.PARAMETERS`, `parts` the optional physics in use. Frames: body FRD, world NED.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import Any

from trimtab.sitl.vectors import Scalar, Vector

_SAG_LOAD = -0.1  # under load, the speed falls less than in proportion to voltage
_GAIN_REYNOLDS = 0.3  # a propeller's thrust error shrinks as it turns faster
_LOSS_REYNOLDS = 0.3  # so does the thrust loss of a damaged blade
_LOSS_DRAG = 0.7  # relative reduction of drag torque over that of thrust: a damaged blade still drags
_GROUND_FADE_M = 10.0  # decay in addition to the inverse square of height
_GROUND_ROOT_M = 0.15  # core radius of the mirrored rotor, which keeps the law finite
_GROUND_MOST = 0.3  # thrust grows to at most 1 / (1 - this)


def rotor_speeds(
    ops: Any,
    P: Mapping[str, Any],
    speeds: Vector,
    command: Vector,
    voltage: Scalar,
    spells: Scalar,
    parts: Container[str],
) -> tuple[list[Scalar], list[Scalar]]:
    """Return rotor speeds in the middle and at the end of the tick. Each follows its command with a lag.

    A motor controller that loses its rotor's position stutters: it drives the rotor at a lower speed at the
    start of each of the `spells`.
    """
    c1, c2 = P["thrust_curve"]
    sags = "battery-sag" in parts
    sag = 0.5 * P["sag_exponent"][0] * ops.log(voltage / P["battery"][0]) if sags else 0.0
    middle: list[Scalar] = []
    end: list[Scalar] = []
    for i, (n, u) in enumerate(zip(speeds, command, strict=True)):
        if "dead-zone" in parts:
            u = _dead(ops, u, *P["dead_zone"])
        target = ops.sqrt(u * (c1 + c2 * u))
        if sags:
            load = 1 + _SAG_LOAD * (n / P["hover_speed"][0] - 1)
            target = target * ops.exp(sag * load)
        if "stuttering-motor" in parts:
            lost = ops.where(spells - ops.floor(spells) < P["stutter"][5], P["stutter"][i], 0.0)
            target = target * (1.0 - lost)
        keep = ops.where(target > n, P["rise_half_tick"][0], P["fall_half_tick"][0])
        middle.append(target + (n - target) * keep)
        end.append(target + (n - target) * keep * keep)
    return middle, end


def rotor_thrust(
    ops: Any, P: Mapping[str, Any], i: int, speed: Scalar, relative: Scalar, hub: Vector
) -> tuple[Scalar, Scalar]:
    """Return the thrust of rotor i, N, and the thrust that its drag torque is proportional to, N.

    `hub` is the velocity of the hub through the air, FRD. Air across the disc lowers the induced velocity
    (Glauert: v_i^2 = sqrt(V^4/4 + v_h^4) - V^2/2) and so increases the thrust at the same speed. Air along
    the axis changes the blade's angle of attack.
    """
    gain = 1 + (P["thrust_gain"][0] - 1) / (1 + _GAIN_REYNOLDS * (relative - 1))
    whole = P["thrust_max_n"][0] * gain * speed * speed
    lost = P["rotor_loss"][i] * (1 - _LOSS_REYNOLDS * (relative - 1))
    hover_inflow = P["hover_inflow"][0]
    half = 0.5 * (hub[0] * hub[0] + hub[1] * hub[1])
    induced = ops.sqrt(ops.sqrt(half * half + P["hover_inflow"][1]) - half)
    lift = P["translational_lift"][0] * relative * (hover_inflow - induced)
    axial = hub[2] / hover_inflow
    lift = lift + P["thrust_inflow"][0] * relative * hub[2] / ops.sqrt(1 + axial * axial)
    return whole * (1 - lost) + lift, whole * (1 - _LOSS_DRAG * lost)


def ground_gain(ops: Any, P: Mapping[str, Any], height: Scalar, upright: Scalar) -> Scalar:
    """Return the factor on a rotor's thrust at a height over the floor: Cheeseman and Bennett, with a decay.

    `upright` is the cosine of the tilt: the wake of a tilted rotor does not return to it.
    """
    near = ops.maximum(height, 0.0)
    share = P["ground_effect"][0] * ops.exp(-near / _GROUND_FADE_M) * upright
    return 1 / (1 - ops.minimum(share / (near * near + _GROUND_ROOT_M * _GROUND_ROOT_M), _GROUND_MOST))


def _dead(ops: Any, u: Scalar, centre: Scalar, width: Scalar) -> Scalar:
    """Return the effective motor command: all commands within `width` of `centre` act as `centre`."""
    return ops.where(ops.fabs(u - centre) < width, centre, u)
