"""Candidates for a learned model, and the selection by the errors of true roll-outs of whole flights.

The losses of learning are those of segments. A residual that substitutes another cause, such as a torque, can
lower all of them and still predict whole flights worse than no residual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.learn.evaluate import Errors
from trimtab.host.models.network import Network
from trimtab.host.models.phi import Phi
from trimtab.host.models.slots import mocap_latency_s


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """phi at theta with a network or none.

    forms: the learned ones of its effects. delay_s: how much older poses are than stamped, in the log only.
    """

    phi: Phi
    theta: Annotated[np.ndarray, "parameters"]
    forms: tuple[str, ...] = ()
    network: Network | None = None
    delay_s: float = 0.0

    @property
    def what(self) -> str:
        """The learned part: `nothing`, `effects`, `network` or `effects and network`."""
        parts = ["effects"] * bool(self.forms) + ["network"] * (self.network is not None)
        return " and ".join(parts) or "nothing"

    @property
    def latency_s(self) -> float:
        """How much older the poses of the log are than stamped."""
        return float(mocap_latency_s(FLOAT, self.phi.parts(self.theta))) + self.delay_s


@dataclass(frozen=True, kw_only=True)
class Trial:
    """The learned part of a candidate, and its errors on the whole flights used and on those held out."""

    what: str
    train: Errors
    test: Errors | None

    def to_json(self) -> dict[str, Any]:
        """Return the learned part and the errors."""
        return {
            "what": self.what,
            "train": self.train.to_json(),
            "test": None if self.test is None else self.test.to_json(),
        }


def best(trials: Sequence[Trial]) -> Trial:
    """Return the trial with the least ratio of position error to that of the first, which learned nothing.

    The larger of the ratios on flights used and held out counts: a single held-out flight may be luck, and
    learning did not minimise the error of whole flights. Of equal trials the first wins, so put the simplest
    first.
    """
    return min(trials, key=lambda trial: _ratio(trial, trials[0]))


def note(trials: Sequence[Trial], selected: Trial) -> list[str]:
    """Return a note where the last trial, with everything asked for, is not the best."""
    asked, better = trials[-1], best(trials)
    if better is asked:
        return []
    outcome = ", kept as asked" if selected is asked else f": {better.what} kept"
    return [f"whole flights are predicted {_describe_errors(asked)}, {_describe_errors(better)}{outcome}"]


def _ratio(trial: Trial, nothing: Trial) -> float:
    """Return the larger of the ratios of position errors; infinite where a roll-out of the trial diverged."""
    pairs = zip(_position_errors(trial), _position_errors(nothing), strict=True)
    return max(error / before if error < np.inf else np.inf for error, before in pairs)


def _position_errors(trial: Trial) -> list[float]:
    """Return the errors on the flights used and held out, m; infinite where a roll-out diverged."""
    errors = [each.position_rmse_m for each in (trial.train, trial.test) if each is not None]
    return [error if np.isfinite(error) else np.inf for error in errors]


def _describe_errors(trial: Trial) -> str:
    """Return the position errors as text."""
    what = "nothing learned" if trial.what == "nothing" else trial.what
    errors = [f"{1e3 * each:.1f} mm" for each in _position_errors(trial)]
    return f"{' (used) and '.join(errors)}{' (held out)' * (len(errors) > 1)} off with {what}"
