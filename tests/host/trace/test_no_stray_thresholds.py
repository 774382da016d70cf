"""No module of tracing defines a threshold: thresholds are in the table of rules.

A number at module level must be a setting of a numerical method and be listed here with what it sets.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from pathlib import Path

import pytest

from trimtab.host.trace.decision import rules

PACKAGE = Path(rules.__file__).parents[1]
MODULES = sorted(path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py"))

METHOD_SETTINGS: Mapping[str, Mapping[str, str]] = {
    "bounds.py": {
        "_BLOCK_PIVOTS": "number of iterations",
        "_PIVOTS": "number of iterations",
    },
    "data/contact.py": {
        "_WINDOW_S": "length of the windows that speed and force are averaged over",
        "_WINDOW_STEP_S": "grid step of these windows",
    },
    "data/cutting.py": {
        "DT_S": "grid step of segments",
        "SEGMENT_S": "length of a segment",
        "RUN_UP_LAGS": "length of the rotors' run-up before a segment",
    },
    "data/segments.py": {
        "BIN_S": "length of a bin",
        "PATH_S": "grid step of measured paths",
    },
    "evidence.py": {
        "_FIXED": "prior width of a form that cannot act, small beside one",
        "FORCE_LIMITS": "range of the search for the process noise, log variance",
        "TORQUE_LIMITS": "range of the search for the process noise, log variance",
    },
    "flight_fit/fit.py": {
        "LOOP_SETTLED": "step at which the Gauss-Newton iteration ends",
        "_WHITENING_SETTLED": "step at which the whitening of a linear step is not fitted again",
        "_ITERATIONS": "number of Gauss-Newton iterations",
        "_REFIT_SETTLED": "step at which that fit ends",
        "_LINE": "step lengths of the line search",
        "_STALLED_NATS": "gain of a step with which the iteration ends",
        "_ENOUGH": "decrease of the cost with which the line search takes the whole step",
    },
    "flight_fit/loop.py": {
        "_TOGETHER": "number of flights that are rolled out in one call",
        "STABLE": "stability limit of RK4 along the real axis",
        "_THETA_STEP": "step of the difference quotients",
        "_FAR": "distance after which a linearisation is made again",
        "_KEPT": "number of linearisations that are kept",
        "_NEAR": "distance up to which a linearisation counts as that of a point",
    },
    "flight_fit/recording.py": {
        "SAMPLE_S": "step of the roll-out",
        "PER_BIN": "steps in a bin",
        "_KEPT": "number of matrices that are kept",
        "_AT_LIMIT": "share of its limit at which the rate integral counts as there",
        "_ABOUT_LIMIT": "bins about a jump of the law that are not compared",
        "LEAD_S": "time in which the start's own errors die away",
    },
    "flight_fit/repeatability.py": {
        "_SHIFT_STEP": "grid step of the shifts that the variance is estimated from",
    },
    "flight_fit/rotors.py": {
        "STEP_S": "step of the roll-out",
        "_LAGS": "order of the autoregression",
        "_THETA_STEP": "step of the difference quotients",
        "_FAR": "distance after which a linearisation is made again",
        "_FITS": "number of Gauss-Newton iterations",
    },
    "flight_fit/whitening.py": {
        "CHANNELS": "size of a bin's residual",
        "WINDOWS": "basis of the autoregression",
        "_TRIANGLES": "size of a store, which changes results by rounding alone",
    },
    "hover/balance.py": {
        "CHANNELS": "size of a balance",
        "_STEP": "step of the difference quotients",
    },
    "hover/fit.py": {
        "_OFFSET": "width of a prior that leaves an offset free",
        "_ITERATIONS": "number of Gauss-Newton iterations",
    },
    "next_flight/information.py": {
        "_ROLLED": "number of segments of a manoeuvre that are rolled out",
        "_TURNS": "number of iterations that keep a manoeuvre on its path",
    },
    "next_flight/manoeuvres.py": {
        "PACES": "grid of paces that are tried",
    },
    "next_flight/separation.py": {
        "SIGMA_MAX": "greatest separation that a linearisation can mean; greater ones are clipped",
    },
    "assembly.py": {
        "SPEED_S": "time over which the speeds of the trained region are means",
    },
    "prediction.py": {
        "_LEAD_S": "time in which a segment's start settles",
        "_ROLL_OUT_STEP_S": "step of the roll-out",
        "_TOGETHER": "number of flights that are rolled out in one call",
    },
    "residual/closed_forms.py": {
        "_ROW_STEP": "step between the rows that are fitted",
    },
    "residual/description.py": {
        "_MIN_CELL_BINS": "fewest samples in a cell of the drawn grid",
        "_CELLS": "number of cells along the drawn grid's longest side",
    },
    "residual/features.py": {
        "_CENTRES": "size of the radial basis",
    },
    "residual/network.py": {
        "SETTINGS": "size of the network and length of its training",
    },
    "residual/regression.py": {
        "BLOCKS": "number of folds of the cross-validation",
        "RUN_S": "length of the pieces of the block bootstrap",
        "_DRAWS": "number of bootstrap draws",
        "_RIDGES": "grid of ridge penalties",
    },
    "residual/unexplained.py": {
        "_FFT": "length of the Fourier transform",
        "_QUIET": "a residual of nothing",
        "_PULSE_BINS": "length of the mean over a pulse",
        "_PHASE_S": "shift that makes averages independent, for the number of chances",
        "_DIRECTIONS": "grid of directions",
        "_BEST": "expected size of the greatest of many chances",
        "NOTHING_UNEXPLAINED": "the same of both channels",
    },
    "search.py": {
        "BEAM": "width of the beam search",
    },
    "selection.py": {
        "_GUESSED_EFFECTS": "depth of the screening for a starting point",
        "_GUESS_ITERATIONS": "number of Gauss-Newton iterations",
        "_LACKING_SHARE": "share of the gain that a starting point may lack",
    },
    "segment_fit/fit.py": {
        "_SETTLED_STEP": "step at which the Gauss-Newton iteration ends",
        "_GREATEST_STEP": "limit of a Gauss-Newton step",
        "_CALM": "starting value of the search for the process noise",
        "START": "starting value of the search for the process noise",
        "START_RATE_DRIVEN": "the same where the measured rate drives the attitude",
        "SEGMENTS_SETTLED": "step at which the Gauss-Newton iteration ends",
        "_ITERATIONS": "number of Gauss-Newton iterations",
        "_GAINED_NATS": "gain below which the Gauss-Newton iteration ends",
        "_PATIENCE": "number of iterations after which it does",
    },
    "segment_fit/linearise.py": {
        "_PART": "number of segments that are rolled out in one call",
        "_STORED": "size of a store, which changes no result",
        "_THINNED": "share of the segments that start values are compared on",
        "_X_STEP": "step of the difference quotients",
        "TURN_STEPS": "steps of the difference quotient for a body rate",
        "_NUISANCE_STEP": "step of the difference quotients",
        "_BIN_STEP": "step of the difference quotients",
        "_THETA_STEP": "step of the difference quotients",
    },
    "segment_fit/rollout.py": {
        "_TOGETHER": "number of flights that are rolled out in one call",
    },
    "segment_fit/model.py": {
        "STATES": "size of the state",
        "NUISANCES": "number of a flight's nuisances",
        "CHANNELS": "size of a prediction",
        "_STEP_INPUTS": "sizes of the inputs of the compiled step",
        "_THRUST_ROUNDS": "number of fixed-point iterations",
    },
    "words.py": {
        "_SHOWN_STRETCHES": "length of a list in the text for people",
    },
}

PRIORS: Mapping[str, Mapping[str, str]] = {
    "parameters.py": {"_THRUST_CURVE": "prior scale and bound of an unknown thrust curve"},
}
"""Priors that are defined with their nuisance. No further one may be added."""


def holds_number(node: ast.AST) -> bool:
    """Return whether an expression contains a literal number outside functions and texts."""
    if isinstance(node, ast.Lambda | ast.JoinedStr):
        return False
    if isinstance(node, ast.Constant):
        return type(node.value) in (int, float)
    return any(holds_number(child) for child in ast.iter_child_nodes(node))


def constants(source: str) -> list[str]:
    """Return the names at module level whose value holds a literal number."""
    names: list[str] = []
    for statement in ast.parse(source).body:
        if isinstance(statement, ast.Assign):
            targets = statement.targets
        elif isinstance(statement, ast.AnnAssign | ast.AugAssign):
            targets = [statement.target]
        else:
            continue
        if statement.value is not None and holds_number(statement.value):
            names += [node.id for each in targets for node in ast.walk(each) if isinstance(node, ast.Name)]
    return names


@pytest.mark.parametrize("module", [module for module in MODULES if module != "decision/rules.py"])
def test_module_holds_no_number_that_is_not_listed(module: str) -> None:
    listed = {**METHOD_SETTINGS.get(module, {}), **PRIORS.get(module, {})}
    numbers = constants((PACKAGE / module).read_text(encoding="utf-8"))
    stray = [name for name in numbers if name not in listed]
    assert stray == [], "a threshold belongs into `Rules`; a setting of a method is to be listed here"
    assert sorted(set(listed) - set(numbers)) == [], "no such constant any more"


def test_listed_modules_exist_and_every_number_says_what_it_sets() -> None:
    for table in (METHOD_SETTINGS, PRIORS):
        assert sorted(set(table) - set(MODULES)) == []
        assert [
            name for names in table.values() for name, reason in names.items() if not reason.strip()
        ] == []


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        pytest.param("A = 1", ["A"], id="int"),
        pytest.param("A = -0.5", ["A"], id="negative"),
        pytest.param("A: float = 0.5", ["A"], id="annotated"),
        pytest.param("A = B = 0.5", ["A", "B"], id="chained"),
        pytest.param("A, B = 1, 0.5", ["A", "B"], id="unpacked"),
        pytest.param("A = (0.1, 0.2)", ["A"], id="tuple"),
        pytest.param("A = {'force': 0.1}", ["A"], id="table"),
        pytest.param("A = 2 * B", ["A"], id="arithmetic"),
        pytest.param("A = float(np.log(20.0))", ["A"], id="call"),
        pytest.param("A = np.full(B, 1e-6)", ["A"], id="array"),
        pytest.param("A = B * C", [], id="of-listed-constants"),
        pytest.param("A = True", [], id="flag"),
        pytest.param("A = 'b'", [], id="text"),
        pytest.param("A = RULES.odds", [], id="rule"),
        pytest.param("A = lambda x: 1e3 * x", [], id="function"),
        pytest.param("def f():\n    a = 1", [], id="inside-a-function"),
    ],
)
def test_constants_are_names_whose_value_holds_a_number(source: str, expected: list[str]) -> None:
    assert constants(source) == expected
