"""Plans: from a route to a checked reference. `plan` makes one, `write_plan` keeps it."""

from host.plan.dynamics import ResidualModel, Weights
from host.plan.files import write_plan
from host.plan.planner import plan
from host.plan.result import KINDS, Kind, Plan, PlanRefused, PlanUnsolved, Settings

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
