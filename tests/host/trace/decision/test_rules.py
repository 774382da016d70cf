"""The values of the thresholds that tracing decides by, so that a change of one is seen."""

from __future__ import annotations

from types import ModuleType

import pytest

from trimtab.host.trace import (
    diagnose,
    evidence,
    loop,
    parameters,
    refine,
    repeats,
    result,
    run,
    search,
    separate,
    twins,
    verdict,
)

EXPECTED: dict[ModuleType, dict[str, float]] = {
    diagnose: {"SETTLED": 0.2},
    evidence: {"CORRELATION": 0.75, "LOG_ODDS": -3.6888794541139363, "SLAB": 2.0},
    loop: {"BIN_S": 0.04, "LEAST_S": 9.6, "MOVED_M": 0.3},
    refine: {"SETTLED": 0.3, "TEMPER": 2.0, "WORSE": 1.5},
    repeats: {"APART_S": 1.0, "LEAST_S": 3.0},
    result: {"SHOWN": 4.2},
    run: {"FAULT": 0.1, "SAG_SEEN": 0.01, "WEIGHED": 0.005},
    search: {
        "BEAM": 25,
        "BEARS": 4.0,
        "MAX_EFFECTS": 6,
        "WITHIN_NATS": 2.995732273553991,
        "WORTH_FITTING": 12.0,
    },
    separate: {"DECISIVE_SIGMA": 4.2, "SIGMA_MAX": 100.0, "UNDECIDED_SIGMA": 2.4477468306808166},
    twins: {
        "FORCE_FLOOR": 0.06,
        "FORM_SHARE": 0.1,
        "LINE_CHANCE": 1e-3,
        "LINE_RATIO": 3.5,
        "MOVED_SHARE": 0.02,
        "REPEAT_FORM": 0.2,
        "REPEAT_SHARE": 0.08,
        "REPEAT_Z": 3.0,
        "SWINGING_LINE_RATIO": 10.0,
        "TORQUE_FLOOR": 0.8,
        "WORSENED": 1.5,
        "WORSENED_M": 0.01,
    },
    verdict: {"ALIAS_PROBABILITY": 0.05, "RESTLESS": 0.5, "RESTLESS_TURN": 3.0, "SOMETHING": 0.05},
}


@pytest.mark.parametrize(
    ("module", "name", "value"),
    [
        pytest.param(module, name, value, id=f"{module.__name__.rpartition('.')[2]}.{name}")
        for module, values in EXPECTED.items()
        for name, value in values.items()
    ],
)
def test_threshold_has_the_value_that_it_was_calibrated_to(
    module: ModuleType, name: str, value: float
) -> None:
    assert getattr(module, name) == pytest.approx(value, rel=1e-12)


def test_discrepancies_have_the_values_that_they_were_calibrated_to() -> None:
    assert parameters.DISCREPANCY == {
        "motor-lag": 0.25,
        "actuation-delay": 0.4,
        "mocap-latency": 0.1,
        "inertia": 0.2,
        "slung-payload.ratio": 0.15,
        "slung-payload.length_m": 1.0,
    }
    assert refine.LOOP_DISCREPANCY == {"motor-lag": 0.05, "translational-lift": 0.05}
