"""Detectability of effects, and the probability that no effect is missing."""

from __future__ import annotations

import numpy as np
import pytest

from tests.host.trace.builders import MASS, build_diagnosis, build_effect, build_parameter, build_space
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.trace.selection import detectability

ROTOR = build_effect("rotor", *(build_parameter(f"loss_{k}") for k in (1, 2, 3)), one_of=True)
PAIR = build_effect("pair", build_parameter("x"), build_parameter("y"))


def gram_of(*columns: list[float]) -> np.ndarray:
    """Return the Gram (1 + P, 1 + P) of a residual of ones and these slopes."""
    stacked = np.array([[1.0] * len(columns[0]), *columns])
    return stacked @ stacked.T


def sigma(space: ParameterSpace, gram: np.ndarray, tolerance: float) -> dict[str, float]:
    return detectability(space, gram, np.full(len(space.columns), tolerance**-2.0))


def test_detectability_of_an_effect_alone_is_the_length_of_its_slope() -> None:
    sigmas = sigma(build_space("drag"), gram_of([3.0, 0.0, 4.0]), 0.1)
    assert sigmas == pytest.approx({"drag": 5.0})


def test_detectability_counts_all_parameters_of_an_effect_together() -> None:
    sigmas = sigma(build_space(PAIR), gram_of([3.0, 0.0, 0.0], [0.0, 4.0, 0.0]), 0.1)
    assert sigmas == pytest.approx({"pair": 5.0})
    opposite = sigma(build_space(PAIR), gram_of([3.0, 0.0, 0.0], [-3.0, 0.0, 0.0]), 0.1)
    assert opposite == pytest.approx({"pair": 0.0}, abs=1e-7)


def test_detectability_of_several_candidates_of_an_effect_is_the_greatest() -> None:
    sigmas = sigma(build_space(ROTOR), gram_of([1.0, 0.0, 0.0], [0.0, 7.0, 0.0], [0.0, 0.0, 2.0]), 1e-9)
    assert sigmas == pytest.approx({"rotor": 7.0})


@pytest.mark.parametrize(
    ("tolerance", "expected"),
    [
        pytest.param(1e-6, 5.0, id="known-exactly"),
        pytest.param(1.0, np.sqrt(25.0 - 9.0 * 9.0 / (9.0 + 1.0)), id="within-its-tolerance"),
        pytest.param(1e6, 4.0, id="free"),
    ],
)
def test_detectability_excludes_what_another_parameter_can_explain(tolerance: float, expected: float) -> None:
    space = build_space("drag", MASS)
    sigmas = sigma(space, gram_of([3.0, 4.0], [3.0, 0.0]), tolerance)
    assert sigmas == pytest.approx({"drag": expected}, rel=1e-4)  # the mass is no candidate


def test_detectability_of_many_effects_is_the_least_squares_residual_of_each() -> None:
    rng = np.random.default_rng(1)
    space = build_space("drag", PAIR, MASS, ROTOR, "lag")
    slopes, tolerances = rng.normal(size=(40, 8)), rng.uniform(0.05, 3.0, 8)
    stacked = np.column_stack([rng.normal(size=40), slopes])
    sigmas = detectability(space, stacked.T @ stacked, tolerances**-2.0)
    expected = {}
    for candidate, mine in space.groups.items():
        rest = [i for i in range(8) if i not in mine]
        design = np.concatenate([slopes[:, rest], np.diag(1.0 / tolerances[rest])])
        target = np.concatenate([slopes[:, list(mine)].sum(1), np.zeros(len(rest))])
        residual = target - design @ np.linalg.lstsq(design, target, rcond=None)[0]
        name = candidate.partition(".")[0]
        expected[name] = max(expected.get(name, 0.0), float(np.linalg.norm(residual)))
    del expected[MASS]
    assert sigmas == pytest.approx(expected)


def test_detectability_does_not_depend_on_the_residual() -> None:
    space, gram = build_space("drag", "lag"), gram_of([1.0, 2.0, 0.0], [0.0, 1.0, 1.0])
    other = gram.copy()
    other[0], other[:, 0] = 9.0, 9.0
    assert sigma(space, gram, 0.5) == sigma(space, other, 0.5)


def test_detectability_without_candidates_is_empty() -> None:
    assert sigma(build_space(MASS), gram_of([1.0, 2.0]), 0.5) == {}


def test_null_probability_is_the_weight_of_the_empty_set() -> None:
    assert build_diagnosis(posterior_weights={(): 1.0, ("drag",): 3.0}).null_probability == pytest.approx(
        0.25
    )
    assert build_diagnosis(posterior_weights={("drag",): 3.0}).null_probability == 0.0
