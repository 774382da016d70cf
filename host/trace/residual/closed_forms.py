"""Closed forms of a force field: towards a point, around a place, a jet, or along a direction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from scipy.optimize import least_squares

from trimtab.host.trace.sentences import closed_form

_ROW_STEP = 3
"""Step between the rows that are fitted, since neighbouring rows are strongly correlated."""

Law = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Specific force (rows, 3), m/s^2, NED, of the parameters of a form and of positions (rows, 3), m, NED."""


@dataclass(frozen=True, kw_only=True)
class ClosedForm:
    """A closed form of a force: name, parameters by key, and held-out skill."""

    name: str
    parameters: dict[str, float]
    skill: float

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object `form`."""
        return {
            "name": self.name,
            "parameters": {key: round(value, 4) for key, value in self.parameters.items()},
            "words": closed_form(self.name, self.parameters),
            "skill": round(self.skill, 4),
        }


def _to_point(theta: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return the force towards a point, proportional to the distance beyond a slack.

    theta: point (3), stiffness in 1/s^2, slack in m.
    """
    offset = theta[:3] - p
    distance = np.linalg.norm(offset, axis=1)
    beyond = np.maximum(distance - theta[4], 0.0)
    return (theta[3] * beyond / np.maximum(distance, 1e-6))[:, None] * offset


