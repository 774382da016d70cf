"""Files that a demo writes to its folder, and their provenance."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trimtab.host.apps.demo.plans import Planned
from trimtab.host.base import artefacts
from trimtab.host.models.model import Model
from trimtab.host.plan import write_plan
from trimtab.host.vehicle import Vehicle

MODEL_NAME = "demo.model.toml"
REPORT_NAME = "demo.html"
JSON_NAME = "demo.json"
TRUTH_PAGE = "truth.html"
"""The one artefact with the sealed truth; written after JSON_NAME."""
FEEDFORWARD_NAME = "applied.ff"


@dataclass(frozen=True, kw_only=True)
class DemoFiles:
    """The folder of a demo. seed: the host's; force: overwrite files that exist."""

    folder: Path
    vehicle: Vehicle
    seed: int
    force: bool

    def log(self, number: int, planned: Planned) -> Path:
        """Return the path of a flight's log. Raises UsageError if the file exists and `force` is off."""
        return artefacts.check_output(self.folder / f"{number:02d}-{planned.name}.mcap", self.force)

    def write_plan(self, planned: Planned, model: Model | None = None) -> None:
        """Write a plan's reference. model: the one that it was planned with, beyond the nominal vehicle."""
        parents = {"vehicle": self.vehicle.id, "route": planned.route.id}
        if model is not None:
            parents["model"] = model.id
        file = self.folder / f"{planned.name}.ref"
        write_plan(planned.plan, file, provenance=self.provenance(parents), force=self.force)

    def write(self, name: str, content: str | bytes) -> None:
        """Write a complete file or nothing."""
        artefacts.write_atomic(self.folder / name, content, self.force)

    def provenance(self, parents: dict[str, str] | None = None) -> dict[str, Any]:
        """Return the provenance of an artefact. Its command leaves out world, seed and folder."""
        argv = ["demo", "--vehicle", self.vehicle.name]
        return artefacts.provenance(seed=self.seed, parents=parents or {}, argv=argv)

    def session(self) -> dict[str, str]:
        """Return what the logs contain about the session."""
        words = ["demo", "--vehicle", self.vehicle.name]
        return {**artefacts.log_provenance(words), "seed": str(self.seed)}
