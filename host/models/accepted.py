"""Whether a model may be acted on: what its data supports."""

from __future__ import annotations

from pathlib import Path

from trimtab.host.base.errors import UsageError
from trimtab.host.base.output import warn
from trimtab.host.models.file import check_vehicle, read_model
from trimtab.host.models.model import Assessment, Model


def accepted_model(
    model: Model | Path | str, accept_undecided: bool, *, vehicle_id: str | None = None
) -> Model:
    """Return a model, or the one in a file, to act on. Warn on stderr if the data does not fully support it.

    Raises
    ------
    UsageError
        If its verdict is undecided and that is not accepted, and as `read_model` does.
    """
    if isinstance(model, Model):
        name, content = "the model", model
        check_vehicle(content, vehicle_id, name)
    else:
        name, content = str(model), read_model(model, vehicle_id=vehicle_id)
    assessment = content.assessment
    if assessment is None:
        warn(f"{name}: states no verdict; nothing shows whether the data supports it")
    elif assessment.verdict == "outside-library":
        warn(f"{name}: a part of the residual has a cause outside the library, which the model lacks")
    elif assessment.verdict == "undecided":
        what = f"{name}: its verdict is undecided{_support(assessment)}"
        if not accept_undecided:
            raise UsageError(f"{what}; fly what trace proposes and trace again, or add --accept-undecided")
        warn(f"{what}; accepted")
    return content


def _support(assessment: Assessment) -> str:
    """Return an assessment's probabilities and held-out errors as text in parentheses, or an empty text."""
    parts = [", ".join(f"{name} {p:.2f}" for name, p in assessment.probabilities.items())]
    if assessment.before_m is not None and assessment.after_m is not None:
        parts.append(f"held out {1e3 * assessment.before_m:.1f} to {1e3 * assessment.after_m:.1f} mm")
    text = "; ".join(part for part in parts if part)
    return f" ({text})" if text else ""
