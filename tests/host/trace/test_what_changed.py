"""What changed between two sets of flights: refused sets, and shipped flights of one world."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.host.trace.builders import build_inputs, weights_of_nothing
from trimtab.host.effects import load_effects
from trimtab.host.log import Flight, read_flight
from trimtab.host.trace.answer import to_json
from trimtab.host.trace.baseline import check_baseline
from trimtab.host.trace.data.cutting import segments_of
from trimtab.host.trace.data.sets import check_sets
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.decision.decide import decide
from trimtab.host.trace.decision.findings import Code, LogsRefused, Verdict
from trimtab.host.trace.joint import COMMON, joint_space
from trimtab.host.trace.run import run
from trimtab.host.trace.segment_fit import linearise
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.trace.words import result_lines
from trimtab.host.trace.words import verdict as verdict_in_words

DATA = Path(__file__).parents[2] / "data"
EFFECTS = load_effects()


def flight(name: str) -> Flight:
    return read_flight(DATA / f"{name}.mcap")


def test_a_baseline_of_another_vehicle_is_refused() -> None:
    other = flight("a1")
    other = replace(other, vehicle=other.vehicle.model_copy(update={"mass_kg": 0.9}))
    with pytest.raises(LogsRefused, match=r"a1\.mcap: a baseline of vehicle .*a2\.mcap is of") as refusal:
        check_sets([flight("a2")], [other])
    assert refusal.value.details == {"code": Code.BASELINE_OF_ANOTHER_VEHICLE}


def test_sets_that_share_a_flight_are_refused(tmp_path: Path) -> None:
    copy = read_flight(Path(shutil.copy(DATA / "a1.mcap", tmp_path / "copy.mcap")))
    with pytest.raises(LogsRefused, match=r"copy\.mcap: the same flight as .*a1\.mcap") as refusal:
        check_sets([flight("a1")], [copy])
    assert refusal.value.details == {"code": Code.SETS_SHARE_A_FLIGHT}


def test_sets_that_log_other_topics_are_refused() -> None:
    bare = replace(flight("a1"), control=None)
    with pytest.raises(LogsRefused, match="the baseline logs only poses, the flights after") as refusal:
        check_sets([flight("a2")], [bare])
    assert refusal.value.details == {"code": Code.SETS_DIFFER_IN_TOPICS}
    check_sets([flight("a2")], [flight("a1")])


def test_a_baseline_with_a_cause_outside_the_library_is_refused() -> None:
    """A force that no effect gives, the same in two repeat flights: 2 m/s^2 that rings at 2 Hz."""
    flights = [flight("a1"), flight("a2"), flight("b1")]
    data, _ = segments_of([FlightData.of(each) for each in flights], rate_driven=False)
    effects = {name: EFFECTS[name] for name in ("mass", "thrust-gain", "linear-drag")}
    space = joint_space(flights[0].vehicle, effects, (), [False, False, True])
    model = SegmentModel.of(flights[0].vehicle, space, data)
    check_baseline(model, data, flights[:2], [(0, 1)], thrust_known=True)
    t_s = data.start_s[:, None] + data.dt_s * np.arange(data.steps)
    sway_m = 2.0 / (4.0 * np.pi) ** 2 * np.sin(4.0 * np.pi * t_s)
    swayed = replace(
        data,
        p_ned=data.p_ned + sway_m[:, :, None] * np.array([1.0, 0.0, 0.0]),
        force_weight=np.zeros_like(data.force_weight),  # the accelerometer did not sway
    )
    with pytest.raises(LogsRefused, match=r"a1\.mcap, .*a2\.mcap: the baseline itself") as refusal:
        check_baseline(model, swayed, flights[:2], [(0, 1)], thrust_known=True)
    assert refusal.value.details == {"code": Code.BASELINE_OUTSIDE_LIBRARY}


def test_grams_of_a_flight_are_those_of_its_own_parameters() -> None:
    """The Gram of a joint linearisation is that of each flight's parameters, assigned to the columns."""
    flights = [flight("a1"), flight("a2")]
    data, _ = segments_of([FlightData.of(each) for each in flights], rate_driven=False)
    effects = {name: EFFECTS[name] for name in ("mass", "linear-drag", "slung-payload")}
    space = joint_space(flights[0].vehicle, effects, (), [False, True])
    joint, alone = (SegmentModel.of(flights[0].vehicle, each, data) for each in (space, space.rolled))
    rng = np.random.default_rng(3)
    theta_scaled = space.clipped(0.1 * rng.normal(size=len(space.columns)))
    theta_scaled[[c.owner == COMMON + "linear-drag" and c.strength for c in space.columns]] = 0.5
    nuisances = np.zeros((2, joint.nuisances))
    basis = linearise.basis(joint, data, theta_scaled, nuisances)
    lin, _ = linearise.linearise(joint, data, theta_scaled, nuisances, basis)
    for index in range(2):
        part = data.of_flight(index, np.flatnonzero(data.flight == index))
        point = space.of_flight(theta_scaled, index)
        own_basis = linearise.basis(alone, part, point, nuisances[:1])
        own, _ = linearise.linearise(alone, part, point, nuisances[:1], own_basis)
        expected = space.expanded(own.own.sum(0)[None], index)[0]
        of_flight = lin.own[lin.piece_flight == index].sum(0)
        np.testing.assert_allclose(of_flight, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_nothing_changed_between_flights_of_one_world() -> None:
    """The shipped flights hold a thrust gain that is not in the vehicle file: both sets have it in common."""
    names = ("mass", "thrust-gain", "linear-drag", "motor-lag", "mocap-latency")
    effects = {name: EFFECTS[name] for name in names}
    result = run([flight("a2"), flight("b2")], [], effects, baseline=[flight("a1"), flight("b1")])
    assert result.verdict is Verdict.NOTHING_MISSING
    assert result.effects == ()
    assert verdict_in_words(result).startswith("Nothing changed since the baseline")
    for text in (verdict_in_words(result), *result_lines(result)[1:2]):
        assert "the baseline is 2 flights; the thrust of each log may differ by about 5 %" in text.lower()
    assert "  settings on board: the same" in result_lines(result)
    assert "Settings on board: the same." in verdict_in_words(result)
    answer = to_json(result)
    assert answer["baseline"]["logs"] == ["a1.mcap", "b1.mcap"]
    assert answer["baseline"]["settings"] == []
    assert answer["baseline"]["thrust_sd"] == 0.05
    gain = answer["baseline"]["common"]["thrust-gain"]["gain"]
    assert abs(gain["value"] - 1.0) > 2.0 * 0.01  # beyond its tolerance, in both sets
    assert set(result.model.adjustments) == set(effects)


@pytest.mark.parametrize(
    ("null_probability", "compared", "verdict"),
    [
        (0.3, False, Verdict.NOTHING_MISSING),
        (0.3, True, Verdict.UNDECIDED),
        (0.7, True, Verdict.NOTHING_MISSING),
    ],
)
def test_a_probable_change_leaves_a_comparison_undecided(
    null_probability: float, compared: bool, verdict: Verdict
) -> None:
    inputs = build_inputs(
        null_probability=null_probability,
        posterior_weights=weights_of_nothing(null_probability, ("drag",)),
        inclusion_probability={"drag": 1.0 - null_probability},
        compared=compared,
    )
    assert decide(inputs).verdict is verdict
