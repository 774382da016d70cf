"""Report of the study of section VI: the paper's tables beside ours, and figures of flights."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trimtab.host.apps.paper.flight.controllers import TABLE_III
from trimtab.host.apps.paper.flight.pretzel import KINDS
from trimtab.host.apps.paper.flight.tables import CONTROLLERS, METHODS, SETS, TRANSFER
from trimtab.host.report import flight_figures, learning_figures
from trimtab.host.report.figures import Figure
from trimtab.host.report.tables import tables_page


def pictures(outcome: Mapping[str, Any]) -> dict[str, Figure]:
    """Return the study's pictures by file stem."""
    answer, worlds = outcome["answer"], outcome["worlds"]
    drawn = {
        "prediction": learning_figures.over_nominal(
            {SETS[name]: _ratios(found["flights"]) for name, found in answer["prediction"].items()},
            METHODS,
            "Whole flights predicted from their references: position error over that of the nominal model. "
            "One point for each world; bars are medians.",
        ),
    }
    for horizon, title in TRANSFER.items():
        drawn[f"controllers-{horizon}"] = learning_figures.over_nominal(
            {
                CONTROLLERS[law]: _ratios(of[horizon])
                for law, of in answer["controllers"].items()
                if horizon in of
            },
            METHODS,
            "Remark 1: models learned from flights of the baseline predict flights of other controllers, "
            f"{title}. Position error over that of the nominal model; one point for each world; bars are "
            "medians.",
        )
    errors = {CONTROLLERS[law]: {kind: _errors_mm(worlds, kind, law) for kind in KINDS} for law in TABLE_III}
    if any(values for each in errors.values() for values in each.values()):
        drawn["pretzel-errors"] = flight_figures.boxes(
            errors,
            "Position errors of the pretzel, by controller and plan: a pose each tenth of a second of every "
            "flight. Boxes hold half of the points, whiskers nine tenths; every point is drawn.",
        )
    planned = worlds[0]["pretzel"]["plans"]
    if planned:
        drawn["pretzel"] = flight_figures.flown_paths(
            {kind: planned[kind]["path_ned_m"] for kind in KINDS},
            {kind: _flown(worlds[0], kind) for kind in KINDS},
            "The pretzel from above and from the side, planned and flown by the baseline in the first world.",
        )
    return drawn


def page(outcome: Mapping[str, Any], drawn: Mapping[str, Figure], provenance: Mapping[str, object]) -> str:
    """Return the HTML of the study's report, one file that opens offline."""
    return tables_page("The paper's flight section", outcome, drawn, provenance)


def _ratios(found: Mapping[str, Any]) -> dict[str, list[float | None]]:
    return {method: found["ratios"][method]["position_rmse_m"]["values"] for method in METHODS}


def _errors_mm(worlds: Any, kind: str, law: str) -> list[float]:
    """Return the kept position errors of all flights of a plan by a controller, mm."""
    return [
        1e3 * error
        for w in worlds
        for f in w["pretzel"]["flights"]
        if (f["kind"], f["controller"]) == (kind, law) and "failed" not in f
        for error in f["errors_m"]
    ]


def _flown(world: Mapping[str, Any], kind: str) -> list[list[float]] | None:
    """Return the path of the first flight of a plan by the baseline, m NED; None if it failed."""
    for f in world["pretzel"]["flights"]:
        if (f["kind"], f["controller"]) == (kind, TABLE_III[0]):
            return f.get("path_ned_m")
    return None
