"""`trimtab show`: flights, plans and models on one interactive page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from trimtab.host.verbs.options import Force, Json, Trust, WorkspaceFolder

if TYPE_CHECKING:
    from trimtab.host.show.content import Content

PAGE_SUFFIX = ".html"
FOLDER_PAGE = "show.html"


def command(
    *inputs: Path,
    html: Annotated[Path | None, Parameter(name="--html")] = None,
    vehicle: Annotated[str | None, Parameter(name="--vehicle")] = None,
    workspace: WorkspaceFolder = None,
    trust: Trust = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write one interactive HTML page of flights, plans and models. It opens without a network.

    Parameters
    ----------
    inputs
        Flight logs (.mcap), references (.ref), models (.model.toml), and folders, which stand for their logs.
        A cut log shows its intact part.
    html
        Page to write. Default: NAME.html beside the first input; for a folder, show.html in it.
    vehicle
        Vehicle of the references, by name or path. Default: the known vehicle whose id they hold.
    """
    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit, say
    from trimtab.host.report.show import page
    from trimtab.host.show.content import read_content
    from trimtab.host.workspace import open_workspace

    if not inputs:
        raise UsageError("nothing to show; name a flight log, a reference, a model or a folder")
    target = html or default_page(inputs[0])
    if target.suffix != PAGE_SUFFIX:
        raise UsageError(f"{target}: give the page a name that ends in {PAGE_SUFFIX}")
    artefacts.check_output(target, force)
    space = open_workspace(workspace, trusted=trust)
    content = read_content(inputs, space, None if vehicle is None else space.vehicle(vehicle))
    artefacts.write_atomic(target, page(content), force)
    say(*_lines(content, target))
    emit({"page": str(target), **content.facts()}, json)


def default_page(first: Path) -> Path:
    """Return the default path of the page."""
    return first / FOLDER_PAGE if first.is_dir() else first.with_name(first.name + PAGE_SUFFIX)


def _lines(content: Content, target: Path) -> list[str]:
    """Return what the page shows as lines of text."""
    lines = [f"{target}: open it in a browser"]
    lines += [f"  {_flight(row)}" for row in content.flights]
    lines += [
        f"  {row['reference']}: plan, {row['duration_s']:.2f} s, at most {row['speed_max_m_s']:.2f} m/s"
        for row in content.plans
    ]
    lines += [f"  {row['model']}: model, {row['verdict'] or 'no verdict'}" for row in content.models]
    notes = [note for row in (*content.flights, *content.plans, *content.models) for note in row["notes"]]
    return [*lines, *(f"  note: {note}" for note in dict.fromkeys([*content.notes, *notes]))]


def _flight(row: dict[str, Any]) -> str:
    simulated = ", simulated" if row["simulated"] else ""
    line = f"{row['log']}: {row['kind']}{simulated}, {row['duration_s']:.2f} s"
    if row["error_rmse_m"] is None:
        return line
    rmse_mm, max_mm = 1e3 * row["error_rmse_m"], 1e3 * row["error_max_m"]
    return f"{line}, tracking error {rmse_mm:.1f} mm RMSE, {max_mm:.1f} mm at most"
