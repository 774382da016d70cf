"""Generate docs/reference/effects.md, on the candidate effects, from the effects themselves.

`python docs/generators/effects.py FILE` writes it. A test compares the page with the code.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from trimtab.host.effects import Effect, load_effects

_HEAD = """# Candidate effects

<!-- Made by `make docs` from host/effects; change it there. -->

These are the effects that `trimtab trace` can name. Each candidate is one file in `host/effects`. A workspace
adds its own in `effects/`. World is NED, body is FRD, units are SI.

- **Neutral** values change nothing. **Typical** is the usual distance from neutral if the effect is present.
- **Tolerance** is one standard deviation of the size that is not worth naming. An effect that is not named
  still moves within it. A vehicle file can set its own under `"effect.parameter"`. Simulated worlds draw
  their small deviations from these values.
- **Discrepancy** is one standard deviation, in typical sizes, of what flights without the effect seem to show
  of it, because no model is exact. The first value is for segments of flights, the second for whole flights.
- The **form** of an effect is how a real vehicle may deviate from its equation. Its parameters have a
  [table of their own](#parameters-of-the-form).
- An effect is **mistaken for** others if both explain a flight almost equally well. If the data cannot
  decide, `trace` lists them with their probabilities. If no flight can decide, a measurement may.
- If two effects fit every flight **exactly alike**, `trace` names the quantity that flights do show, and how
  to tell the effects apart. An **adjustment** is in every model within its tolerance and never named alone.
- A quantity that a log declares [unknown](../guide/imports.md#what-is-declared-unknown) can **replace** an
  effect, which then leaves the model. It can also leave the effect **free**: the effect is then fitted to
  every flight and not named.
- Each section ends with the consequences for the model, the planner and the law on board.
"""

_TABLE_HEAD = """
## Parameters

The answer of `trace` uses these keys, and so do `[effects]` and `[adjustments]` in model files. World files
use the same keys for the effects that they have.

| effect | key | unit | neutral | typical | tolerance | discrepancy | range | meaning |
|---|---|---|---|---|---|---|---|---|
"""

_FORMS_HEAD = """
## Parameters of the form

No equation is exact for a real vehicle. These parameters say how the vehicle may deviate from it, and by how
much. They vary around neutral with the given standard deviation, also while the effect is within tolerance.
They change nothing without the effect. `trace` does not list them among the values of an effect,
but the model file holds those of named effects. [How tracing works](../concepts/tracing.md#4-search) says why
they are there.

| effect | key | unit | neutral | standard deviation | range | meaning |
|---|---|---|---|---|---|---|
"""

_LAW_NONE = "not compensable on board"


def page(effects: Mapping[str, Effect]) -> str:
    """Return the page as Markdown: terms, tables of parameters, and a section for each effect."""
    rows = [
        f"| `{effect.name}` | `{p.key}` | {p.unit} | {p.neutral:g} | {p.typical:g} | {p.tolerance:g} "
        f"| {p.discrepancy:g}, {p.loop_discrepancy:g} | {p.lower:g} to {p.upper:g} | {p.description} |"
        for effect in effects.values()
        for p in effect.parameters
        if not p.form
    ]
    forms = [
        f"| `{effect.name}` | `{p.key}` | {p.unit} | {p.neutral:g} | {p.tolerance:g} "
        f"| {p.lower:g} to {p.upper:g} | {p.description} |"
        for effect in effects.values()
        for p in effect.parameters
        if p.form
    ]
    return (
        _HEAD
        + _TABLE_HEAD
        + "\n".join(rows)
        + "\n"
        + _FORMS_HEAD
        + "\n".join(forms)
        + "\n"
        + "".join(_section(effect, effects) for effect in effects.values())
    )


def _section(effect: Effect, effects: Mapping[str, Effect]) -> str:
    lines = [
        f"\n## {effect.name}",
        "",
        f"{effect.title}: `{effect.equation}`",
        "",
        f"- Source: {effect.source}.",
        f"- Mistaken for: {', '.join(effect.aliases) or 'nothing'}.",
        *_facts(effect, effects),
    ]
    law = effect.closing.law or ": ".join(filter(None, (_LAW_NONE, effect.closing.no_law)))
    lines += [
        f"- In the model: {effect.closing.model}.",
        f"- In the planner: {effect.closing.planner}.",
        f"- In the law: {law}.",
    ]
    return "\n".join(lines) + "\n"


def _facts(effect: Effect, effects: Mapping[str, Effect]) -> list[str]:
    """Return lines for the optional fields of the effect that differ from their defaults."""
    lines = []
    for alias in effect.exact_aliases:
        measured = effects[alias.effect].parameters[0]
        line = f"- Exactly like {alias.effect}"
        if measured.measured_below is not None:
            key = f"{alias.effect}.{measured.key}"
            line += f' unless the vehicle file gives `"{key}"` below {measured.measured_below:g}'
        if alias.ratio is not None:
            line += f": only {alias.ratio} shows"
        lines.append(f"{line}; {alias.remedy}.")
    for other in effect.aliases:
        stated = effects[other].separated_by if other in effects else {}
        if how := effect.separated_by.get(other) or stated.get(effect.name):
            lines.append(f"- If no flight separates it from {other}: {how}.")
    if effect.observed_relative_to:
        lines.append(f"- Shows only relative to {effect.observed_relative_to}.")
    if effect.requires_any:
        lines.append(f"- Shows only beside {' or '.join(effect.requires_any)}.")
    if effect.observable:
        lines.append(f"- Observable: {effect.observable}.")
    lines += [
        f"- Left out if `{signal}` departs from rest by {least:g} or less in every flight."
        for signal, least in effect.needs_signals.items()
    ]
    if effect.replaced_by:
        lines.append(f"- Replaced by an unknown {_words(effect.replaced_by)}.")
    if effect.freed_by:
        free = ", ".join(
            f"`{p.key}` with sigma {p.typical if p.free_sigma is None else p.free_sigma:g}, "
            "{:g} to {:g}".format(*p.free_bounds)
            for p in effect.parameters
            if not p.form
        )
        lines.append(f"- Free with an unknown {_words(effect.freed_by)}: {free}.")
    if effect.adjustment:
        lines.append("- An adjustment: never named by itself.")
    return lines


def _words(words: Sequence[str]) -> str:
    return " or ".join(f"`{word}`" for word in words)


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(load_effects()), encoding="utf-8")
