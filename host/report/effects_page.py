"""The page on the candidate effects, docs/effects.md, made from the effects themselves.

`python -m trimtab.host.report.effects_page FILE` writes it; a test holds the page against the code.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

from trimtab.host.effects import Effect, load_effects

_HEAD = """# Candidate effects

<!-- Made by `make docs` from host/effects; change it there. -->

What `trimtab trace` may name. Each candidate is one file in `host/effects`; a workspace adds its own in
`effects/`. World is NED, body is FRD, SI units.

- **Neutral** values change nothing. **Typical** is the usual distance from neutral where the effect is there.
- **Tolerance** is one sigma of what is not worth naming: an effect that is not named still moves within it. A
  vehicle file gives its own under `"effect.parameter"`; simulated worlds draw their small errors from those.
- An effect is **mistaken for** others where both explain a flight nearly alike; where the data cannot decide,
  `trace` lists them with their probabilities. `mass` is never named by itself, as only thrust over mass shows
  in flight: it stands beside `thrust-gain` unless the vehicle file declares a weighing (`"mass.factor"` below
  0.005).
- What **closing the loop** means ends each section: what the model gains, what a new plan does about it, and
  what the law on board does where it can.
"""

_TABLE_HEAD = """
## Parameters

The keys are those of the answer of `trace` and of `[effects]` and `[adjustments]` in model files; world files
use the same for the effects they have.

| effect | key | unit | neutral | typical | tolerance | range | meaning |
|---|---|---|---|---|---|---|---|
"""

_LAW_NONE = "not compensable on board"


def page(effects: Mapping[str, Effect]) -> str:
    """The page as Markdown: what the words mean, a table of parameters, a section for each effect."""
    rows = [
        f"| `{effect.name}` | `{p.key}` | {p.unit} | {p.neutral:g} | {p.typical:g} | {p.tolerance:g} "
        f"| {p.lower:g} to {p.upper:g} | {p.description} |"
        for effect in effects.values()
        for p in effect.parameters
    ]
    return _HEAD + _TABLE_HEAD + "\n".join(rows) + "\n" + "".join(map(_section, effects.values()))


def _section(effect: Effect) -> str:
    lines = [
        f"\n## {effect.name}",
        "",
        f"{effect.title}: `{effect.equation}`",
        "",
        f"- Source: {effect.source}.",
        f"- Mistaken for: {', '.join(effect.aliases) or 'nothing'}.",
    ]
    if effect.requires_any:
        lines.append(f"- Shows only beside {' or '.join(effect.requires_any)}.")
    law = effect.closing.law or _LAW_NONE
    lines += [
        f"- In the model: {effect.closing.model}.",
        f"- In the planner: {effect.closing.planner}.",
        f"- In the law: {law}.",
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(load_effects()), encoding="utf-8")
