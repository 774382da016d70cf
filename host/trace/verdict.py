"""The rules by which a verdict is given: substitutes, what thin data cannot show, and what speaks against."""

from __future__ import annotations

from collections.abc import Mapping

from trimtab.host.trace.diagnose import Diagnosis, Fit, refit
from trimtab.host.trace.form import Form
from trimtab.host.trace.parameters import Space
from trimtab.host.trace.result import SHOWN, Verdict
from trimtab.host.trace.search import WITHIN_NATS, Names, likeliest
from trimtab.host.trace.twins import Leftover

ALIAS_PROBABILITY = 0.05
"""What the data gives an effect more than is not excluded."""

SOMETHING = 0.05
"""Probability of no effect at all up to which it is undecided whether one is missing, if none is kept."""

RESTLESS = 0.5
"""Disturbance in m/s^2 that is left and counts as more than turbulence where no reference was flown twice."""

RESTLESS_TURN = 3.0
"""The same for angular acceleration in rad/s^2."""


def verdict_of(
    diagnosis: Diagnosis,
    rest: Leftover,
    aliases: Mapping[str, Mapping[str, float]],
    *,
    doubted: bool,
) -> Verdict:
    """The verdict: outside where `rest` speaks, else as sure as aliases and doubts leave what was kept."""
    if rest.reasons:
        return "outside-library"
    if doubted:
        return "undecided"
    if not diagnosis.best.effects:
        return "nothing-missing" if diagnosis.none > SOMETHING else "undecided"
    return "undecided" if any(aliases.values()) else "traced"


def substitutes(diagnosis: Diagnosis, chosen: Space, name: str) -> dict[str, float]:
    """Probability of each effect in place of `name`: sets without `name` that have it."""
    weights = diagnosis.weights
    total = sum(weights.values())
    kept = set(diagnosis.best.effects)
    out = {}
    for other in chosen.candidates:
        if other in kept:
            continue
        share = sum(w for names, w in weights.items() if name not in names and other in names) / total
        if share > ALIAS_PROBABILITY:
            out[other] = share
    return dict(sorted(out.items(), key=lambda item: -item[1]))


def with_hidden(
    aliases: Mapping[str, Mapping[str, float]], chosen: Space, stands_out: Mapping[str, float]
) -> dict[str, dict[str, float]]:
    """The aliases with those that an effect is known for and that too little data would not show at typical
    size: nothing speaks against them, so they are as probable as what was named.
    """
    hidden = [name for name, sigma in stands_out.items() if sigma < SHOWN and name not in aliases]
    out: dict[str, dict[str, float]] = {}
    for name, others in aliases.items():
        effect = chosen.effect(name)
        known = [o for o in hidden if o in effect.aliases or effect.name in chosen.effects[o].aliases]
        out[name] = {**{other: 0.5 for other in known if not chosen.effects[other].one_of}, **others}
    return out


def with_each_other(aliases: Mapping[str, Mapping[str, float]], chosen: Space) -> dict[str, dict[str, float]]:
    """The aliases with those among the effects named themselves.

    For thin data: no form is exact, and what one effect leaves of itself its known alias takes up. What acts
    through another effect is found beside it, not in its place.
    """
    out = {name: dict(others) for name, others in aliases.items()}
    for name in aliases:
        effect = chosen.effect(name)
        for other in aliases:
            beside = chosen.effect(other)
            through = beside.name in effect.requires_any or effect.name in beside.requires_any
            if not through and (beside.name in effect.aliases or effect.name in beside.aliases):
                out[name][other] = 0.5
    return out


def restless_of(fit: Fit, *, axial: bool) -> str | None:
    """What the kept set leaves where it is too much for turbulence and no twin says whether it repeats."""
    sigma = fit.process.sigma()
    force, torque = float(sigma[: 3 if axial else 2].max()), float(sigma[3:].max())
    if force > RESTLESS:
        what = f"a force of {force:.1f} m/s^2"
    elif torque > RESTLESS_TURN and not fit.data.rate_driven:
        what = f"an angular acceleration of {torque:.0f} rad/s^2"
    else:
        return None
    return f"{what} is left, too much for turbulence indoors; fly references twice to see whether it repeats"


def explained_beyond(sets: Mapping[Names, float], weights: Mapping[Names, float]) -> str | None:
    """What explains segments far better with an effect at its bounds, or too small to be there, than any set
    does that could be kept, by the evidence of the fitted `sets`; only those that could be kept have weights.
    """
    kept = max(value for names, value in sets.items() if names in weights)
    out = {names: value for names, value in sets.items() if names not in weights}
    if not out or out[names := likeliest(out)] < kept + WITHIN_NATS:
        return None
    return f"{', '.join(names)} would explain more, but not in sizes that they could have"


def spoken_against(form: Form, nothing: Fit, kept: Names) -> str | None:
    """Which effects, `kept` by whole flights, segments find far more probably absent; None where none is.

    One flight's gusts are few, and its whitening may take them for physics; segments have a disturbance of
    their own for them, and free states at each start.
    """
    whole = refit(form, nothing.data, kept, nothing)
    absent = [
        name
        for name in kept
        if refit(form, nothing.data, tuple(n for n in kept if n != name), whole).log_evidence
        > whole.log_evidence + WITHIN_NATS
    ]
    return f"{', '.join(absent)}: whole flights say yes, segments no; fly more" if absent else None


def closest_of(
    aliases: Mapping[str, Mapping[str, float]], inclusion: Mapping[str, float]
) -> tuple[str, str] | None:
    """The effect and the alias that the data separates least; where nothing was named, the two candidates
    most probable, and None where there are none.
    """
    pairs = [(p, name, other) for name, others in aliases.items() for other, p in others.items()]
    if pairs:
        return max(pairs)[1:]
    likely = sorted(((p, name) for name, p in inclusion.items() if p > ALIAS_PROBABILITY), reverse=True)[:2]
    return (likely[0][1], likely[1][1]) if not aliases and len(likely) == 2 else None


def possible_of(diagnosis: Diagnosis, aliases: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Probability of each effect beside the kept ones that the data does not exclude; substitutes apart."""
    substitutes = {other for others in aliases.values() for other in others}
    found = {
        name: probability
        for name, probability in diagnosis.inclusion.items()
        if name not in diagnosis.best.effects and name not in substitutes and probability > ALIAS_PROBABILITY
    }
    return dict(sorted(found.items(), key=lambda item: -item[1]))
