"""Options that verbs share, as annotated types for their parameters."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from trimtab.host.link.keys import StationKey
    from trimtab.host.models.model import Assessment, Model

Json = Annotated[
    bool, Parameter(name="--json", negative="", help="Print one JSON object as the last line of stdout.")
]

Force = Annotated[bool, Parameter(name="--force", negative="", help="Overwrite the output file.")]

Output = Annotated[Path | None, Parameter(name=["-o", "--output"])]
"""The docstring of each verb describes the output and its default."""

KeyFile = Annotated[
    Path | None,
    Parameter(name="--key", help="Key file, if the vehicle has a key: `trimtab key new` makes one."),
]

VehicleName = Annotated[str, Parameter(name="--vehicle", help="Vehicle file, by name or path.")]

WorkspaceFolder = Annotated[
    Path | None,
    Parameter(
        name="--workspace", help="Folder with vehicles/, routes/ and effects/. Default: the current folder."
    ),
]

AcceptUndecided = Annotated[
    bool,
    Parameter(name="--accept-undecided", negative="", help="Also use a model whose verdict is undecided."),
]

DEFAULT_VEHICLE = "research"


def key_option(path: Path | None) -> StationKey | None:
    """Return the key in the file of --key, recorded as used now; None without it. Raises UsageError."""
    if path is None:
        return None
    from trimtab.host.link.drivers import wall_timestamp
    from trimtab.host.link.keys import use_key

    return use_key(path, wall_timestamp())


def accepted_model(path: Path, accept_undecided: bool, *, vehicle_id: str | None = None) -> Model:
    """Return the model in a file, for a verb that acts on it. Warn if the data does not fully support it.

    Raises
    ------
    UsageError
        If its verdict is undecided and that is not accepted, and as `read_model` does.
    """
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import warn
    from trimtab.host.models.file import read_model

    model = read_model(path, vehicle_id=vehicle_id)
    assessment = model.assessment
    if assessment is None:
        warn(f"{path}: states no verdict; nothing shows whether the data supports it")
    elif assessment.verdict == "outside-library":
        warn(f"{path}: a part of the residual has a cause outside the library, which the model lacks")
    elif assessment.verdict == "undecided":
        what = f"{path}: its verdict is undecided{_support(assessment)}"
        if not accept_undecided:
            raise UsageError(f"{what}; fly what trace proposes and trace again, or add --accept-undecided")
        warn(f"{what}; accepted")
    return model


def _support(assessment: Assessment) -> str:
    """Return an assessment's probabilities and held-out errors as text in parentheses, or an empty text."""
    parts = [", ".join(f"{name} {p:.2f}" for name, p in assessment.probabilities.items())]
    if assessment.before_m is not None and assessment.after_m is not None:
        parts.append(f"held out {1e3 * assessment.before_m:.1f} to {1e3 * assessment.after_m:.1f} mm")
    text = "; ".join(part for part in parts if part)
    return f" ({text})" if text else ""
