"""Controllers, trajectories and regressors of the study."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

Family = Literal["dfbc", "mpc"]
Regressor = Literal["paper", "ours"]
Use = Literal["residual", "closed-form", "labels"]
"""Model that a controller uses: the regressor's, the closed form alone, or one learned from labels."""

FAMILIES: Mapping[Family, str] = {"dfbc": "DFBC", "mpc": "MPC"}
REGRESSORS: Mapping[Regressor, str] = {"paper": "the paper's regressor", "ours": "our regressor"}
"""Families and regressors with their titles."""
CLOSED_FORM = "closed-form"
MIN_SNAP, MIN_RESIDUAL, MIN_RESIDUAL_STAR = "min-snap", "min-residual", "min-residual*"
MIN_ERROR = "min-error"
TRAJECTORIES = (MIN_SNAP, "min-control", "min-control-r", MIN_RESIDUAL, MIN_RESIDUAL_STAR)
"""The paper's."""
BASELINE_TRAJECTORIES = (MIN_SNAP, MIN_RESIDUAL, MIN_RESIDUAL_STAR, MIN_ERROR)
"""Flown by the baseline on every course. min-error is not the paper's: it is for the baseline's gains."""


@dataclass(frozen=True, kw_only=True)
class Controller:
    """A controller of the comparison.

    file: name of its settings. use: the model that it uses, None for none. regressors: those it flies with.
    """

    name: str
    title: str
    family: Family
    file: str
    use: Use | None = None
    regressors: tuple[Regressor, ...] = tuple(REGRESSORS)

    def model(self, regressor: Regressor) -> str | None:
        """Return the name of its model among a site's models, None if it uses none."""
        if self.use == "labels":
            return labels(regressor)
        return regressor if self.use == "residual" else self.use


CONTROLLERS = (
    Controller(name="dfbc", title="Nomi", family="dfbc", file="dfbc"),
    Controller(name="dfbc-do", title="DO", family="dfbc", file="dfbc-do"),
    Controller(name="dfbc-neural", title="Neural", family="dfbc", file="dfbc-neural", use="residual"),
    Controller(
        name="dfbc-neural-do", title="Neural DO", family="dfbc", file="dfbc-neural-do", use="residual"
    ),
    Controller(
        name="dfbc-traced",
        title="Traced",
        family="dfbc",
        file="dfbc-neural",
        use="closed-form",
        regressors=("ours",),
    ),
    Controller(
        name="dfbc-traced-do",
        title="Traced DO",
        family="dfbc",
        file="dfbc-neural-do",
        use="closed-form",
        regressors=("ours",),
    ),
    Controller(name="mpc", title="Nomi", family="mpc", file="mpc"),
    Controller(name="mpc-l1", title="L1adapt", family="mpc", file="mpc-l1"),
    Controller(name="mpc-neural", title="Neural", family="mpc", file="mpc-neural", use="residual"),
    Controller(name="mpc-neural-c", title="Neural-C", family="mpc", file="mpc-neural-c", use="labels"),
    Controller(
        name="mpc-traced",
        title="Traced",
        family="mpc",
        file="mpc-neural",
        use="closed-form",
        regressors=("ours",),
    ),
)
"""Those of section V-B, Neural DO of section VI-D, and with the closed form in place of the network."""
BASELINE, FEEDFORWARD = CONTROLLERS[0], CONTROLLERS[2]


@dataclass(frozen=True, kw_only=True)
class Set:
    """All controllers of a family with one regressor. They fly together on every trajectory."""

    family: Family
    regressor: Regressor

    @property
    def title(self) -> str:
        """The set in words."""
        return f"{FAMILIES[self.family]} with {REGRESSORS[self.regressor]}"

    @property
    def controllers(self) -> tuple[Controller, ...]:
        """The controllers of the set."""
        return tuple(
            each for each in CONTROLLERS if each.family == self.family and self.regressor in each.regressors
        )


SETS = tuple(Set(family=family, regressor=regressor) for regressor in REGRESSORS for family in FAMILIES)


def labels(regressor: Regressor) -> str:
    """Return the name of the model learned from labels."""
    return f"{regressor}-labels"