def _at_place(theta: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return a force of constant direction that is strongest at a place and Gaussian around it.

    theta: place (3), force (3) there, standard deviation in m.
    """
    distance = np.linalg.norm(p - theta[:3], axis=1)
    return np.exp(-0.5 * (distance / theta[6]) ** 2)[:, None] * theta[3:6]


def _along(theta: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return a force along a level direction that grows exponentially in that direction.

    theta: azimuth in rad, force at the origin in m/s^2, length in m over which it grows by a factor e.
    """
    n = np.array([np.cos(theta[0]), np.sin(theta[0]), 0.0])
    return (theta[1] * np.exp(np.clip(p @ n / theta[2], -30.0, 30.0)))[:, None] * n


def _jet(theta: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return a level force along an axis, Gaussian across the axis.

    theta: azimuth of the axis in rad, its offset to the right of the origin in m, force on the axis in m/s^2,
    standard deviation in m.
    """
    n = np.array([np.cos(theta[0]), np.sin(theta[0]), 0.0])
    right = np.array([-n[1], n[0], 0.0])
    return (theta[2] * np.exp(-0.5 * ((p @ right - theta[1]) / theta[3]) ** 2))[:, None] * n


def fit_forms(
    p: Annotated[np.ndarray, "rows 3"],
    force: Annotated[np.ndarray, "rows 3"],
    folds: Annotated[np.ndarray, "rows"],
    steady: Annotated[np.ndarray, "rows 3 regressors"],
) -> list[tuple[ClosedForm, Annotated[np.ndarray, "rows"]]]:
    """Fit every closed form; return each form with its held-out squared errors, (m/s^2)^2.

    The skill of the returned forms is NaN. Forms with the fewest parameters come first.

    Parameters
    ----------
    p
        Positions, m, NED.
    force
        Specific force at these positions, m/s^2, NED.
    folds
        Fold in which each row is held out.
    steady
        Columns of constant forces that are fitted to the residual of the form.
    """
    forms = []
    for name, law, starts, bounds, parameters in _laws(p, force):
        best = _fitted(law, p[::_ROW_STEP], force[::_ROW_STEP], starts, bounds)
        errors = np.empty(len(p))
        for fold in np.unique(folds):
            held_out = folds == fold
            train = np.flatnonzero(~held_out)[::_ROW_STEP]
            theta = _fitted(law, p[train], force[train], [best, starts[0]], bounds)
            residual = force - law(theta, p)
            constant, *_ = np.linalg.lstsq(
                steady[~held_out].reshape(-1, steady.shape[2]), residual[~held_out].reshape(-1), rcond=None
            )
            errors[held_out] = ((residual[held_out] - steady[held_out] @ constant) ** 2).sum(1)
        forms.append((ClosedForm(name=name, parameters=parameters(best), skill=np.nan), errors))
    return forms


def _fitted(
    law: Law, p: np.ndarray, force: np.ndarray, starts: list[np.ndarray], bounds: tuple[Any, Any]
) -> np.ndarray:
    """Return the parameters of the best least-squares fit from several starts."""
    fits = [
        least_squares(
            lambda theta: (law(theta, p) - force).reshape(-1),
            np.clip(start, *bounds),
            bounds=bounds,
            x_scale="jac",
            max_nfev=40,
        )
        for start in starts
    ]
    return min(fits, key=lambda fit: fit.cost).x


def _laws(p: np.ndarray, force: np.ndarray) -> list[tuple[str, Law, list[np.ndarray], Any, Any]]:
    """Return name, law, starts, bounds and a function that names the parameters, for each form."""
    low, high, middle = p.min(0) - 2.0, p.max(0) + 2.0, p.mean(0)
    size = float(np.ptp(p, axis=0).max())
    floor = np.array([middle[0], middle[1], p[:, 2].max() + 0.5])
    top = p[np.linalg.norm(force, axis=1).argsort()[-max(5, len(p) // 20) :]].mean(0)
    strong = float(np.quantile(np.linalg.norm(force, axis=1), 0.95))
    push = force[np.linalg.norm(force, axis=1) >= 0.7 * strong].mean(0)
    slope = strong / max(size, 0.1)
    point = [
        np.r_[c, k, slack] for c in (middle, floor) for k in (slope, -slope) for slack in (0.05, 0.3 * size)
    ]
    turns = np.linspace(0.0, 2.0 * np.pi, 6, endpoint=False)
    wide = max(2.0 * size, 1.0)

    def along_parameters(x: np.ndarray) -> dict[str, float]:
        n = np.array([np.cos(x[0]), np.sin(x[0]), 0.0])
        greatest = float(x[1] * np.exp((p @ n).max() / x[2]))
        return {"azimuth_deg": _azimuth_deg(x[0]), "length_m": float(x[2]), "greatest_m_s2": greatest}

    return [
        (
            "along",
            _along,
            [np.array([a, s * strong * 0.3, 0.4 * size + 0.1]) for a in turns for s in (1.0, -1.0)],
            (np.array([-0.1, -50.0, 0.1]), np.array([2.0 * np.pi + 0.1, 50.0, wide])),
            along_parameters,
        ),
        (
            "jet",
            _jet,
            [
                np.array([a, float(top @ [-np.sin(a), np.cos(a), 0.0]), strong, 0.15 * size + 0.1])
                for a in turns
            ],
            (np.array([-0.1, -20.0, 0.0, 0.1]), np.array([2.0 * np.pi + 0.1, 20.0, 50.0, wide])),
            _jet_parameters,
        ),
        ("point", _to_point, point, (np.r_[low, -50.0, 0.0], np.r_[high, 50.0, wide]), _point_parameters),
        (
            "place",
            _at_place,
            [np.r_[c, push, w] for c in (top, middle) for w in (0.2 * size + 0.1, 0.5 * size + 0.1)],
            (np.r_[low, -50.0, -50.0, -50.0, 0.1], np.r_[high, 50.0, 50.0, 50.0, wide]),
            _place_parameters,
        ),
    ]


def _azimuth_deg(azimuth: float) -> float:
    return float(np.rad2deg(azimuth) % 360.0)


def _point_parameters(x: np.ndarray) -> dict[str, float]:
    return dict(zip(("north_m", "east_m", "down_m", "per_s2", "slack_m"), map(float, x), strict=True))


def _place_parameters(x: np.ndarray) -> dict[str, float]:
    keys = ("north_m", "east_m", "down_m", "push_north", "push_east", "push_down", "width_m")
    return dict(zip(keys, map(float, x), strict=True))


def _jet_parameters(x: np.ndarray) -> dict[str, float]:
    azimuth = _azimuth_deg(x[0])
    keys = ("offset_m", "push_m_s2", "width_m")
    return {"azimuth_deg": azimuth, **dict(zip(keys, map(float, x[1:]), strict=True))}
