"""Trial of an effect's slots, so that a wrong effect file is refused when it is read, not within a fit."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.effects.effect import SLOTS, Context, Effect, Theta

_ARM_M = 0.1
_CONTEXT = Context(
    p_ned=(0.3, -0.2, -1.5),
    v_ned=(1.1, -0.7, 0.2),
    v_air_frd=(1.1, -0.7, 0.2),
    R=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
    rate_frd=(0.3, -0.2, 0.1),
    thrust=(2.3, 2.4, 2.5, 2.6),
    collective_n=9.8,
    mass_kg=1.0,
    voltage_ratio=0.95,
    t_s=3.0,
    rotor_positions=tuple((x * _ARM_M, y * _ARM_M, 0.0) for x, y in ((1, 1), (-1, -1), (1, -1), (-1, 1))),
    spin_signs=(1.0, 1.0, -1.0, -1.0),
    inertia_kg_m2=(0.005, 0.005, 0.009),
    hover_n=GRAVITY / 4.0,
    torque_per_thrust_m=0.02,
)
"""A vehicle of 1 kg that flies near hover."""


def fault(effect: Effect) -> str | None:
    """Return what is wrong with the numbers that the slots of an effect return, or None.

    Each slot is called with floats, at the neutral and at typical values, for a vehicle near hover.
    """
    typical = tuple(
        min(max(p.neutral + p.typical, p.lower), p.upper) if not p.form else p.neutral
        for p in effect.parameters
    )
    for words, theta in (("neutral", effect.neutral), ("typical", typical)):
        for slot, count, call in _calls(effect, theta):
            try:
                result = call()
                numbers = [float(result)] if count is None else [float(number) for number in result]
            except Exception as error:  # any exception of a user's function is a fault of its file
                return f"{slot} fails at {words} values with {type(error).__name__}: {error}"
            if count is not None and len(numbers) != count:
                return f"{slot} returns {len(numbers)} numbers; it must return {count}"
            if not all(math.isfinite(number) for number in numbers):
                return f"{slot} returns {numbers} at {words} values; bound what it computes"
    return None


def _calls(effect: Effect, theta: Theta) -> list[tuple[str, int | None, Callable[[], Any]]]:
    """Return name, number of results (None for a scalar) and call of each slot that the effect fills."""
    ctx, rates = _CONTEXT, (1.0, -1.0, 0.5, -0.5)
    swinging = ctx._replace(memory=(0.01,) * effect.memory, a_ned=(0.1, 0.2, -0.1))
    arguments: dict[str, tuple[int | None, tuple[Any, ...]]] = {
        "mass_factor": (None, ()),
        "thrust_factor": (None, (ctx,)),
        "rotor_factors": (4, (ctx,)),
        "inertia_factors": (3, ()),
        "added_inertia_kg_m2": (4, (ctx.mass_kg,)),
        "wind_ned": (3, ()),
        "gravity_ned": (3, ()),
        "specific_force_frd": (3, (swinging,)),
        "torque_frd": (3, (swinging,)),
        "thrust_rate_torque_frd": (3, (ctx, rates)),
        "motor_lag_s": (None, (0.03,)),
        "driven_thrust_n": (None, (2.6, ctx.hover_n)),
        "lag_factor": (None, (2.6, 2.4)),
        "command_delay_s": (None, ()),
        "mocap_latency_s": (None, ()),
        "memory_start": (effect.memory, (ctx,)),
        "memory_rates": (effect.memory, (swinging,)),
    }
    calls = []
    for name in (*SLOTS, "memory_start", "memory_rates"):
        slot = getattr(effect, name)
        if slot is not None:
            count, more = arguments[name]
            calls.append((name, count, partial(slot, FLOAT, theta, *more)))
    return calls
