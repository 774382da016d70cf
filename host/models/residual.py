"""The residual: what effects change of the nominal vehicle's acceleration and torque."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from trimtab.firmware_model.law.ops import Ops
from trimtab.firmware_model.law.rotations import euler_to_matrix, mat_vec
from trimtab.host.effects.effect import SLOTS
from trimtab.host.models.airframe import RATE, THETA, Airframe, Part, V
from trimtab.host.models.dynamics import rigid_body
from trimtab.host.models.slots import loads

Scalar = Any

_FORCE_SLOTS = ("mass_factor", "thrust_factor", "rotor_factors", "gravity_ned")
_TORQUE_SLOTS = ("thrust_factor", "rotor_factors", "inertia_factors", "added_inertia_kg_m2", "torque_frd")


def residual_acceleration_ned(
    ops: Ops, vehicle: Airframe, effects: Sequence[Part], x: Sequence[Scalar]
) -> Sequence[Scalar]:
    """Return the effects' specific force as an acceleration (3), m/s^2 NED."""
    R = euler_to_matrix(ops, x[THETA])
    force = loads(ops, vehicle, effects, x, R).specific_force_frd
    return (0.0, 0.0, 0.0) if force is None else mat_vec(R, force)


def residual_loads(
    ops: Ops, vehicle: Airframe, effects: Sequence[Part], known: Sequence[Part], x: Sequence[Scalar]
) -> tuple[list[Scalar] | None, list[Scalar] | None]:
    """Return the change by effects on mass, thrust, gravity, inertia and torque at x, beyond `known`.

    `known` are some of the effects. Specific forces are left out: `residual_acceleration_ned` has them.

    Returns
    -------
    acceleration
        (3), m/s^2 NED: that with all the effects less that with the known ones. None where no other effect
        fills a slot that could change it.
    torque
        (3), N m FRD: the same difference of the angular acceleration, times the moments of inertia of the
        vehicle file. None likewise.
    """
    names = {effect.name for effect, _ in known}
    unknown = [effect for effect, _ in effects if effect.name not in names]
    changes_force, changes_torque = (
        any(getattr(effect, slot) is not None for effect in unknown for slot in slots)
        for slots in (_FORCE_SLOTS, _TORQUE_SLOTS)
    )
    if not changes_force and not changes_torque:
        return None, None
    with_all, with_known = (rigid_body(ops, vehicle, _without_force(parts), x) for parts in (effects, known))
    change = [a - b for a, b in zip(with_all, with_known, strict=True)]
    torque = [j * alpha for j, alpha in zip(vehicle.inertia_kg_m2, change[RATE], strict=True)]
    return change[V] if changes_force else None, torque if changes_torque else None


def _without_force(effects: Sequence[Part]) -> list[Part]:
    """Return the effects without their specific force."""
    rest = [
        (effect, theta)
        for effect, theta in effects
        if any(getattr(effect, slot) is not None for slot in SLOTS if slot != "specific_force_frd")
    ]
    return [(dataclasses.replace(effect, specific_force_frd=None), theta) for effect, theta in rest]
