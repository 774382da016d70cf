"""Plans: from a route to a checked reference. `plan` makes one, `write_plan` keeps it."""

from trimtab.host.plan.dynamics import Weights
from trimtab.host.plan.files import write_plan
from trimtab.host.plan.planner import plan
from trimtab.host.plan.residual import ResidualModel
from trimtab.host.plan.result import KINDS, Kind, Plan, PlanRefused, PlanUnsolved, Settings

__all__ = [
    "KINDS",
    "Kind",
    "Plan",
    "PlanRefused",
    "PlanUnsolved",
    "ResidualModel",
    "Settings",
    "Weights",
    "plan",
    "write_plan",
]
