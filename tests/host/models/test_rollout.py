"""Roll-outs in C and without a compiler."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from trimtab.host.effects import load_effects
from trimtab.host.models.drive import DRIVE_ROWS, FF_GAIN, VOLTAGE_AND_TIME, flight_constants
from trimtab.host.models.network import Layout, Network
from trimtab.host.models.phi import Phi
from trimtab.host.models.rollout import roll_out
from trimtab.host.vehicle import load_vehicle


@pytest.mark.parametrize("network", [None, (8, 5)])
@pytest.mark.parametrize("every", [1, 2])
def test_roll_out_compiled_or_not_agrees(require, every, network) -> None:
    require("compiler")
    effects = load_effects()
    chosen = (effects["quadratic-drag"], effects["motor-lag"])
    phi = Phi(vehicle=load_vehicle("research"), effects=chosen)
    rng = np.random.default_rng(3)
    flights, lanes, steps = 2, 11, 40
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
        "lane_flight": np.arange(lanes) % 3 % 2,
        "rows": 16,
        "push": None,
    }
    if network is not None:
        layout = Layout(hidden=network)
        given["network"] = Network(layout=layout, xi=layout.initial(rng) + 0.05)
        given["push"] = 0.1 * rng.standard_normal((2 * steps + 1, 3, lanes))
    compiled = roll_out(phi, **given, compiled=True)
    interpreted = roll_out(phi, **given)
    assert compiled.shape == (steps // every + 1, 16, lanes)
    assert np.ptp(compiled[-1, 0]) > 0.01
    np.testing.assert_allclose(compiled, interpreted, rtol=1e-11, atol=1e-12)


def test_roll_out_compiled_has_the_same_bits_for_any_number_of_lanes(compiler_of_width, monkeypatch) -> None:
    phi = Phi(vehicle=load_vehicle("research"))
    drive = np.zeros((41, DRIVE_ROWS["reference"]))
    drive[:, 2], drive[:, FF_GAIN], drive[:, VOLTAGE_AND_TIME.start] = -1.0, 1.0, 1.0
    x0 = phi.hover((0.0, 0.0, -1.0), 0.3)[:, None] + 1e-2 * np.arange(9)
    roll = partial(
        roll_out, phi, drive=drive, flight=flight_constants(), theta=np.zeros(0), step_s=0.005, compiled=True
    )
    together = roll(x0=x0)
    for width in (2, 4, 8):
        monkeypatch.setattr(
            "trimtab.host.codegen.compiler.find_compiler", lambda width=width: compiler_of_width(width)
        )
        assert together.tobytes() == roll(x0=x0).tobytes()
        assert together[:, :, 8].tobytes() == roll(x0=x0[:, 8:]).tobytes()
