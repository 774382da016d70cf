"""The candidate effects: one file each, found by name.

An effect is data (`Effect`): its equation, parameters with typical size and tolerance, known aliases, the
slots through which it enters the model, the consequences of closing the loop on it, and its source. Facts
about a single effect are only in its file; all other code reads them there.
"""

from trimtab.host.effects.effect import SLOTS, Closing, Context, Effect, ExactAlias
from trimtab.host.effects.feedforward import compose_feedforward
from trimtab.host.effects.parameter import Parameter, form, number
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
    "form",
    "load_effects",
    "number",
]
