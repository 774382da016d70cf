"""Evidence, posterior and disturbances against dense linear algebra."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from trimtab.host.trace import evidence
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.evidence import Prior
from trimtab.host.trace.linearisation import DisturbanceVariances, Linearisation

BINS, P, K, ROWS = 2, 3, 2, 40
PROCESS = DisturbanceVariances(log_lateral=np.log(0.5), log_axial=np.log(0.2), log_torque=np.log(2.0))
FREE = (np.full(3, -np.inf), np.full(3, np.inf))
PRIOR = Prior(
    groups={"a": (0, 1), "b": (2,)}, spike=np.array([0.1, 0.2, 0.05]), nuisance_sigma=np.array([0.5, 1.5])
)


@dataclass
class Dense:
    """Segments as full matrices: r (S, n), S (S, n, P), L (S, n, K), Z (S, n, 6 bins)."""

    r: np.ndarray
    S: np.ndarray
    L: np.ndarray
    Z: np.ndarray
    flight: np.ndarray
    lin: Linearisation


def _linearisation(
    gram: np.ndarray, flight: np.ndarray, theta_scaled: np.ndarray, nuisances: np.ndarray
) -> Linearisation:
    """Reduce Grams (S, n, n) of [r | S | L | Z], one flight after the other."""
    lin = Linearisation.blank(
        BINS,
        piece=flight,
        piece_flight=np.arange(len(nuisances)),
        theta_scaled=theta_scaled,
        nuisances=nuisances,
    )
    for each in np.unique(flight):
        lin.add(lin.reduce(np.flatnonzero(flight == each), gram[flight == each]))
    return lin


@pytest.fixture(scope="module")
def dense() -> Dense:
    rng = np.random.default_rng(5)
    count = 4
    r = rng.normal(size=(count, ROWS))
    S, L = rng.normal(size=(count, ROWS, P)), rng.normal(size=(count, ROWS, K))
    Z = 0.3 * rng.normal(size=(count, ROWS, 6 * BINS))
    A = np.concatenate([r[:, :, None], S, L, Z], axis=2)
    flight = np.array([0, 0, 1, 1])
    theta_scaled, nuisances = np.array([0.3, -0.2, 0.1]), rng.normal(size=(2, K))
    gram = np.swapaxes(A, 1, 2) @ A
    return Dense(
        r,
        S,
        L,
        Z,
        flight,
        _linearisation(gram, flight, theta_scaled, nuisances),
    )


def stacked(d: Dense) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """All rows at once: r, [S | L of each flight], covariance of the noise, its prior mean offset."""
    q = PROCESS.covariance(BINS)
    n = len(d.r) * ROWS
    covariance = np.zeros((n, n))
    J = np.zeros((n, P + 2 * K))
    for i, f in enumerate(d.flight):
        rows = slice(i * ROWS, (i + 1) * ROWS)
        covariance[rows, rows] = np.eye(ROWS) + d.Z[i] @ q @ d.Z[i].T
        J[rows, :P] = d.S[i]
        J[rows, P + K * f : P + K * (f + 1)] = d.L[i]
    at = np.concatenate([d.lin.theta_scaled, d.lin.nuisances.ravel()])
    return d.r.ravel(), J, covariance, at


@pytest.mark.parametrize("chosen", [(), ("a",), ("a", "b")])
def test_log_evidence_of_a_set_is_the_gaussian_marginal_likelihood_up_to_a_constant(
    dense: Dense, chosen: tuple[str, ...]
) -> None:
    r, J, covariance, at = stacked(dense)
    precision = PRIOR.precision(chosen)
    spread = np.concatenate([1.0 / precision, np.tile(PRIOR.nuisance_sigma**2, 2)])
    # y = J (theta - at) + noise + r's zero point: marginally N(-J at, C + J V J').
    total = covariance + (J * spread) @ J.T
    error = r + J @ at
    expected = -0.5 * (error @ np.linalg.solve(total, error) + np.linalg.slogdet(total)[1])
    expected += RULES.prior_log_odds * len(chosen)
    white = evidence.marginal_grams(dense.lin, PROCESS, PRIOR)
    _, value = evidence.log_evidences(
        white.gram, white.log_det, dense.lin.theta_scaled, PRIOR, [("b",), chosen], FREE
    )
    assert value == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("name", ["a", "b"])
def test_log_evidence_averages_the_marginal_likelihoods_over_the_orders_of_magnitude(
    dense: Dense, name: str
) -> None:
    r, J, covariance, at = stacked(dense)
    prior, columns = replace(PRIOR, strengths=PRIOR.groups), list(PRIOR.groups[name])
    values = []
    for width in RULES.slab_sigma * 0.5 ** np.arange(RULES.slab_halvings + 1):
        variance = 1.0 / PRIOR.precision((name,))
        variance[columns] = width**2
        total = covariance + (J * np.concatenate([variance, np.tile(PRIOR.nuisance_sigma**2, 2)])) @ J.T
        error = r + J @ at
        values.append(-0.5 * (error @ np.linalg.solve(total, error) + np.linalg.slogdet(total)[1]))
    expected = np.logaddexp.reduce(values) - np.log(len(values)) + RULES.prior_log_odds
    white = evidence.marginal_grams(dense.lin, PROCESS, PRIOR)
    gram, log_det, theta_scaled = white.gram, white.log_det, dense.lin.theta_scaled
    value, other = evidence.log_evidences(gram, log_det, theta_scaled, prior, [(name,), ()], FREE)
    assert value == pytest.approx(expected, abs=1e-7)
    assert [other] == evidence.log_evidences(gram, log_det, theta_scaled, PRIOR, [()], FREE)


@pytest.mark.parametrize("factor", [0.5, 4.0])
def test_variance_factor_scales_the_noise_of_the_sensors_alone(dense: Dense, factor: float) -> None:
    r, J, covariance, _ = stacked(dense)
    disturbance = covariance - np.eye(len(r))
    lin = replace(dense.lin, freedom=len(r)).with_variance_factor(factor)
    white = evidence.marginal_grams(lin, PROCESS, PRIOR)
    total = factor * np.eye(len(r)) + disturbance
    total += J[:, P:] @ np.diag(np.tile(PRIOR.nuisance_sigma**2, 2)) @ J[:, P:].T
    expected = np.linalg.slogdet(total)[1]
    assert white.log_det == pytest.approx(expected, abs=1e-7)
    np.testing.assert_allclose(
        white.gram[1:, 1:], J[:, :P].T @ np.linalg.solve(total, J[:, :P]), rtol=1e-7, atol=1e-9
    )
    again = lin.with_variance_factor(1.0)
    np.testing.assert_allclose(again.own, dense.lin.own, rtol=1e-12)


@pytest.mark.parametrize(
    ("ratio", "expected"), [(0.5, 1.0), (1.0, 1.0), (RULES.usual_variance_factor, 1.0), (6.0, 4.0)]
)
def test_variance_factor_is_the_excess_over_the_usual(dense: Dense, ratio: float, expected: float) -> None:
    lin = replace(dense.lin, freedom=100)
    gram = np.zeros((1 + P, 1 + P))
    gram[0, 0] = 100.0 * ratio + 9.0
    gram[1, 1], gram[0, 1], gram[1, 0] = 1.0, 3.0, 3.0  # a step of 3 explains 9
    white = replace(evidence.marginal_grams(lin, PROCESS, PRIOR), gram=gram)
    step = np.array([3.0, 0.0, 0.0])
    assert evidence.variance_factor(lin, white, step) == pytest.approx(expected)
    doubled = lin.with_variance_factor(2.0)
    assert evidence.variance_factor(doubled, white, step) == pytest.approx(
        max(1.0, 2.0 * ratio / RULES.usual_variance_factor)
    )


@pytest.mark.parametrize("freedom", [10, 10_000])
def test_noise_and_process_are_fitted_together(dense: Dense, freedom: int) -> None:
    """With little freedom the residual is too large for the stated noise, with much it is not."""
    stated = replace(dense.lin, freedom=freedom)
    still = np.zeros(P)
    lin, process, white = evidence.fit_noise(stated, PRIOR, ("a",), PROCESS, lambda _: still)
    first = evidence.fit_process(stated, PRIOR, ("a",), PROCESS)
    factor = evidence.variance_factor(stated, evidence.marginal_grams(stated, first, PRIOR), still)
    assert lin.variance_factor == factor
    assert (factor > 1.0) == (freedom == 10)
    if factor == 1.0:
        assert lin is stated
    assert process == (evidence.fit_process(lin, PRIOR, ("a",), first) if factor > 1.0 else first)
    np.testing.assert_array_equal(white.gram, evidence.marginal_grams(lin, process, PRIOR).gram)


def test_posterior_and_local_step_are_the_joint_ridge_solution(dense: Dense) -> None:
    r, J, covariance, at = stacked(dense)
    precision = PRIOR.precision(("a",))
    ridge = np.concatenate([precision, np.tile(1.0 / PRIOR.nuisance_sigma**2, 2)])
    inner = J.T @ np.linalg.solve(covariance, J) + np.diag(ridge)
    expected = np.linalg.solve(inner, J.T @ np.linalg.solve(covariance, r) - ridge * at)
    white = evidence.marginal_grams(dense.lin, PROCESS, PRIOR)
    step, spread = evidence.posterior(white.gram, dense.lin.theta_scaled, precision)
    nuisances = evidence.nuisance_step(dense.lin, white, PRIOR, step)
    np.testing.assert_allclose(step, expected[:P], atol=1e-9)
    np.testing.assert_allclose(nuisances.ravel(), expected[P:], atol=1e-9)
    np.testing.assert_allclose(spread, np.linalg.inv(inner)[:P, :P], atol=1e-10)


def test_disturbances_are_the_best_linear_prediction(dense: Dense) -> None:
    q = PROCESS.covariance(BINS)
    step, nuisances = np.array([0.1, -0.3, 0.2]), np.array([[0.2, -0.1], [0.0, 0.4]])
    estimate = evidence.disturbances(dense.lin, PROCESS, step, nuisances)
    for i, f in enumerate(dense.flight):
        rest = dense.r[i] - dense.S[i] @ step - dense.L[i] @ nuisances[f]
        total = np.eye(ROWS) + dense.Z[i] @ q @ dense.Z[i].T
        expected = q @ dense.Z[i].T @ np.linalg.solve(total, rest)
        np.testing.assert_allclose(estimate[i].ravel(), expected, atol=1e-9)


def test_process_covariance_is_positive_definite_and_keeps_axes_apart() -> None:
    q = PROCESS.covariance(3)
    assert np.linalg.eigvalsh(q).min() > 0
    assert q[0, 0] == pytest.approx(0.5)
    assert q[2, 2] == pytest.approx(0.2)
    assert q[5, 5] == pytest.approx(2.0)
    assert q[0, 6] == pytest.approx(0.5 * RULES.disturbance_correlation)
    assert q[0, 1] == 0.0


def test_prior_precision_frees_only_the_selected_columns() -> None:
    precision = PRIOR.precision(("b",))
    np.testing.assert_allclose(precision, [100.0, 25.0, 1.0 / RULES.slab_sigma**2])


def test_gradient_of_the_evidence_equals_finite_differences(dense: Dense) -> None:
    precision, h = PRIOR.precision(("a",)), 1e-5
    point = np.array([PROCESS.log_lateral, PROCESS.log_axial, PROCESS.log_torque])

    def value(logs: np.ndarray) -> float:
        process = DisturbanceVariances(log_lateral=logs[0], log_axial=logs[1], log_torque=logs[2])
        white = evidence.marginal_grams(dense.lin, process, PRIOR)
        gram, log_det, theta_scaled = white.gram, white.log_det, dense.lin.theta_scaled
        return evidence.log_evidences(gram, log_det, theta_scaled, PRIOR, [("a",)], FREE)[0]

    slope = evidence._evidence_and_slope(dense.lin, PROCESS, PRIOR, precision)[1]
    for i, step in enumerate(h * np.eye(3)):
        assert slope[i] == pytest.approx((value(point + step) - value(point - step)) / (2 * h), rel=1e-5)


def test_fit_process_recovers_the_true_variances() -> None:
    rng = np.random.default_rng(11)
    count, truth = (
        60,
        DisturbanceVariances(log_lateral=np.log(0.4), log_axial=np.log(0.05), log_torque=np.log(3.0)),
    )
    root = np.linalg.cholesky(truth.covariance(BINS))
    Z = rng.normal(size=(count, ROWS, 6 * BINS))
    w = rng.normal(size=(count, 6 * BINS)) @ root.T
    r = rng.normal(size=(count, ROWS)) + np.einsum("snz,sz->sn", Z, w)
    S, L = np.zeros((count, ROWS, P)), np.zeros((count, ROWS, K))
    A = np.concatenate([r[:, :, None], S, L, Z], axis=2)
    lin = _linearisation(np.swapaxes(A, 1, 2) @ A, np.zeros(count, dtype=int), np.zeros(P), np.zeros((1, K)))
    start = DisturbanceVariances(log_lateral=0.0, log_axial=0.0, log_torque=0.0)
    process = evidence.fit_process(lin, PRIOR, (), start)
    assert process.log_lateral == pytest.approx(truth.log_lateral, abs=0.5)
    assert process.log_axial == pytest.approx(truth.log_axial, abs=0.6)
    assert process.log_torque == pytest.approx(truth.log_torque, abs=0.4)


def test_bounded_step_lets_other_parameters_compensate_a_bound() -> None:
    """Of two parameters with the same slope, one is at its bound, so the other must explain everything."""
    push = np.array([1.0, -1.0, -1.0])
    gram = 1e4 * np.outer(push, push)
    limits = np.array([0.0, -5.0]), np.array([5.0, 5.0])
    step, _ = evidence.bounded_step(gram, np.zeros(2), np.array([1.0, 1.0]), limits)
    assert step == pytest.approx([0.0, -1.0], abs=1e-3)
    free, _ = evidence.posterior(gram, np.zeros(2), np.array([1.0, 1.0]))
    assert free == pytest.approx([-0.5, -0.5], abs=1e-3)
