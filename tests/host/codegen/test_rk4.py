"""RK4 in C against the closed form, its error against the order, and what happens without a compiler."""

from __future__ import annotations

import casadi as ca
import numpy as np

from trimtab.host.codegen.rk4 import runge_kutta


def driven() -> ca.Function:
    """x'' = u - k x, as a slope function."""
    x, u, k = ca.SX.sym("x", 2), ca.SX.sym("u", 1), ca.SX.sym("k", 1)
    return ca.Function("driven", [x, u, k], [ca.vertcat(x[1], u - k * x[0])])


def test_runge_kutta_follows_each_lane_its_own_drive_and_constants(require) -> None:
    require("compiler")
    integrate = runge_kutta(driven())
    assert integrate is not None
    errors = []
    for steps in (20, 40):
        step_s = 1.0 / steps
        stages = 0.5 * step_s * np.arange(2 * steps + 1)
        drive = np.stack([np.zeros_like(stages), np.ones_like(stages)])[:, :, None]
        k = np.array([[1.0], [4.0], [4.0]])
        x0 = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 0.0]])
        every = steps // 4
        found = integrate(x0, drive, np.array([0, 0, 1]), [k], step_s=step_s, every=every, rows=1)
        t = np.linspace(0.0, 1.0, 5)
        exact = np.stack([np.cos(t), np.cos(2.0 * t), 0.25 * (1.0 - np.cos(2.0 * t))])
        errors.append(np.abs(found[:, :, 0] - exact).max())
    assert errors[0] < 2e-5
    assert 12.0 < errors[0] / errors[1] < 20.0


def test_runge_kutta_without_a_compiler_is_none(monkeypatch) -> None:
    monkeypatch.setenv("TRIMTAB_ENGINE", "vm")
    assert runge_kutta(driven()) is None
