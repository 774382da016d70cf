"""L1-adaptive estimate of the acceleration that the prediction model lacks.

    v_hat' = f + sigma - a_s (v_hat - v),     sigma = -Phi^-1 exp(-a_s dt) (v_hat - v)
    Phi = (1 - exp(-a_s dt)) / a_s,           w' = bandwidth (exp(a_s dt) sigma - w)

f is the acceleration of the model, v the estimated velocity, sigma the piecewise-constant adaptation, w its
low-pass filter, which is what the controller uses. sigma settles at exp(-a_s dt) of a constant disturbance;
the filter's input corrects this, so that w settles at the disturbance itself. Sources: Hovakimyan and Cao,
"L1 Adaptive Control Theory", SIAM 2010, section 3.3; Wu et al., "L1-Quad: L1 Adaptive Augmentation of
Geometric Control for Agile Quadrotors"; Huang et al., "DATT", CoRL 2023.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np


@dataclass(frozen=True, kw_only=True, eq=False)
class Adaptation:
    """State of the estimate: predicted velocity v_hat (m/s), sigma and w (m/s^2), all NED.

    predictor_1_s: a_s, the decay of the predictor's error. bandwidth_1_s: of the filter.
    """

    predictor_1_s: float
    bandwidth_1_s: float
    v_hat: Annotated[np.ndarray, "3"]
    sigma: Annotated[np.ndarray, "3"]
    w_ned: Annotated[np.ndarray, "3"]

    @classmethod
    def at(cls, v_ned: Annotated[np.ndarray, "3"], predictor_1_s: float, bandwidth_1_s: float) -> Adaptation:
        """Return the state at a first velocity, without disturbance."""
        return cls(
            predictor_1_s=predictor_1_s,
            bandwidth_1_s=bandwidth_1_s,
            v_hat=np.array(v_ned, dtype=float),
            sigma=np.zeros(3),
            w_ned=np.zeros(3),
        )

    def after(
        self,
        dt_s: float,
        gained_ned: Annotated[np.ndarray, "3"],
        v_before: Annotated[np.ndarray, "3"],
        v_ned: Annotated[np.ndarray, "3"],
    ) -> Adaptation:
        """Return the state after `dt_s`, in which the velocity went from `v_before` to `v_ned`.

        gained_ned: change of the velocity (m/s, NED) that the model predicts without sigma.
        """
        a_s = self.predictor_1_s
        decay = math.exp(-a_s * dt_s)
        phi = (1.0 - decay) / a_s
        # Exact for a constant acceleration and a velocity that moves evenly between the two estimates.
        error = decay * (self.v_hat - v_before) + phi * (
            self.sigma + (gained_ned - (v_ned - v_before)) / dt_s
        )
        sigma = -decay / phi * error
        share = 1.0 - math.exp(-self.bandwidth_1_s * dt_s)
        return Adaptation(
            predictor_1_s=a_s,
            bandwidth_1_s=self.bandwidth_1_s,
            v_hat=v_ned + error,
            sigma=sigma,
            w_ned=self.w_ned + share * (sigma / decay - self.w_ned),
        )
