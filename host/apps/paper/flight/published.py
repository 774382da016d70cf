"""The paper's numbers of section VI: tables I, II and III."""

from __future__ import annotations

from trimtab.host.apps.paper.flight.controllers import BASELINE, NEURAL_OBSERVER, OBSERVER
from trimtab.host.apps.paper.flight.pretzel import MIN_RESIDUAL, MIN_SNAP

STATISTICS = {
    "known": {"speed_m_s": (1.595, 0.854), "acceleration_m_s2": (2.478, 1.971), "jerk_m_s3": (4.726, 5.300)},
    "ood": {"speed_m_s": (2.721, 1.350), "acceleration_m_s2": (4.403, 2.437), "jerk_m_s3": (8.845, 5.732)},
}
"""Table I: mean and standard deviation along the references."""

NUMBERS = {"known": 16, "ood": 3}
"""Table I: number of trajectories."""

ERRORS = {
    "train": {"position_rmse_m": (0.101, 0.064), "velocity_rmse_m_s": (0.225, 0.137)},
    "test": {"position_rmse_m": (0.097, 0.067), "velocity_rmse_m_s": (0.192, 0.129)},
    "ood": {"position_rmse_m": (0.114, 0.093), "velocity_rmse_m_s": (0.244, 0.199)},
}
"""Table II: nominal and hybrid."""

PLANS = {
    "acceleration_max_m_s2": {MIN_SNAP: 9.392, MIN_RESIDUAL: 9.091},
    "jerk_max_m_s3": {MIN_SNAP: 22.684, MIN_RESIDUAL: 46.676},
    "acceleration_mean_m_s2": {MIN_SNAP: 4.338, MIN_RESIDUAL: 3.933},
    "jerk_mean_m_s3": {MIN_SNAP: 9.442, MIN_RESIDUAL: 9.673},
}
"""Table III: acceleration and jerk of the references, by kind."""

TRACKING_M = {
    BASELINE: {MIN_SNAP: 0.113, MIN_RESIDUAL: 0.098},
    OBSERVER: {MIN_SNAP: 0.111, MIN_RESIDUAL: 0.087},
    NEURAL_OBSERVER: {MIN_SNAP: 0.104, MIN_RESIDUAL: 0.084},
}
"""Table III: mean position error by controller and kind."""
