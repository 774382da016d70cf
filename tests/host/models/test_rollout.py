"""Roll-outs in C and without a compiler."""

from __future__ import annotations

import numpy as np
import pytest

from trimtab.host.effects import load_effects
from trimtab.host.models.drive import DRIVE_ROWS, FF_GAIN, VOLTAGE_AND_TIME, flight_constants
from trimtab.host.models.phi import Phi
from trimtab.host.models.rollout import roll_out
from trimtab.host.vehicle import load_vehicle


@pytest.mark.parametrize("every", [1, 2])
def test_roll_out_compiled_or_not_has_the_same_bits(monkeypatch, require, every) -> None:
    require("compiler")
    effects = load_effects()
    chosen = (effects["quadratic-drag"], effects["motor-lag"])
    phi, other = (Phi(vehicle=load_vehicle("research"), effects=chosen) for _ in range(2))
    rng = np.random.default_rng(3)
    flights, lanes, steps = 2, 5, 40
    drive = np.zeros((2 * steps + 1, DRIVE_ROWS["reference"], flights))
    drive[:, 0] = 0.2 * np.sin(np.linspace(0.0, 3.0, 2 * steps + 1))[:, None] * [1.0, -0.5]
    drive[:, 2], drive[:, FF_GAIN], drive[:, VOLTAGE_AND_TIME.start] = -1.0, 1.0, 1.0
    x0 = phi.hover((0.0, 0.0, -1.0), 0.3)[:, None] + 1e-3 * rng.standard_normal((phi.size, lanes))
    given = {
        "x0": x0,
        "drive": drive,
        "flight": np.stack([flight_constants(mocap_age_s=age) for age in (0.004, 0.006)], axis=1),
        "theta": phi.theta_neutral[:, None] + 0.01 * rng.random((len(phi.theta_neutral), lanes)),
        "step_s": 0.005,
        "every": every,
        "lane_flight": np.array([0, 1, 1, 0, 1]),
    }
    compiled = roll_out(phi, **given, compiled=True)
    monkeypatch.setenv("TRIMTAB_ENGINE", "vm")
    interpreted = roll_out(other, **given, compiled=True)
    assert compiled.shape == (steps // every + 1, 12, lanes)
    assert np.ptp(compiled[-1, 0]) > 0.01
    assert compiled.tobytes() == interpreted.tobytes()
