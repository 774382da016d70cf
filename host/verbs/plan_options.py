"""Options of `trimtab plan`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from trimtab.host.verbs.options import (
    AcceptUndecided,
    Force,
    Json,
    Output,
    Trust,
    VehicleName,
    WorkspaceFolder,
)
from trimtab.host.workspace import DEFAULT_VEHICLE


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """Options of `trimtab plan`.

    Attributes
    ----------
    model
        Model of the residual of the nominal vehicle, a .model.toml file.
    kind
        min-snap, min-control or min-residual. A star behind the latter two (min-residual*) makes the model
        part of the dynamics. min-control-r plans min-control, then tracks its path with the model in the
        dynamics. min-error minimises the tracking error that the model predicts for the law without
        feed-forward and observer. Default: min-residual if the model predicts a residual, else min-snap.
    nodes
        Approximate number of shooting intervals, 20 to 1600. Default: one every 70 ms.
    time_s
        Total time instead of the route's, at most 500 s.
    time_box
        Least and greatest total time as shares of the route's, such as 0.8 1.3. The plan chooses between
        them.
    time_weight
        Cost of a second if the total time is free, in units of the squared residual. Default: 1.
    stretch
        Give a min-snap plan that breaks a limit more time.
    headroom
        Least and greatest share of a rotor's thrust that the plan may use, within the vehicle's own limits.
    clearance
        Distance in metres that the path keeps from keep-out shapes and from the edges of gates. Default: the
        tracking error that the model predicts, plus 0.1 m for what it does not, or less where the route
        leaves no room.
    report
        HTML page to write: the path with gates and keep-out shapes, and the residual, its sensitivity and the
        distance to the limits at each node.
    pareto
        Compare plans instead of writing a reference: min-snap, min-control, and min-residual with the weights
        of thrusts and thrust rates scaled by 0.1 to 10. Needs --model. --report writes the comparison.
    world
        World in which a simulated vehicle flies every plan of --pareto, by name or path.
    world_seed
        Seed of that world. Logs do not contain it.
    output
        Reference to write. Default: NAME.ref, with the route's name. With --world, the folder for all
        references and logs. Default: NAME-pareto.
    """

    vehicle: VehicleName = DEFAULT_VEHICLE
    model: Path | None = None
    accept_undecided: AcceptUndecided = False
    kind: str | None = None
    nodes: int | None = None
    time_s: float | None = None
    time_box: tuple[float, float] | None = None
    time_weight: float | None = None
    stretch: Annotated[bool, Parameter(negative="")] = False
    headroom: tuple[float, float] | None = None
    clearance: float | None = None
    report: Path | None = None
    pareto: Annotated[bool, Parameter(negative="")] = False
    world: str | None = None
    world_seed: int = 0
    output: Output = None
    force: Force = False
    json: Json = False
    workspace: WorkspaceFolder = None
    trust: Trust = False
