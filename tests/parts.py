"""Parts of models: shipped effects with values for their first parameters."""

from __future__ import annotations

from functools import cache

from trimtab.host.effects import Effect, load_effects

_shipped = cache(load_effects)


def part(name: str, *values: float) -> tuple[Effect, tuple[float, ...]]:
    """Return a shipped effect with `values` for its first parameters; the others are neutral."""
    effect = _shipped()[name]
    return effect, effect.theta(values)
