"""The simulated rotors: how fast they turn, and what each gives at its hub.

A rotor's speed is a share of its full speed, `relative` a multiple of hover's. `P` holds the constants of
`plant_model.PARAMETERS`, `parts` the optional physics in use; frames: body FRD, world NED.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import Any

from trimtab.sitl.vectors import Scalar, Vector

_SAG_LOAD = -0.1  # a loaded motor gives way less than in proportion to voltage
_GAIN_REYNOLDS = 0.3  # a propeller's thrust error shrinks as it turns faster
_LOSS_REYNOLDS = 0.3  # so does what a damaged blade loses
_LOSS_DRAG = 0.7  # share of the lost thrust that is saved as drag torque: a damaged blade still drags
_GROUND_FADE_M = 10.0  # over and above the inverse square of height
_GROUND_ROOT_M = 0.15  # height of the mirrored rotor's core: keeps the law finite
_GROUND_MOST = 0.3  # thrust grows to at most 1 / (1 - this)


def rotor_speeds(
    ops: Any, P: Mapping[str, Any], speeds: Vector, command: Vector, voltage: Scalar, parts: Container[str]
) -> tuple[list[Scalar], list[Scalar]]:
    """Rotor speeds in the middle and at the end of the tick: each follows its command, first order."""
    c1, c2 = P["thrust_curve"]
    sags = "battery-sag" in parts
    sag = 0.5 * P["sag_exponent"][0] * ops.log(voltage / P["battery"][0]) if sags else 0.0
    middle: list[Scalar] = []
    end: list[Scalar] = []
    for n, u in zip(speeds, command, strict=True):
        if "dead-zone" in parts:
            u = _dead(ops, u, *P["dead_zone"])
        target = ops.sqrt(u * (c1 + c2 * u))
        if sags:
            load = 1 + _SAG_LOAD * (n / P["hover_speed"][0] - 1)
            target = target * ops.exp(sag * load)
        keep = ops.where(target > n, P["rise_half_tick"][0], P["fall_half_tick"][0])
        middle.append(target + (n - target) * keep)
        end.append(target + (n - target) * keep * keep)
    return middle, end


def rotor_thrust(
    ops: Any, P: Mapping[str, Any], i: int, speed: Scalar, relative: Scalar, hub: Vector
) -> tuple[Scalar, Scalar]:
    """Thrust of rotor i, N, and what its drag torque goes with, N; `hub` is its air velocity in FRD.

    Air across the disc lowers the induced velocity (Glauert's v_i^2 = sqrt(V^4/4 + v_h^4) - V^2/2) and so
    raises the thrust of a blade that turns as before; air along the axis changes the blade's angle.
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
    """Factor on a rotor's thrust at a hub's height over the floor: Cheeseman and Bennett's, fading.

    `upright` is the cosine of the tilt: a leaning rotor's wake comes back beside it.
    """
    near = ops.maximum(height, 0.0)
    share = P["ground_effect"][0] * ops.exp(-near / _GROUND_FADE_M) * upright
    return 1 / (1 - ops.minimum(share / (near * near + _GROUND_ROOT_M * _GROUND_ROOT_M), _GROUND_MOST))


def _dead(ops: Any, u: Scalar, centre: Scalar, width: Scalar) -> Scalar:
    """Return a command as the motor takes it: within `width` of `centre` all are the same."""
    return ops.where(ops.fabs(u - centre) < width, centre, u)
