"""What may be kept of what was learned: true roll-outs of whole flights decide, by nothing but their errors.

The losses that learning minimises see segments. A residual that stands in for something else, a torque say,
can lower all of them and foretell whole flights worse than nothing at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.learn.evaluate import Errors
from trimtab.host.models.network import Network
from trimtab.host.models.phi import Phi
from trimtab.host.models.slots import mocap_latency_s


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """phi at theta (P,), of which `forms` are learned effects; a network or none; delay_s: how much older
    poses are than stamped in the log alone.
    """

    phi: Phi
    theta: np.ndarray
    forms: tuple[str, ...] = ()
    network: Network | None = None
    delay_s: float = 0.0

    @property
    def what(self) -> str:
        """`nothing`, `effects`, `network` or `effects and network`: what of it was learned."""
        parts = ["effects"] * bool(self.forms) + ["network"] * (self.network is not None)
        return " and ".join(parts) or "nothing"

    @property
    def latency_s(self) -> float:
        """How much older the log's poses are than stamped."""
        return float(mocap_latency_s(FLOAT, self.phi.parts(self.theta))) + self.delay_s


@dataclass(frozen=True, kw_only=True)
class Trial:
    """What was learned of a candidate, and its errors on whole flights: those used, those held out if any."""

    what: str
    train: Errors
    test: Errors | None

    def to_json(self) -> dict[str, Any]:
        """Return what, and the errors."""
        return {
            "what": self.what,
            "train": self.train.to_json(),
            "test": None if self.test is None else self.test.to_json(),
        }


def best(trials: Sequence[Trial]) -> Trial:
    """Return the trial of least position error over that of the first, which has nothing learned.

    Of the ratios on flights used and on those held out the larger counts: one held out may be luck, and no
    loss has seen those used as a whole. Of equals it is the first, so give the simplest first.
    """
    return min(trials, key=lambda trial: _ratio(trial, trials[0]))


def note(trials: Sequence[Trial], kept: Trial) -> list[str]:
    """Return a line where the last trial, what was asked for, is not the best."""
    asked, better = trials[-1], best(trials)
    if better is asked:
        return []
    kept_too = ", kept as asked" if kept is asked else f": {better.what} kept"
    return [f"whole flights are predicted {_off(asked)}, {_off(better)}{kept_too}"]


def _ratio(trial: Trial, nothing: Trial) -> float:
    """Return the larger of the ratios of position errors; infinite where a roll-out of the trial diverged."""
    pairs = zip(_position_errors(trial), _position_errors(nothing), strict=True)
    return max(error / before if error < np.inf else np.inf for error, before in pairs)


def _position_errors(trial: Trial) -> list[float]:
    """On the flights used and on those held out, m; infinite where a roll-out diverged."""
    errors = [each.position_rmse_m for each in (trial.train, trial.test) if each is not None]
    return [error if np.isfinite(error) else np.inf for error in errors]


def _off(trial: Trial) -> str:
    """Return the position errors, in words."""
    told = "nothing learned" if trial.what == "nothing" else trial.what
    off = [f"{1e3 * each:.1f} mm" for each in _position_errors(trial)]
    return f"{' (used) and '.join(off)}{' (held out)' * (len(off) > 1)} off with {told}"
