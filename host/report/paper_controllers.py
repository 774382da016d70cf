"""Report of the study of controllers and trajectories: claims, tables, and box plots of every flight."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trimtab.host.apps.paper.controllers.statistics import FAILED_M
from trimtab.host.apps.paper.controllers.table import SETS, TRAJECTORIES, Set
from trimtab.host.report import flight_figures
from trimtab.host.report.figures import Figure
from trimtab.host.report.tables import tables_page


def pictures(outcome: Mapping[str, Any]) -> dict[str, Figure]:
    """Return the box plot of each set by file stem."""
    drawn = {}
    for flown in SETS:
        errors = _errors_mm(outcome["cells"], flown)
        if any(values for each in errors.values() for values in each.values()):
            drawn[f"{flown.family}-{flown.regressor}"] = flight_figures.boxes(
                errors,
                f"{flown.title}: mean error of each flight of the balanced design that was flown to its end, "
                "by trajectory and controller. Boxes hold half of the points, whiskers nine tenths.",
            )
    return drawn


def page(outcome: Mapping[str, Any], drawn: Mapping[str, Figure], provenance: Mapping[str, object]) -> str:
    """Return the HTML of the study's report, one file that opens offline."""
    return tables_page("The paper's controllers section", outcome, drawn, provenance)


def _errors_mm(cells: Any, flown: Set) -> dict[str, dict[str, list[float]]]:
    """Return the errors of the flights of a set, mm, by trajectory and controller, without failed ones."""
    return {
        kind: {
            controller.title: [
                1e3 * error
                for cell in cells
                if cell.flown == flown and (error := cell.errors_m[controller.name, kind]) < FAILED_M
            ]
            for controller in flown.controllers
        }
        for kind in TRAJECTORIES
    }
