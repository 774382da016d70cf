"""The candidate effects: one file each, found by name.

An effect is data (`Effect`): equation, parameters with typical size and tolerance, known aliases, the slots
through which it enters the model, what closing the loop on it means, and where it comes from. What is
true of one effect alone stands in its file, and the code that uses it reads it there.
"""

from trimtab.host.effects.effect import SLOTS, Closing, Context, Effect, ExactAlias
from trimtab.host.effects.feedforward import compose_feedforward
from trimtab.host.effects.parameter import Parameter, number
from trimtab.host.effects.registry import EffectError, load_effects

__all__ = [
    "SLOTS",
    "Closing",
    "Context",
    "Effect",
    "EffectError",
    "ExactAlias",
    "Parameter",
    "compose_feedforward",
    "load_effects",
    "number",
]
