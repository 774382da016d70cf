"""JAX's derivative is phi's and its gradient ours; gradient differs is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from trimtab.firmware_model.law import step as law_step
from trimtab.host.apps.bench import peers
from trimtab.host.apps.paper.learning.flights import make_flights
from trimtab.host.apps.paper.learning.methods import WEIGHT, WORLD, exact_segments, phi_of
from trimtab.host.learn.adjoint import Gradient, Rollouts
from trimtab.host.models.drive import FF_GAIN
from trimtab.host.models.network import Layout
from trimtab.host.models.phi import Phi
from trimtab.host.models.segments import Segments
from trimtab.host.vehicle import load_vehicle

LAYOUT = Layout(hidden=(4, 4))
STATES = 400


@pytest.fixture(scope="module")
def batch() -> tuple[Phi, Segments, np.ndarray, Gradient]:
    """phi, three segments of six steps, weights and the gradient at them."""
    sets = make_flights(load_vehicle("research"), 1, counts={"train": 3})
    phi = phi_of(sets["train"], WORLD)
    found = exact_segments(phi, sets["train"]).take([0, 3, 5])
    segments = replace(found, measured=found.measured[:, :7], drive=found.drive[:, :13])
    xi = LAYOUT.initial(np.random.default_rng(0))
    rollouts = Rollouts(phi, LAYOUT, phi.theta_neutral, batch=3, step_s=segments.step_s, weight=WEIGHT)
    return phi, segments, xi, rollouts.gradient(segments, segments.x0, xi)


def drawn(phi: Phi, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States, drives and constants, half of them so wild that the law meets every limit it has."""
    wild = np.where(np.arange(STATES) % 2, 1.0, 0.05)[:, None]
    x = wild * rng.standard_normal((STATES, phi.size)) * ([1.0] * 6 + [0.4, 0.4, 2.0] + [3.0] * 3 + [0.0] * 7)
    x[:, 12:16] = rng.uniform(0.0, phi.vehicle.thrust_max_n, (STATES, 4))
    limit = np.array(law_step.integral_limit(phi.firmware))
    x[:, 16:19] = limit * np.where(
        rng.random((STATES, 3)) < 0.2,
        rng.choice([-1.0, 1.0], (STATES, 3)),
        rng.uniform(-1.2, 1.2, (STATES, 3)),
    )
    scale = [1.0] * 6 + [8.0] * 6 + [2.0, 1.0] + [1.0] * 6 + [0.1, 0.05, 5.0]
    drive = wild * rng.standard_normal((STATES, 23)) * scale
    drive[:, FF_GAIN] += 1.0
    constants = 0.1 * rng.standard_normal((STATES, 15))
    constants[:, 2:6] = 0.03 * rng.random((STATES, 4))
    return x, drive, constants


def test_derivative_at_states_of_every_kind_is_phis(
    require: Callable[[str], None], batch: tuple[Phi, Segments, np.ndarray, Gradient]
) -> None:
    require("diffrax")
    import jax  # pyright: ignore[reportMissingImports]  # only in the extra `bench`

    from trimtab.host.apps.bench.jax_loop import JaxLoop

    phi, _, xi, _ = batch
    x, drive, constants = drawn(phi, np.random.default_rng(1))
    push = LAYOUT.arrays(xi, x[:, 3:9].T)
    expected = np.array(phi.function(x.T, drive.T, constants.T, phi.theta_neutral, push)).T
    loop = JaxLoop(phi, LAYOUT)
    found = jax.jit(jax.vmap(loop.derivative, in_axes=(0, 0, 0, None)))(x, drive, constants, loop.weights(xi))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    # Not without the limits: rotors at both, the integral beyond its limit and not.
    lag = phi.vehicle.motor_lag_s + phi.hold_s
    command = x[:, 12:16] + lag * expected[:, 12:16]
    assert np.isclose(command, phi.vehicle.thrust_max_n).any(axis=1).sum() > STATES // 20
    assert (command < 1.01 * command.min()).any(axis=1).sum() > STATES // 20
    limit = np.array(law_step.integral_limit(phi.firmware))
    beyond = np.abs(x[:, 16:19]) > limit
    assert 10 < beyond.sum() < beyond.size / 2


def test_peers_have_our_gradient(
    require: Callable[[str], None], batch: tuple[Phi, Segments, np.ndarray, Gradient]
) -> None:
    require("diffrax")
    phi, segments, xi, ours = batch
    found = peers.measure(phi, LAYOUT, segments, xi, WEIGHT, ours, repeats=1)
    assert found is not None
    assert [row["name"].split(",")[0] for row in found] == ["JAX", "diffrax", "diffrax"]
    assert found[0]["differs"] < peers.SAME < found[1]["differs"] < peers.CLOSE
    assert all(set(row) == {"name", "gradient_ms", "build_s", "differs"} for row in found)
    assert all(row["gradient_ms"] > 0.0 for row in found)


def test_peer_with_another_gradient_is_refused(
    require: Callable[[str], None],
    batch: tuple[Phi, Segments, np.ndarray, Gradient],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    require("diffrax")
    import jax  # pyright: ignore[reportMissingImports]  # only in the extra `bench`

    from trimtab.host.apps.bench import jax_rollouts

    def euler(rate: Any, x0: Any, drive: Any, weights: Any, step_s: float) -> Any:
        def step(x: Any, row: Any) -> tuple[Any, Any]:
            x = x + step_s * rate(x, row, weights)
            return x, x

        return jax.lax.scan(step, x0, drive[:-1:2])[1]

    phi, segments, xi, ours = batch
    monkeypatch.setattr(jax_rollouts, "PEERS", {"Euler": (euler, True)})
    with pytest.raises(ValueError, match="Euler has gradient differs"):
        peers.measure(phi, LAYOUT, segments, xi, WEIGHT, ours, repeats=1)


@pytest.mark.parametrize(
    ("change", "layout"),
    [({"estimator": True}, LAYOUT), ({"drive": "estimate"}, LAYOUT), ({}, Layout(hidden=(4,), frame="body"))],
)
def test_phi_or_layout_that_jax_lacks_is_refused(
    require: Callable[[str], None], change: dict[str, Any], layout: Layout
) -> None:
    require("diffrax")
    from trimtab.host.apps.bench.jax_loop import JaxLoop

    phi = Phi(vehicle=load_vehicle("research"), **{"estimator": False, **change})
    with pytest.raises(ValueError, match="JAX has the drive `reference`"):
        JaxLoop(phi, layout)


def test_without_jax_nothing_is_measured(
    batch: tuple[Phi, Segments, np.ndarray, Gradient], monkeypatch: pytest.MonkeyPatch
) -> None:
    phi, segments, xi, ours = batch
    monkeypatch.setattr(peers.importlib.util, "find_spec", lambda name: None)
    assert peers.measure(phi, LAYOUT, segments, xi, WEIGHT, ours, repeats=1) is None
