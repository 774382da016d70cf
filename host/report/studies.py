"""The report module of each study, by the study's name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from trimtab.host.report import (
    attack,
    calibrate,
    controller_tuning,
    correction,
    labels,
    link,
    paper_controllers,
    paper_flight,
    paper_learning,
    paper_planning,
    real,
    study,
)
from trimtab.host.report.figures import Figure


class Reporter(Protocol):
    """A module that makes the report of a study."""

    @staticmethod
    def pictures(outcome: Mapping[str, Any]) -> dict[str, Figure]:
        """Return the pictures by file stem."""
        ...

    @staticmethod
    def page(
        outcome: Mapping[str, Any], drawn: Mapping[str, Figure], provenance: Mapping[str, object]
    ) -> str:
        """Return the HTML of the report."""
        ...


REPORTS: Mapping[str, Reporter] = {
    "attack": attack,
    "blind": study,
    "calibrate": calibrate,
    "controller-tuning": controller_tuning,
    "correction": correction,
    "labels": labels,
    "link": link,
    "paper-controllers": paper_controllers,
    "paper-flight": paper_flight,
    "paper-learning": paper_learning,
    "paper-planning": paper_planning,
    "real": real,
}
