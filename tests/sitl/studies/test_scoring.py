"""Scoring against verdicts whose right score is known, and effective parameters of known plants."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trimtab.host.effects import load_effects
from trimtab.host.log import read_flight
from trimtab.host.trace.data.signals import signals
from trimtab.host.trace.decision.findings import Code
from trimtab.host.trace.flight_fit.fit import prior_of
from trimtab.host.trace.parameters import space
from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.studies.files import read_json
from trimtab.sitl.studies.flights import BLIND, STILL, TRUTH, fly_and_seal, plan_references
from trimtab.sitl.studies.scoring.baselines import stepwise_bic, weak_sindy
from trimtab.sitl.studies.scoring.brought import brought_effects
from trimtab.sitl.studies.scoring.counts import exact_interval
from trimtab.sitl.studies.scoring.detection import by_kind, detection_rows
from trimtab.sitl.studies.scoring.effective import Effective, effective, nearest
from trimtab.sitl.studies.scoring.metrics import (
    baseline_rows,
    confusion,
    is_right,
    relative_errors,
    summary,
)
from trimtab.sitl.studies.scoring.names import collapsed, ratios, with_scored_names
from trimtab.sitl.studies.scoring.probabilities import probability_rows
from trimtab.sitl.studies.scoring.world import is_told, judge, parameter_rows
from trimtab.sitl.studies.table import failure, lines, truth_table
from trimtab.sitl.studies.thin import CASES
from trimtab.sitl.studies.worlds import SAME_RATIO, PlannedWorld

VEHICLE = load_vehicle("research")
EFFECTS = load_effects()
SPACE = space(VEHICLE, EFFECTS)
CLEAR = {"x": {"y": 9.0}}
HAZY = {"x": {"y": 9.0, "z": 4.1}}


def verdict(said: str, *names: str, aliases: dict[str, list[str]] | None = None) -> dict[str, Any]:
    effects = [
        {
            "name": name,
            "parameters": {
                p.key: {"value": p.neutral + 1.0, "sd": 0.1, "unit": "1"}
                for p in EFFECTS[name].parameters
                if not p.form
            },
            "probability": 1.0,
            "aliases": [{"name": a, "probability": 0.1} for a in (aliases or {}).get(name, [])],
        }
        for name in names
    ]
    answer = {"verdict": said, "effects": effects, "reasons": [], "before": {}, "after": {}}
    return {"exit_code": 0, "answer": answer, "errors": "", "trace_s": 10.0}


@pytest.mark.parametrize(
    ("hits", "count", "low", "high"),
    [
        (0, 200, 0.0, 1.0 - 0.025 ** (1 / 200)),  # closed form without a hit
        (80, 80, 0.025 ** (1 / 80), 1.0),
        (4, 20, 0.0573, 0.4366),  # Clopper-Pearson in common tables
        (81, 263, 0.2527, 0.3676),  # Newcombe 1998, table I
        (1, 29, 0.0009, 0.1776),  # the same
    ],
)
def test_exact_interval_is_the_known_one(hits: int, count: int, low: float, high: float) -> None:
    assert exact_interval(hits, count) == pytest.approx((low, high), abs=6e-5)


def test_exact_interval_of_impossible_count_is_refused() -> None:
    with pytest.raises(ValueError, match="3 hits of 2"):
        exact_interval(3, 2)


def test_undecided_on_an_identifiable_world_is_a_miss() -> None:
    said = verdict("undecided", "motor-lag")
    assert not judge(["motor-lag"], said, CLEAR, EFFECTS)["top1"]
    assert not judge(["motor-lag"], said, CLEAR, EFFECTS)["exact"]
    assert judge(["motor-lag"], said, HAZY, EFFECTS)["top1"]
    assert judge(["motor-lag"], verdict("traced", "motor-lag"), CLEAR, EFFECTS)["top1"]


def test_truth_among_the_aliases_is_in_the_alias_set_and_no_hit() -> None:
    said = verdict("undecided", "wind", "linear-drag", aliases={"linear-drag": ["quadratic-drag"]})
    score = judge(["quadratic-drag"], said, HAZY, EFFECTS)
    assert score["in_alias"]
    assert not score["top1"]
    assert sorted(score["alias_sizes"]) == [1, 2]


def test_what_is_possible_is_the_alias_set_of_a_verdict_that_names_nothing() -> None:
    said = verdict("nothing-missing")
    said["answer"]["possible"] = [
        {"name": "motor-lag", "probability": 0.6},
        {"name": "wind", "probability": 0.1},
    ]
    score = judge(["motor-lag"], said, HAZY, EFFECTS)
    assert score["in_alias"]
    assert score["alias_sizes"] == [2]
    assert not judge(["inertia"], said, HAZY, EFFECTS)["in_alias"]


def test_answer_contains_what_is_possible_beside_the_names() -> None:
    said = verdict("traced", "wind", aliases={"wind": ["frame-tilt"]})
    said["answer"]["possible"] = [{"name": "motor-lag", "probability": 0.6}]
    score = judge(["wind", "motor-lag"], said, HAZY, EFFECTS)
    assert (score["in_alias"], score["in_answer"], score["answer_size"]) == (False, True, 3)
    assert not judge(["wind", "inertia"], said, HAZY, EFFECTS)["in_answer"]


LOSSES = {"rotor-loss": {"loss_1": 0.1, "loss_2": 0.0, "loss_3": 0.0, "loss_4": 0.0}}


def named_rotor(key: str) -> dict[str, Any]:
    """Return a verdict that names the loss of one rotor."""
    said = verdict("traced", "rotor-loss")
    (loss,) = said["answer"]["effects"]
    loss["parameters"] = {key: loss["parameters"][key]}
    return {**said, "answer": with_scored_names(said["answer"], LOSSES, EFFECTS)}


def test_the_loss_of_another_rotor_is_a_false_name() -> None:
    assert judge(["rotor-loss"], named_rotor("loss_1"), CLEAR, EFFECTS)["exact"]
    other = judge(["rotor-loss"], named_rotor("loss_3"), CLEAR, EFFECTS)
    assert (other["exact"], other["top1"], other["wrong"]) == (False, False, True)
    assert other["false_names"] == ["rotor-loss.loss_3"]
    assert [row["there"] for row in other["probabilities"]] == [False]
    counted = by_kind([score("single", ["rotor-loss"], named_rotor("loss_3"))])
    assert counted["rotor-loss"]["false"] == 1


def test_possible_rotors_count_as_one_effect_if_it_is_not_another_rotor_that_lost_thrust() -> None:
    possible = [{"name": f"rotor-loss.loss_{i}", "probability": 0.1 * i} for i in (1, 2, 3)]
    answer = {"verdict": "nothing-missing", "possible": [*possible, {"name": "wind", "probability": 0.2}]}
    assert with_scored_names(answer, {}, EFFECTS)["possible"] == [
        {"name": "rotor-loss", "probability": pytest.approx(0.3)},
        {"name": "wind", "probability": 0.2},
    ]
    lost = with_scored_names(answer, LOSSES, EFFECTS)["possible"]
    names = ["rotor-loss", "rotor-loss.loss_2", "rotor-loss.loss_3", "wind"]
    assert [each["name"] for each in lost] == names
    assert lost[0]["probability"] == pytest.approx(0.1)


def test_mass_named_as_thrust_gain_is_right() -> None:
    mass = collapsed(["mass"], ["mass"], EFFECTS)
    assert mass == {"thrust-over-mass"}
    assert collapsed(["thrust-gain"], ["mass"], EFFECTS) == mass
    assert collapsed(["thrust-gain", "inertia"], ["mass"], EFFECTS) == mass
    assert collapsed(["inertia"], ["mass"], EFFECTS) != mass
    assert collapsed(["mass", "inertia"], ["motor-lag"], EFFECTS) == {"thrust-over-mass", "inertia"}


def test_a_centre_of_mass_that_a_mass_moves_is_neither_right_nor_wrong() -> None:
    def truth(file: str, **effects: dict[str, float]) -> dict[str, Any]:
        named = {name.replace("_", "-"): values for name, values in effects.items()}
        head = 'description = "a test"\ntolerances = true\n'
        return {"world": "test", "file": head + file, "seed": 3, "plant": None, "effects": named}

    drawn = truth('[draw]\ncount = [1, 1]\nkinds = ["mass"]\nsize = [3.0, 4.0]\n', mass={"factor": 1.3})
    assert brought_effects(drawn, VEHICLE, SPACE) == {"com-offset"}
    heavy = truth("[effects.mass]\nfactor = 1.3\n", mass={"factor": 1.3})
    light = truth("[effects.mass]\nfactor = 1.01\n", mass={"factor": 1.01})
    lag = truth("[effects.motor-lag]\nextra_s = 0.02\n", motor_lag={"extra_s": 0.02})
    brought = brought_effects(heavy, VEHICLE, SPACE)
    assert brought == {"com-offset"}
    assert brought_effects({**heavy, "plant": "rotorpy"}, VEHICLE, SPACE) == frozenset()
    for other in (light, lag):
        assert brought_effects(other, VEHICLE, SPACE) == frozenset()
    said = verdict("traced", "thrust-gain", "inertia", "com-offset")
    assert judge(["mass"], said, CLEAR, EFFECTS, brought)["exact"]
    assert not judge(["mass"], said, CLEAR, EFFECTS)["exact"]
    assert judge(["mass", "com-offset"], said, CLEAR, EFFECTS, brought)["exact"]
    alone = verdict("traced", "com-offset")
    assert not judge(["mass"], alone, CLEAR, EFFECTS, brought)["exact"]
    assert not judge(["mass"], alone, CLEAR, EFFECTS, brought)["top1"]
    assert judge(["mass"], alone, CLEAR, EFFECTS, brought)["first"] == "com-offset"
    rows = probability_rows(said["answer"], ["mass"], EFFECTS, brought)
    assert [row["name"] for row in rows] == ["thrust-over-mass"]


def test_effects_that_show_as_ratios_are_the_kinds_that_make_no_pair() -> None:
    (ratio,) = ratios(EFFECTS)
    assert ratio.effects == SAME_RATIO
    assert ratio.alike == {"mass", "thrust-gain"}


def test_a_parameter_that_shows_relative_to_another_is_scored_on_the_quotient() -> None:
    truth: dict[str, Any] = {"effects": {"inertia": {"x": 1.3, "y": 1.0, "z": 1.0}}}
    truth["deviations"] = {"thrust-gain.gain": 0.04}
    z, eye = np.zeros(len(SPACE.columns)), np.eye(len(SPACE.columns))
    for owner, value in (("inertia", 1.32), ("thrust-gain", 1.1)):
        index = SPACE.owners[owner][0]
        z[index] = (value - 1.0) / SPACE.columns[index].scale
    known = Effective(space=SPACE, candidates={"inertia": "inertia"}, z=z, covariance=eye, gram=eye)
    (found,) = parameter_rows(truth, verdict("traced", "inertia")["answer"], known)
    assert (found["key"], found["family"]) == ("x", "torque")
    assert found["true"] == pytest.approx(1.2)
    assert found["drawn"] == pytest.approx(1.3 / 1.04)


def test_mass_named_as_thrust_gain_is_scored_on_the_ratio() -> None:
    assert judge(["mass"], verdict("traced", "thrust-gain"), CLEAR, EFFECTS)["exact"]
    truth: dict[str, Any] = {"effects": {"mass": {"factor": 1.28}}, "deviations": {}}
    answer = verdict("traced", "thrust-gain")["answer"]
    answer["effects"][0]["parameters"]["gain"] = {"value": 0.81, "sd": 0.004, "unit": "1"}
    known = told(mass=1.25)
    (row,) = parameter_rows(truth, answer, known)
    assert row["bound_sd"] == pytest.approx(0.1 * SPACE.columns[SPACE.owners["mass"][0]].scale)
    assert row["true"] == pytest.approx(0.8)
    assert row["drawn"] == pytest.approx(1.0 / 1.28)
    assert (row["estimate"], row["sd"]) == (pytest.approx(0.81), pytest.approx(0.004))


def told(*, mass: float) -> Effective:
    """A world of this mass, its parameters known to a tenth of their typical sizes."""
    (column,) = SPACE.owners["mass"]
    z, eye = np.zeros(len(SPACE.columns)), np.eye(len(SPACE.columns))
    z[column] = (mass - 1.0) / SPACE.columns[column].scale
    return Effective(space=SPACE, candidates={"mass": "mass"}, z=z, covariance=0.01 * eye, gram=100.0 * eye)


def row(effect: str, key: str, family: str, **numbers: Any) -> dict[str, Any]:
    usual = {"turned": False, "neutral": 0.0, "typical": 1.0, "bound_sd": 0.01, "drawn": numbers["true"]}
    return {"effect": effect, "key": key, "family": family, **usual, **numbers}


def score(kind_class: str, kinds: list[str], said: dict[str, Any], **more: Any) -> dict[str, Any]:
    known = CLEAR if kind_class in ("single", "pair") else None
    base = {"world": "0000", "class": kind_class, "kinds": kinds, "parameters": [], "floor_m": None}
    return {
        **base,
        "case": None,
        "told": None,
        "few": {},
        "redrawn": 0,
        "detection": [],
        "detectable": True if kind_class == "outside" else None,
        "baselines": None,
        **judge(kinds, said, known, EFFECTS),
        **more,
    }


SCORES = [
    score(
        "single",
        ["motor-lag"],
        verdict("traced", "motor-lag"),
        parameters=[row("motor-lag", "extra_s", "timing", true=2.0, estimate=2.1, sd=0.02)],
        after_m=0.021,
        floor_m=0.02,
    ),
    score("single", ["quadratic-drag"], verdict("traced", "linear-drag")),
    score(
        "pair",
        ["linear-drag", "wind"],
        verdict("traced", "linear-drag", "wind"),
        parameters=[
            row("wind", "wx", "aerodynamic", turned=True, true=3.0, estimate=3.0, sd=0.1),
            row("wind", "wy", "aerodynamic", turned=True, true=4.0, estimate=4.5, sd=0.1),
        ],
        after_m=0.03,
        floor_m=0.03,
    ),
    score("none", [], verdict("nothing-missing")),
    score("none", [], verdict("traced", "com-offset")),
    score("outside", ["elastic-tether"], verdict("outside-library")),
    score("outside", ["blade-flapping"], verdict("traced", "com-offset")),
]


def test_true_first_name_with_a_false_second_one_is_a_miss_of_the_exact_set() -> None:
    both = score("single", ["motor-lag"], verdict("traced", "motor-lag", "quadratic-drag"))
    assert (both["top1"], both["exact"]) == (True, False)
    found = summary([both, SCORES[0]])
    assert (found["top1"], found["singles_exact_identifiable"]) == (1.0, 0.5)


def test_summary_of_known_scores_is_counted_right() -> None:
    found = summary(SCORES)
    assert (found["top1"], found["n"]["top1"]) == (0.5, 2)
    assert (found["singles_exact_identifiable"], found["singles_exact"]) == (0.5, 0.5)
    assert (found["triples_exact"], found["n"]["triples_exact"]) == (None, 0)
    assert (found["pairs_exact"], found["false_alarm"], found["abstain_outside"]) == (1.0, 0.5, 0.5)
    assert (found["in_alias"], found["abstain_inside"]) == (pytest.approx(2 / 3), 0.0)
    assert (found["in_answer"], found["answer_size_max"]) == (pytest.approx(2 / 3), 2)
    # 0.1 of 2, and (0, 0.5) of the vector (3, 4).
    assert [e["error"] for e in relative_errors(SCORES)] == [pytest.approx(0.05), pytest.approx(0.1)]
    assert found["coverage_2sigma"] == pytest.approx(1 / 3)
    assert found["by_family"]["aerodynamic"]["coverage_2sigma"] == 0.5
    assert found["by_family"]["torque"] == {
        "coverage_2sigma": None,
        "interval": None,
        "n": 0,
        "width_over_bound": None,
        "coverage_2sigma_drawn": None,
        "interval_drawn": None,
    }
    assert found["width_over_bound"] == pytest.approx(10.0)
    assert found["after_over_floor_median"] == pytest.approx(1.025)


def test_truth_is_in_two_columns_the_effective_and_the_drawn_one() -> None:
    near = row("motor-lag", "extra_s", "timing", true=2.0, drawn=2.2, estimate=2.03, sd=0.02)
    far = row("motor-lag", "extra_s", "timing", true=2.0, drawn=0.5, estimate=2.03, sd=0.02)
    said = verdict("traced", "motor-lag")
    found = summary([score("single", ["motor-lag"], said, parameters=[each]) for each in (near, far)])
    assert found["parameter_error_median"] == pytest.approx(0.015)
    # The drawn value of the second world is below typical, so its error does not count.
    assert found["parameter_error_median_drawn"] == pytest.approx(0.17 / 2.2)
    assert (found["n"]["parameter_error"], found["n"]["parameter_error_drawn"]) == (2, 1)
    assert (found["coverage_2sigma"], found["coverage_2sigma_drawn"]) == (1.0, 0.0)
    assert found["by_family"]["timing"]["coverage_2sigma_drawn"] == 0.0
    cells = {cell["figure"]: (cell["effective"], cell["drawn"]) for cell in truth_table(found)}
    assert cells["parameter error, median"] == ("1.5 %", "7.7 %")
    assert cells["2-sigma coverage, timing"] == ("100.0 % (15.8-100.0 %)", "0.0 % (0.0-84.2 %)")


def test_only_detectable_outside_worlds_count_for_abstention_and_the_rest_has_its_own_row() -> None:
    weak = {"detectable": False, "outside_sigma": 2.0}
    quiet = score("outside", ["elastic-tether"], verdict("nothing-missing"), **weak)
    false = score("outside", ["elastic-tether"], verdict("traced", "wind"), **weak)
    found = summary([*SCORES, quiet, false])
    assert (found["abstain_outside"], found["n"]["abstain_outside"]) == (0.5, 2)
    assert (found["abstain_undetectable"], found["n"]["abstain_undetectable"]) == (0.0, 2)
    assert [is_right(quiet), is_right(false)] == [True, False]
    assert failure(false) == "elastic-tether, not detectable: traced, wind"
    assert found["by_outside_kind"]["elastic-tether"] == {
        "worlds": 3,
        "detectable": 1,
        "abstained_detectable": 1,
        "abstained_rest": 0,
        "false": 1,
    }


def seen(effect: str, sigma: float, tolerances: float, *, found: bool) -> dict[str, Any]:
    return {"effect": effect, "sigma": sigma, "tolerances": tolerances, "found": found}


def test_effects_found_are_counted_by_size_and_by_kind() -> None:
    pair = score("pair", ["motor-lag", "wind"], verdict("traced", "motor-lag", "thrust-gain"))
    pair["detection"] = [seen("motor-lag", 5.0, 20.0, found=True), seen("wind", 1.0, 3.0, found=False)]
    single = score("single", ["motor-lag"], verdict("traced", "motor-lag"))
    single["detection"] = [seen("motor-lag", 4.2, 70.0, found=False)]
    found = summary([pair, single])
    assert [(r["low"], r["high"], r["n"], r["found"]) for r in found["detection"]["sigma"]["total"]] == [
        (0.0, 2.0, 1, 0.0),
        (4.2, 8.0, 2, 0.5),
    ]
    kinds = found["detection"]["tolerances"]["kinds"]
    assert [(r["low"], r["high"], r["found"]) for r in kinds["motor-lag"]] == [
        (16.0, 32.0, 1.0),
        (64.0, None, 0.0),
    ]
    lag = found["by_kind"]["motor-lag"]
    assert (lag["singles"], lag["exact"], lag["all"], lag["found"], lag["false"]) == (1, 1, 2, 1, 0)
    assert found["by_kind"]["thrust-gain"]["false"] == 1
    assert found["by_kind"]["wind"]["all"] == 1


def test_detection_of_a_world_with_an_alias_named() -> None:
    truth = {"kinds": ["mass"], "effects": {"mass": {"factor": 1.25}}}
    said = judge(
        ["mass"], verdict("traced", "thrust-gain"), {"mass": {"wind": 30.0, "com-offset": 9.0}}, EFFECTS
    )
    (found,) = detection_rows(truth, said, told(mass=1.25), EFFECTS)
    tolerance = SPACE.columns[SPACE.owners["mass"][0]].tolerance
    assert found == {
        "effect": "mass",
        "sigma": 9.0,
        "tolerances": pytest.approx(0.25 / tolerance),
        "found": True,
    }
    undecided = judge(["mass"], verdict("undecided", "mass"), {"mass": {"wind": 3.0}}, EFFECTS)
    assert not detection_rows(truth, undecided, told(mass=1.25), EFFECTS)[0]["found"]


def test_small_and_weak_truths_have_no_parameter_error() -> None:
    small = row("motor-lag", "extra_s", "timing", true=0.9, estimate=9.0, sd=1.0)
    weak = row("motor-lag", "extra_s", "timing", true=1.4, estimate=9.0, sd=1.0, bound_sd=0.1)
    assert relative_errors([score("single", ["motor-lag"], verdict("traced"), parameters=[small])]) == []
    assert relative_errors([score("single", ["motor-lag"], verdict("traced"), parameters=[weak])]) == []


def test_table_names_every_world_that_was_judged_wrongly() -> None:
    assert [is_right(s) for s in SCORES] == [True, False, True, True, False, True, False]
    text = "\n".join(lines(summary(SCORES), SCORES))
    assert text.count("world 0000:") == 3
    assert failure(SCORES[1]) == "quadratic-drag: traced, linear-drag"
    assert confusion(SCORES)["quadratic-drag"] == {"linear-drag": 1}
    assert confusion(SCORES)["a pair"] == {"exact set": 1}


def thin(case: str, kind: str, said: dict[str, Any], *, told: bool = True) -> dict[str, Any]:
    return score("thin", [kind], said, case=case, told=told)


REFUSAL = {"exit_code": 2, "answer": {}, "errors": "trimtab: two vehicles", "trace_s": 90.0}
THIN_SCORES = [
    thin("no gyro", "mass", verdict("traced", "thrust-gain")),
    thin("no gyro", "motor-lag", verdict("traced", "motor-lag", "mass")),
    thin("no gyro", "motor-lag", verdict("undecided", "mass"), told=False),
    thin("two vehicles", "mass", REFUSAL),
    thin("one flight", "mass", verdict("outside-library")),
]


def test_thin_data_are_counted_by_case_and_apart_from_all_else() -> None:
    found = summary([*SCORES, *THIN_SCORES])
    assert (found["thin_wrong"], found["n"]["thin_wrong"]) == (0.2, 5)
    assert (found["thin_told"], found["n"]["thin_told"]) == (0.8, 5)
    assert list(found["thin"]) == ["one flight", "no gyro", "two vehicles"]
    none = dict.fromkeys(("nothing-missing", "refused", "outside-library", "failed"), 0)
    assert found["thin"]["no gyro"] == {"n": 3, "right": 1, "wrong": 1, "undecided": 1, "told": 2, **none}
    assert found["thin"]["two vehicles"]["refused"] == 1
    without = summary(SCORES)
    apart = ("thin", "thin_wrong", "thin_told", "n", "interval", "probabilities")
    assert {k: v for k, v in found.items() if k not in apart} == {
        k: v for k, v in without.items() if k not in apart
    }
    assert confusion([*SCORES, *THIN_SCORES]) == confusion(SCORES)


def test_thin_world_is_right_where_nothing_untrue_is_claimed_and_the_lack_is_said() -> None:
    assert [is_right(s) for s in THIN_SCORES] == [True, False, False, True, False]
    assert failure(THIN_SCORES[1]) == "motor-lag, no gyro: traced, motor-lag, mass"
    assert failure(THIN_SCORES[2]) == "motor-lag, no gyro not reported: undecided, mass"
    text = "\n".join(lines(summary(THIN_SCORES), THIN_SCORES))
    assert "no gyro: 1 right, 1 undecided, 1 wrong; missing data reported in 2 of 3" in text


def test_what_thin_data_lack_is_looked_for_among_the_codes_of_an_answer() -> None:
    def found(*codes: str) -> dict[str, Any]:
        return {"answer": {"findings": [{"code": code} for code in codes]}}

    assert is_told("no gyro", found("clock-drift", "no-gyro"))
    assert is_told("constant hover", found("hover-only"))
    assert not is_told("no gyro", found("no-twin"))
    assert not is_told("no gyro", found())
    refusal = {"answer": {"error": "trace each vehicle's logs apart", "code": "mixed-vehicles"}}
    assert is_told("two vehicles", refusal)
    assert not is_told("no gyro", refusal)


def test_codes_that_thin_data_are_scored_by_are_codes_of_tracing() -> None:
    known = {str(code) for code in Code}
    assert {code for case in CASES.values() for code in case.codes} <= known


def test_other_methods_stand_beside_tracing_on_the_same_worlds() -> None:
    def other(*names: str, first: bool = False, exact: bool = False) -> dict[str, Any]:
        named = {"names": list(names), "first_right": first, "exact": exact, "after_m": None}
        silent = {"names": None, "first_right": None, "exact": None, "after_m": 0.03}
        return {"regression": named, "network": silent}

    asked = [
        {**SCORES[0], "baselines": other("motor-lag", "mass", first=True)},
        {**SCORES[1], "baselines": other("wind")},
        {**SCORES[2], "baselines": other("linear-drag", "wind", first=True, exact=True)},
        {**SCORES[3], "baselines": other("mass")},
        {**SCORES[4], "baselines": other()},
        SCORES[5],
    ]
    tracing, regression, network = baseline_rows(asked)
    assert (tracing["top1"], tracing["pairs_exact"], tracing["false_alarm"]) == (0.5, 1.0, 0.5)
    assert (regression["top1"], regression["pairs_exact"], regression["false_alarm"]) == (0.5, 1.0, 0.5)
    assert regression["n"] == tracing["n"] == {"top1": 2, "pairs_exact": 1, "false_alarm": 2}
    assert regression["named_mean"] == pytest.approx(5 / 3)
    assert (network["top1"], network["after_mm_median"]) == (None, 30.0)
    assert tracing["after_mm_median"] == pytest.approx(25.5)
    assert baseline_rows(SCORES) == []
    text = "\n".join(lines(summary(SCORES), SCORES, baseline_rows(asked)))
    assert "trimtab trace: first name correct 1 of 2, pairs exact 1 of 1, false alarms 1 of 2" in text
    assert "network: first name correct -, pairs exact -, false alarms -, - effects" in text


@pytest.fixture
def series() -> list[np.ndarray]:
    """Two flights in which drag of 0.8 typical sizes and a lag of 0.6 explain all but white noise."""
    rng = np.random.default_rng(4)
    out = []
    for _ in range(2):
        terms = rng.standard_normal((900, 6, len(SPACE.columns)))
        terms = np.cumsum(terms, axis=0) / 30.0
        terms[:, :, list(SPACE.groups["battery-sag"])] *= 1e-6
        rest = 0.05 * rng.standard_normal((900, 6))
        for name, size in (("quadratic-drag", 0.8), ("motor-lag", 0.6)):
            rest += size * terms[:, :, SPACE.groups[name][0]]
        out.append(np.concatenate([rest[:, :, None], terms], axis=2))
    return out


def test_stepwise_regression_finds_what_made_the_data(series: list[np.ndarray]) -> None:
    assert set(stepwise_bic(SPACE, series)) == {"quadratic-drag", "motor-lag"}


def test_weak_sindy_finds_what_made_the_data(series: list[np.ndarray]) -> None:
    pytest.importorskip("pysindy", reason="pysindy is not installed")
    assert weak_sindy(SPACE, series) == ["quadratic-drag", "motor-lag"]


Flown = tuple[Path, dict[str, Any]]


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Flown:
    """Folder and truth of a world with drag and a late motor, flown twice in the air and once without."""
    folder = tmp_path_factory.mktemp("world")
    programme = replace(BLIND, learning=("quick", "climbs"), held_out=())
    world = PlannedWorld(
        name="w", kind_class="pair", kinds=("linear-drag", "motor-lag"), seed=5, turbulence=1.0
    )
    fly_and_seal(world, folder, plan_references(folder, "research", programme), "research", programme)
    return folder, read_json(folder / TRUTH)


def fitted(flown: Flown, drawn: dict[str, dict[str, float]]) -> Effective:
    folder, truth = flown
    logs = [[read_flight(log) for log in sorted((folder / n).glob("*.mcap"))] for n in (STILL, "flights")]
    return effective(VEHICLE, SPACE, drawn, truth["deviations"], *logs)


@pytest.fixture(scope="module")
def known(flown: Flown) -> Effective:
    """The effective parameters of the world that was flown."""
    return fitted(flown, flown[1]["effects"])


def test_effective_parameters_are_near_the_plants_and_not_the_same(flown: Flown, known: Effective) -> None:
    drawn = flown[1]["effects"]
    true = known.true()
    assert set(true) == {"linear-drag", "motor-lag"}
    for name, values in drawn.items():
        for key, value in values.items():
            typical = EFFECTS[name].parameters[EFFECTS[name].keys.index(key)].typical
            assert true[name][key] == pytest.approx(value, abs=0.15 * typical)
            assert true[name][key] != value
            assert 0.0 < known.bound_sd(name, key) < 0.1 * typical


def test_still_air_is_the_same_world_without_what_is_chance(flown: Flown) -> None:
    folder, _ = flown
    gusty, still = (folder / name for name in ("flights", STILL))
    assert sorted(p.stem for p in still.glob("*.mcap")) == ["climbs", "quick"]
    logs = [gusty / "climbs-1.mcap", gusty / "climbs-2.mcap", still / "climbs.mcap"]
    rough = [np.diff(signals(read_flight(log)).p_ned[1000:1100], n=2, axis=0).std() for log in logs]
    assert rough[2] < 0.2 * min(rough[:2])
    assert not list(folder.glob("*/*.truth.json"))


def test_still_air_has_every_flights_own_battery() -> None:
    programme = replace(BLIND, learning=("quick", "climbs"))
    assert programme.still(each=False) == [("quick", "quick", 1), ("climbs", "climbs", 2)]
    assert programme.still(each=True) == programme.flights()[:4]


def test_separation_is_counted_from_every_other_candidate(known: Effective) -> None:
    separations = nearest(known)
    assert set(separations) == {"linear-drag", "motor-lag"}
    assert set(separations["motor-lag"]) == set(SPACE.candidates) - {"linear-drag", "motor-lag"}
    assert separations["linear-drag"]["wind"] > separations["linear-drag"]["quadratic-drag"] > 4.2


def test_effect_of_few_tolerances_is_never_separated_by_more_sigma(known: Effective) -> None:
    """Also with flights without noise: the build deviates in the same parameters."""
    columns = list(SPACE.groups["motor-lag"])
    spike = prior_of(SPACE).spike[columns]
    z = known.z.copy()
    z[columns] = 2.0 * spike
    endless = replace(known, z=z, gram=1e12 * known.gram)
    separated = nearest(endless)["motor-lag"].values()
    assert max(separated) == pytest.approx(2.0 * np.sqrt(len(columns)), rel=1e-3)


def test_an_effect_that_depends_on_noise_has_an_effective_size_in_still_air(tmp_path: Path) -> None:
    programme = replace(BLIND, learning=("quick",), held_out=())
    world = PlannedWorld(name="w", kind_class="single", kinds=("dead-zone",), seed=8, turbulence=1.0)
    fly_and_seal(world, tmp_path, plan_references(tmp_path, "research", programme), "research", programme)
    truth = read_json(tmp_path / TRUTH)
    found = fitted((tmp_path, truth), truth["effects"])
    width = truth["effects"]["dead-zone"]["width"]
    assert found.true()["dead-zone"]["width"] == pytest.approx(width, rel=0.3)
    assert 0.0 < found.bound_sd("dead-zone", "width") < 0.2 * width


def test_the_build_deviates_in_no_parameter_of_a_drawn_effect(flown: Flown) -> None:
    """The plant takes the effect's values in place of the deviations, so both must not be added."""
    drawn = flown[1]["effects"]
    folder, truth = flown
    far = {**truth["deviations"], **{f"linear-drag.{key}": 9.0 for key in drawn["linear-drag"]}}
    assert fitted((folder, {**truth, "deviations": far}), drawn).true() == fitted(flown, drawn).true()


def test_what_the_library_lacks_has_no_effective_parameters(flown: Flown) -> None:
    assert fitted(flown, {"blade-flapping": {"moment": 2.0}}).true() == {}
