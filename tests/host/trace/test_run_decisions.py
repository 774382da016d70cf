"""Decisions of a trace other than its verdict: logs, candidates, selected set and named effects."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests.host.trace.builders import (
    LIBRARY,
    MASS,
    VEHICLE,
    build_channel,
    build_closed_fit,
    build_diagnosis,
    build_effect,
    build_fit,
    build_flight,
    build_flight_repeat,
    build_parameter,
    build_residual,
    build_search_result,
    build_space,
    weights_of_nothing,
)
from trimtab.host.effects import ExactAlias
from trimtab.host.trace import gathering, selection, words
from trimtab.host.trace.assembly import named_effects
from trimtab.host.trace.data.logs import observable_effects, read_logs
from trimtab.host.trace.decision.decide import segment_disagreement
from trimtab.host.trace.decision.findings import Code, LogsRefused
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.flight_fit.fit import FlightFit
from trimtab.host.trace.flight_fit.fitter import FlightFitter
from trimtab.host.trace.flight_fit.loop import Tracking
from trimtab.host.trace.flight_fit.whitening import WINDOWS
from trimtab.host.trace.gathering import gather_inputs, segment_disagreement_nats
from trimtab.host.trace.parameters import ParameterSpace, RollOutDiverged
from trimtab.host.trace.residual.unexplained import FlightRepeat, UnexplainedResidual
from trimtab.host.trace.search import Fitter, Names, SearchResult
from trimtab.host.trace.segment_fit.fit import SegmentFit
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.trace.selection import (
    Method,
    selected_set_is_judged,
    without_artefacts_of_memory,
    without_shares_of_unsupported,
)

BELOW, ABOVE = 1 - 1e-6, 1 + 1e-6
TIE_NATS, FAULT = RULES.tie_nats, RULES.least_gain_beside_memory / RULES.temper[0]
SHARE = RULES.unsupported_share
OTHER = VEHICLE.replace(mass_kg=0.8)
WEIGHED = 0.005
"""Tolerance of the mass below which the vehicle was weighed."""
SAG_SEEN = 0.01
"""Change of the voltage, as a share of the full voltage, above which sag is observable."""


@pytest.mark.parametrize(
    ("used", "held_out"),
    [
        pytest.param([{}], [], id="one"),
        pytest.param([{"reference_id": "r"}] * 3, [], id="one-reference-flown-again"),
        pytest.param([{"reference_id": "r"}], [{"reference_id": "s"}] * 2, id="another-reference-held-out"),
        pytest.param([{}], [{}], id="no-references"),
        pytest.param([{}], [{"reference_id": "r"}], id="none-used"),
        pytest.param([{"reference_id": "r"}], [{}], id="none-held-out"),
    ],
)
def test_read_logs_of_one_vehicle_returns_that_vehicle(
    used: list[dict[str, Any]], held_out: list[dict[str, Any]]
) -> None:
    flights = [build_flight(f"used-{k}", **each) for k, each in enumerate(used)]
    others = [build_flight(f"held-{k}", **each) for k, each in enumerate(held_out)]
    assert read_logs(flights, others, None).vehicle == VEHICLE


def test_read_logs_with_a_given_vehicle_returns_that_vehicle() -> None:
    flight = build_flight("one", vehicle=OTHER)
    assert read_logs([flight], [], OTHER).vehicle is OTHER
    with pytest.raises(LogsRefused, match=r"one\.mcap.*mass_kg") as caught:
        read_logs([flight], [], VEHICLE)
    assert caught.value.details == {"code": Code.MIXED_VEHICLES}


TOO_FEW = 99
"""Poses of a flight that has too few."""
WRONG = [
    pytest.param(
        [build_flight("a"), build_flight("b", vehicle=OTHER)],
        [],
        "b",
        Code.MIXED_VEHICLES,
        "mass_kg",
        id="vehicle",
    ),
    pytest.param(
        [build_flight("a")],
        [build_flight("b", vehicle=OTHER)],
        "b",
        Code.MIXED_VEHICLES,
        "mass_kg",
        id="held-out-vehicle",
    ),
    pytest.param([build_flight("a"), build_flight("a")], [], "a", Code.LOG_GIVEN_TWICE, "a.mcap", id="twice"),
    pytest.param(
        [replace(build_flight("a"), metadata={"unknown": "thrust size"})],
        [],
        "a",
        Code.UNDEFINED_UNKNOWN,
        "unknown holds size, but only",
        id="undefined-unknown",
    ),
    pytest.param(
        [build_flight("a")], [build_flight("a")], "a", Code.LOG_GIVEN_TWICE, "a.mcap", id="held-out-and-used"
    ),
    pytest.param(
        [build_flight("a")],
        [build_flight("b"), build_flight("b")],
        "b",
        Code.LOG_GIVEN_TWICE,
        "b.mcap",
        id="held-out-twice",
    ),
    pytest.param(
        [build_flight("a", reference_id="ref-17")],
        [build_flight("b", reference_id="s"), build_flight("c", reference_id="ref-17")],
        "c",
        Code.HELD_OUT_REFERENCE_USED,
        "ref-17",
        id="reference-used",
    ),
    pytest.param(
        [build_flight("a"), build_flight("a", vehicle=OTHER)],
        [],
        "a",
        Code.MIXED_VEHICLES,
        "mass_kg",
        id="vehicle-before-twice",
    ),
    pytest.param(
        [build_flight("a"), build_flight("a", poses=TOO_FEW)],
        [],
        "a",
        Code.LOG_GIVEN_TWICE,
        "a.mcap",
        id="twice-before-poses",
    ),
    pytest.param(
        [build_flight("a"), build_flight("b", vehicle=OTHER, poses=TOO_FEW)],
        [],
        "b",
        Code.MIXED_VEHICLES,
        "mass_kg",
        id="vehicle-before-poses",
    ),
]


@pytest.mark.parametrize(("flights", "held_out", "log", "code", "mentioned"), WRONG)
def test_read_logs_that_do_not_belong_together_are_refused_with_a_code(
    flights: list[Any], held_out: list[Any], log: str, code: Code, mentioned: str
) -> None:
    with pytest.raises(LogsRefused) as caught:
        read_logs(flights, held_out, None)
    assert caught.value.details == {"code": code}
    assert str(caught.value).startswith(f"{log}.mcap")
    assert mentioned in str(caught.value)


@pytest.mark.parametrize(
    ("flights", "held_out", "log", "code"),
    [
        pytest.param([build_flight("a", poses=TOO_FEW)], [], "a", Code.TOO_FEW_POSES, id="used"),
        pytest.param(
            [build_flight("a")], [build_flight("b", poses=TOO_FEW)], "b", Code.TOO_FEW_POSES, id="held-out"
        ),
        pytest.param(
            [build_flight("a", reference_id="r")],
            [build_flight("b", reference_id="r", poses=TOO_FEW)],
            "b",
            Code.TOO_FEW_POSES,
            id="poses-before-reference",
        ),
        pytest.param(
            [replace(build_flight("a"), tracking=None)], [], "a", Code.NO_TRACKING, id="no-tracking"
        ),
    ],
)
def test_read_logs_without_poses_or_tracking_is_refused(
    flights: list[Any], held_out: list[Any], log: str, code: Code
) -> None:
    with pytest.raises(LogsRefused) as caught:
        read_logs(flights, held_out, None)
    assert caught.value.details == {"code": code}
    assert str(caught.value).startswith(f"{log}.mcap")


SAG = {
    "battery-sag": build_effect("battery-sag", needs_signals={"voltage_ratio": SAG_SEEN}),
    "drag": build_effect("drag"),
}


@pytest.mark.parametrize(
    ("ratios", "observable"),
    [
        pytest.param([None], False, id="no-battery-logged"),
        pytest.param([[1.0, 1.0]], False, id="full"),
        pytest.param([[1.0, 1.0 - SAG_SEEN * BELOW]], False, id="just-not-seen"),
        pytest.param([[1.0, 1.0 - SAG_SEEN * ABOVE, 1.0]], True, id="just-seen"),
        pytest.param([[1.0, 1.0 + SAG_SEEN * ABOVE]], True, id="above-full"),
        pytest.param([[1.0, 0.2]], False, id="no-voltage-of-this-battery"),
        pytest.param([None, [1.0, 0.9]], True, id="in-the-second-flight"),
        pytest.param([[1.0, 0.9], [1.0, 1.0]], True, id="in-the-first-flight"),
        pytest.param([], False, id="no-flight"),
    ],
)
def test_sag_is_observable_only_if_a_battery_left_full_voltage(
    ratios: list[list[float] | None], observable: bool
) -> None:
    flights = [build_flight(str(k), voltage_ratio=each) for k, each in enumerate(ratios)]
    assert set(observable_effects(SAG, flights)) == ({"battery-sag", "drag"} if observable else {"drag"})


def test_observable_effects_of_a_library_without_sag_are_unchanged() -> None:
    drag = {"drag": SAG["drag"]}
    assert observable_effects(drag, [build_flight(voltage_ratio=[1.0, 0.9])]) == drag
    assert observable_effects({}, [build_flight()]) == {}


@pytest.mark.parametrize("kind", ["search", "diagnosis"])
@pytest.mark.parametrize(
    ("effects", "none", "judged"),
    [
        pytest.param(("drag",), 0.0, True, id="selected"),
        pytest.param(("drag",), 0.9, True, id="kept-though-nothing-is-probable"),
        pytest.param((), 0.0, False, id="nothing-kept-impossible"),
        pytest.param((), RULES.alias_probability * BELOW, False, id="nothing-kept-just-below"),
        pytest.param((), RULES.alias_probability, False, id="nothing-kept-at"),
        pytest.param((), RULES.alias_probability * ABOVE, True, id="nothing-kept-just-above"),
    ],
)
def test_selected_set_is_judged_unless_it_is_empty_and_improbable(
    effects: Names, none: float, judged: bool, kind: str
) -> None:
    weights = weights_of_nothing(none, ("drag",))
    outcome = (
        build_search_result(build_closed_fit(effects), posterior_weights=weights)
        if kind == "search"
        else build_diagnosis(effects, posterior_weights=weights)
    )
    assert selected_set_is_judged(outcome) == judged


SWINGING = build_space(build_effect("payload", memory=2), "drag", "gain")


def swinging_fit(effects: Names, log_evidence: float) -> FlightFit:
    """Return a fit in which every effect is far from neutral."""
    return build_closed_fit(effects, log_evidence=log_evidence, theta_scaled=[5.0] * len(SWINGING.columns))


class KnownLoopFitter:
    """Stand-in for the flight fitter with the log evidence of each set; it records the sets that it fits."""

    loop = None
    order = len(WINDOWS)
    space = SWINGING
    prior = SWINGING.prior

    def __init__(self, log_evidence: Mapping[Names, float]) -> None:
        self.log_evidence = log_evidence
        self.calls: list[tuple[Names, FlightFit]] = []

    def fit(self, effects: Sequence[str], start: FlightFit) -> FlightFit:
        self.calls.append((tuple(effects), start))
        return swinging_fit(tuple(effects), self.log_evidence[tuple(effects)])


BOTH = swinging_fit(("drag", "payload"), 100.0)
ALL = swinging_fit(("drag", "gain", "payload"), 100.0)
FAR = {(): -1e6}


def without_faults(
    monkeypatch: pytest.MonkeyPatch,
    selected: FlightFit,
    log_evidence: Mapping[Names, float],
    residual: FlightRepeat | None,
) -> tuple[SearchResult[FlightFit], SearchResult[FlightFit], KnownLoopFitter]:
    """Return a result that selected a fit among these sets, what is left of it, and the fitter.

    residual: repeatable residual of whole flights.
    """
    monkeypatch.setattr(
        selection, "repeatability_of", lambda loop, theta_scaled, order, repeat_flights: residual
    )
    outcome = replace(
        build_search_result(selected, log_evidence={**FAR, **log_evidence}),
        inclusion_probability=dict.fromkeys(selected.effects, 1.0),
    )
    fitter = KnownLoopFitter(log_evidence)
    return outcome, without_artefacts_of_memory(outcome, cast(FlightFitter, fitter), [(0, 1)]), fitter


def nats(value: float) -> FlightRepeat:
    """Return a repeatable residual of whole flights that is worth this many nats."""
    made = build_flight_repeat(share=value / 500.0, z_score=100.0, size=1000)
    assert made.attainable_nats(RULES) == pytest.approx(value)
    return made


NOT_SURE = build_flight_repeat(share=10.0, z_score=2.9, size=1000)


@pytest.mark.parametrize(
    ("gap", "residual", "reduced"),
    [
        pytest.param(TIE_NATS * BELOW, None, True, id="no-repeats-just-within"),
        pytest.param(TIE_NATS * ABOVE, None, False, id="no-repeats-just-beyond"),
        pytest.param(TIE_NATS * ABOVE, NOT_SURE, False, id="repeats-by-chance"),
        pytest.param(TIE_NATS * BELOW, nats(1.0), True, id="repeats-a-little-just-within"),
        pytest.param(TIE_NATS * ABOVE, nats(1.0), False, id="repeats-a-little-just-beyond"),
        pytest.param(FAULT * 400.0 * BELOW, nats(400.0), True, id="repeats-much-just-within"),
        pytest.param(FAULT * 400.0 * ABOVE, nats(400.0), False, id="repeats-much-just-beyond"),
    ],
)
def test_without_artefacts_of_memory_drops_effects_that_explain_little_beside_a_swing(
    monkeypatch: pytest.MonkeyPatch, gap: float, residual: FlightRepeat | None, reduced: bool
) -> None:
    sets = {BOTH.effects: 100.0, ("payload",): 100.0 - gap}
    outcome, found, fitter = without_faults(monkeypatch, BOTH, sets, residual)
    assert fitter.calls == [(("payload",), BOTH)]
    if reduced:
        assert found.selected.effects == ("payload",)
        assert found.inclusion_probability == {"drag": RULES.open_probability, "payload": 1.0}
        assert found.log_evidence is outcome.log_evidence
        assert found.posterior_weights is outcome.posterior_weights
    else:
        assert found is outcome


@pytest.mark.parametrize(
    ("share", "reduced"),
    [pytest.param(BELOW, True, id="just-within"), pytest.param(ABOVE, False, id="beyond")],
)
def test_without_artefacts_of_memory_drops_no_more_than_an_error_of_the_swing_explains(
    monkeypatch: pytest.MonkeyPatch, share: float, reduced: bool
) -> None:
    """The payload gains 1000 nats over the best set without it."""
    gap = (TIE_NATS + RULES.memory_form_share * 1000.0) * share
    sets = {BOTH.effects: 100.0, ("payload",): 100.0 - gap, ("drag",): -900.0}
    _, found, _ = without_faults(monkeypatch, BOTH, sets, nats(1e4))
    assert found.selected.effects == (("payload",) if reduced else BOTH.effects)


@pytest.mark.parametrize(
    ("alone", "expected"),
    [
        pytest.param(100.0 - TIE_NATS * BELOW, ("payload",), id="both"),
        pytest.param(100.0 - TIE_NATS * ABOVE, ("drag", "payload"), id="the-lesser"),
    ],
)
def test_without_artefacts_of_memory_drops_one_effect_after_the_other(
    monkeypatch: pytest.MonkeyPatch, alone: float, expected: Names
) -> None:
    sets = {
        ALL.effects: 100.0,
        ("drag", "payload"): 99.5,
        ("gain", "payload"): 99.0,
        ("payload",): alone,
    }
    _, found, fitter = without_faults(monkeypatch, ALL, sets, None)
    assert found.selected.effects == expected
    assert [names for names, _ in fitter.calls] == [("gain", "payload"), ("drag", "payload"), ("payload",)]
    assert fitter.calls[-1][1].effects == ("drag", "payload")


def test_without_artefacts_of_memory_keeps_the_swing_and_what_is_not_supported_without_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Only the swing could be dropped, or leads to a set at neutral, which is not supported."""
    alone = swinging_fit(("payload",), 100.0)
    assert without_faults(monkeypatch, alone, {("payload",): 100.0}, nats(1e6))[1].selected is alone
    monkeypatch.setattr(selection, "is_supported", lambda fitter, fit: fit.effects != ("payload",))
    sets = {BOTH.effects: 100.0, ("payload",): 100.0}
    outcome, found, _ = without_faults(monkeypatch, BOTH, sets, nats(1e6))
    assert found is outcome


@pytest.mark.parametrize("effects", [(), ("drag", "gain")])
def test_without_artefacts_of_memory_of_a_set_without_swing_is_unchanged(
    monkeypatch: pytest.MonkeyPatch, effects: Names
) -> None:
    sets = {effects: 100.0, ("drag",): 100.0}
    outcome, found, fitter = without_faults(monkeypatch, swinging_fit(effects, 100.0), sets, nats(1e6))
    assert found is outcome
    assert fitter.calls == []


@pytest.mark.parametrize(
    ("gain", "better", "reduced"),
    [
        pytest.param(SHARE * 80.0 * BELOW, 80.0, True, id="gains-less-than-its-share"),
        pytest.param(SHARE * 80.0 * ABOVE, 80.0, False, id="gains-more-than-its-share"),
        pytest.param(0.0, TIE_NATS * BELOW, False, id="no-better-set"),
    ],
)
def test_without_shares_of_unsupported_drops_what_a_better_set_that_is_not_supported_leaves_open(
    gain: float, better: float, reduced: bool
) -> None:
    both = swinging_fit(("drag", "gain"), 100.0)
    sets = {both.effects: 100.0, ("drag",): 100.0 - gain, ("gain",): -1e6, ("payload",): 100.0 + better}
    outcome = replace(
        build_search_result(both, log_evidence={**FAR, **sets}),
        inclusion_probability=dict.fromkeys(both.effects, 1.0),
    )
    fitter = cast(Fitter[SegmentFit], KnownLoopFitter({**FAR, **sets}))
    found = without_shares_of_unsupported(cast(SearchResult[SegmentFit], outcome), fitter)
    if reduced:
        assert found.selected.effects == ("drag",)
        assert found.inclusion_probability == {"drag": 1.0, "gain": RULES.open_probability}
    else:
        assert found is outcome


RATIO = ExactAlias(effect=MASS, ratio="thrust over mass", remedy="weigh the vehicle")
GAIN = build_effect(
    "thrust-gain",
    build_parameter("gain", neutral=1.0, typical=0.1, tolerance=0.01),
    aliases=(MASS,),
    exact_aliases=(RATIO,),
)
TILT = build_effect("tilt", build_parameter("x", typical=0.5), build_parameter("y", neutral=3.0))
ROTORS = build_effect("rotor", *(build_parameter(f"loss_{k}", typical=0.2) for k in (1, 2, 3)), one_of=True)


def nameable(mass_tolerance: float = 0.01) -> ParameterSpace:
    """Return a parameter space for a vehicle whose mass has this tolerance."""
    factor = build_parameter(
        "factor", neutral=1.0, typical=0.1, tolerance=mass_tolerance, measured_below=WEIGHED
    )
    return build_space(GAIN, build_effect(MASS, factor), TILT, ROTORS, "drag")


NAMEABLE = nameable()
"""Columns: thrust-gain.gain, mass.factor, tilt.x, tilt.y, rotor.loss_1 to 3, drag.size."""
Z = (-0.5, 0.2, 2.0, -1.0, 0.5, 0.6, 0.7, 4.0)
COVARIANCE = np.diag([0.04, 0.01, 0.09, 0.16, 1.0, 4.0, 9.0, 0.25])
COVARIANCE[0, 1] = COVARIANCE[1, 0] = 0.012
INCLUSION = {"thrust-gain": 0.97, "tilt": 0.8, "rotor.loss_2": 0.6, "drag": 0.55}


def named(
    effects: Names,
    aliases: Mapping[str, Mapping[str, float]] | None = None,
    space: ParameterSpace = NAMEABLE,
) -> Sequence[Any]:
    best = build_fit(effects, theta_scaled=Z, covariance=COVARIANCE)
    diagnosis = build_diagnosis(effects, inclusion_probability=INCLUSION, selected=best)
    return named_effects(space, diagnosis, aliases or {name: {} for name in effects}, INCLUSION)


@pytest.mark.parametrize(
    ("candidate", "name", "expected"),
    [
        pytest.param("thrust-gain", "thrust-gain", {"gain": (0.95, 0.02)}, id="one-parameter"),
        pytest.param("tilt", "tilt", {"x": (1.0, 0.15), "y": (2.0, 0.4)}, id="two-parameters"),
        pytest.param("rotor.loss_2", "rotor", {"loss_2": (0.12, 0.4)}, id="one-of-several"),
    ],
)
def test_named_effect_has_physical_values_with_standard_deviations(
    candidate: str, name: str, expected: dict[str, tuple[float, float]]
) -> None:
    (named_effect,) = named((candidate,))
    assert named_effect.name == name
    assert named_effect.title == NAMEABLE.effects[name].title
    assert named_effect.probability == INCLUSION[candidate]
    values = {key: (value.value, value.sd) for key, value in named_effect.parameters.items()}
    assert set(values) == set(expected)
    for key, pair in expected.items():
        assert values[key] == pytest.approx(pair)
        assert named_effect.parameters[key].unit == "1"


def test_named_effects_are_the_selected_ones_in_their_order() -> None:
    assert [effect.name for effect in named(("drag", "rotor.loss_2", "tilt"))] == ["drag", "rotor", "tilt"]
    assert named(()) == ()


def test_named_effect_sums_aliases_of_the_same_effect() -> None:
    aliases = {"tilt": {"rotor.loss_1": 0.1, "drag": 0.2, "rotor.loss_3": 0.15}, "drag": {}}
    tilt, drag = named(("tilt", "drag"), aliases)
    assert tilt.aliases == pytest.approx({"rotor": 0.25, "drag": 0.2})
    assert drag.aliases == {}


@pytest.mark.parametrize(
    ("tolerance", "alias"),
    [
        pytest.param(0.09, True, id="not-weighed"),
        pytest.param(WEIGHED, True, id="at"),
        pytest.param(WEIGHED * BELOW, False, id="just-weighed"),
        pytest.param(0.001, False, id="weighed-well"),
    ],
)
def test_named_thrust_gain_has_the_mass_for_an_alias_unless_the_vehicle_was_weighed(
    tolerance: float, alias: bool
) -> None:
    aliases = {"thrust-gain": {"drag": 0.2}, "tilt": {}}
    gain, tilt = named(("thrust-gain", "tilt"), aliases, nameable(tolerance))
    assert gain.aliases == ({"drag": 0.2, MASS: INCLUSION["thrust-gain"]} if alias else {"drag": 0.2})
    assert set(gain.exact_aliases) == ({MASS} if alias else set())
    assert (tilt.aliases, tilt.exact_aliases) == ({}, {})


def test_named_thrust_gain_holds_thrust_over_mass_with_its_standard_deviation() -> None:
    (gain,) = named(("thrust-gain",))
    # Relative errors of a ratio: sd 0.02 of 0.95, sd 0.01 of 1.02, covariance 0.012 * 0.1 * 0.1.
    ratio = 0.95 / 1.02
    relative = np.sqrt((0.02 / 0.95) ** 2 + (0.01 / 1.02) ** 2 - 2.0 * 0.00012 / (0.95 * 1.02))
    observed = gain.exact_aliases[MASS]
    assert observed.alias == RATIO
    assert observed.finding.code is Code.EXACT_ALIAS
    assert observed.finding.subject == ("thrust-gain", MASS)
    assert observed.finding.value == pytest.approx(ratio)
    assert observed.finding.details == pytest.approx({"sd": ratio * relative})
    text = words.exact_alias(observed)
    assert "weigh the vehicle" in text
    assert f"{ratio:.4f}" in text
    assert f"{2.0 * ratio * relative:.4f}" in text


class KnownRefits:
    """Stand-in for `refit` with known evidence that records its calls; other sets diverge."""

    def __init__(self, evidence: Mapping[Names, float]) -> None:
        self.evidence = evidence
        self.calls: list[tuple[Names, Names]] = []

    def __call__(
        self, segment_model: SegmentModel, data: Any, effects: Names, start: SegmentFit
    ) -> SegmentFit:
        self.calls.append((tuple(effects), start.effects))
        if tuple(effects) not in self.evidence:
            raise RollOutDiverged("the model diverges")
        return build_fit(tuple(effects), log_evidence=self.evidence[tuple(effects)])


def disagreement(
    monkeypatch: pytest.MonkeyPatch, evidence: Mapping[Names, float], selected: Names
) -> tuple[dict[str, float], KnownRefits]:
    """Return the segment disagreement of each effect in nats, and the fits that were made."""
    refits = KnownRefits(evidence)
    monkeypatch.setattr(gathering, "refit", refits)
    return segment_disagreement_nats(cast(SegmentModel, None), build_fit(), selected), refits


@pytest.mark.parametrize(
    ("without", "speaks"),
    [
        pytest.param(-50.0, False, id="needed"),
        pytest.param(10.0 - TIE_NATS * ABOVE, False, id="just-confirmed"),
        pytest.param(10.0 - TIE_NATS * BELOW, True, id="just-not-confirmed"),
        pytest.param(10.0, True, id="as-good"),
        pytest.param(60.0, True, id="rejected"),
    ],
)
def test_segment_disagreement_names_an_effect_that_segments_do_not_confirm(
    monkeypatch: pytest.MonkeyPatch, without: float, speaks: bool
) -> None:
    evidence = {("drag", "gain"): 10.0, ("gain",): without, ("drag",): -50.0}
    nats, _ = disagreement(monkeypatch, evidence, ("drag", "gain"))
    assert nats == pytest.approx({"drag": without - 10.0, "gain": -60.0})
    assert [f.subject for f in segment_disagreement(nats, RULES)] == ([("drag",)] if speaks else [])


def test_segment_disagreement_compares_each_reduced_set_with_the_whole_set(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    nats, refits = disagreement(
        monkeypatch, {("drag", "gain"): 0.0, ("gain",): 1.0, ("drag",): -2.0}, ("drag", "gain")
    )
    assert nats == {"drag": 1.0, "gain": -2.0}
    assert refits.calls == [
        (("drag", "gain"), ()),
        (("gain",), ("drag", "gain")),
        (("drag",), ("drag", "gain")),
    ]


@pytest.mark.parametrize(
    ("evidence", "expected", "absent"),
    [
        pytest.param({("gain",): 0.0}, {"drag": 0.0, "gain": 0.0}, [("drag", "gain")], id="the-whole-set"),
        pytest.param(
            {("drag", "gain"): 0.0, ("gain",): -50.0},
            {"drag": -50.0, "gain": -np.inf},
            [],
            id="a-reduced-set",
        ),
    ],
)
def test_a_set_whose_model_diverges_is_confirmed_by_no_segment(
    monkeypatch: pytest.MonkeyPatch,
    evidence: Mapping[Names, float],
    expected: dict[str, float],
    absent: list[Names],
) -> None:
    nats, _ = disagreement(monkeypatch, evidence, ("drag", "gain"))
    assert nats == expected
    assert [f.subject for f in segment_disagreement(nats, RULES)] == absent


def test_segment_disagreement_of_the_empty_set_is_empty(monkeypatch: pytest.MonkeyPatch) -> None:
    assert disagreement(monkeypatch, {(): 0.0}, ())[0] == {}


AFTER, BEFORE = (
    build_flight_repeat(share=0.1, z_score=4.0),
    build_flight_repeat(share=5.0, z_score=50.0),
)
ASKED = {"drag": 1.5}
LATE = {"a.mcap": 0.1}


@pytest.fixture
def inputs_of(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Return a function that gathers the inputs of a diagnosis whose residuals are known without a fit."""

    def residual(w: str, data: Any, repeat_flights: Sequence[Any], *, axial: bool) -> UnexplainedResidual:
        lines = {"selected": 1.0, "nothing": 2.0}
        return build_residual(force=build_channel(repeat=lines[w] + 10.0 * axial), pairs=len(repeat_flights))

    monkeypatch.setattr(gathering, "unexplained_residual", residual)
    monkeypatch.setattr(gathering, "_remainder", lambda segment_model, diagnosis: ("selected", None))
    monkeypatch.setattr(gathering, "disturbance_left", lambda fit, theta_scaled: "nothing")
    monkeypatch.setattr(gathering, "theta_without_effects", lambda space, nothing: None)
    monkeypatch.setattr(gathering, "segment_disagreement_nats", lambda segment_model, nothing, effects: ASKED)

    def gather(
        selected: Names = ("drag",),
        *,
        method: Method = "closed-loop",
        repeat_flights: Sequence[tuple[int, int]] = (),
        unknown: frozenset[str] = frozenset(),
        best: SegmentFit | None = None,
    ) -> Any:
        diagnosis = build_diagnosis(
            selected,
            posterior_weights={selected: 3.0, ("gain",): 1.0},
            inclusion_probability={"drag": 0.7},
            detectability={"lag": 2.0},
            selected=best or build_fit(selected),
            method=method,
            repeatability=(AFTER, BEFORE),
        )
        segment_model = cast(SegmentModel, SimpleNamespace(space=LIBRARY))
        tracking = Tracking(12.0, 1.5, 0.02)
        return gather_inputs(segment_model, diagnosis, repeat_flights, unknown, tracking, LATE)

    return gather


@pytest.mark.parametrize(
    ("selected", "method", "repeat_flights", "asked"),
    [
        pytest.param(("drag",), "closed-loop", [], True, id="closed-loop-without-repeats"),
        pytest.param(("drag",), "closed-loop", [(0, 1)], False, id="closed-loop-with-repeats"),
        pytest.param(("drag",), "segments", [], False, id="segments-without-repeats"),
        pytest.param(("drag",), "segments", [(0, 1)], False, id="segments-with-repeats"),
        pytest.param((), "closed-loop", [], False, id="nothing-selected"),
    ],
)
def test_evidence_compares_segments_only_for_flight_fits_without_repeats(
    inputs_of: Any, selected: Names, method: Method, repeat_flights: Any, asked: bool
) -> None:
    inputs = inputs_of(selected, method=method, repeat_flights=repeat_flights)
    assert inputs.segment_disagreement_nats == (ASKED if asked else {})
    assert inputs.by_segments == (method == "segments")
    assert inputs.has_repeats == bool(repeat_flights)


def test_inputs_hold_the_diagnosis_and_both_residuals(inputs_of: Any) -> None:
    best = build_fit(("drag",), lateral=0.2, axial=0.3, angular=0.4)
    inputs = inputs_of(("drag",), repeat_flights=[(0, 1), (2, 3)], best=best)
    assert inputs.selected == ("drag",)
    assert inputs.null_probability == 0.0
    assert inputs.posterior_weights == {("drag",): 3.0, ("gain",): 1.0}
    assert inputs.inclusion_probability == {"drag": 0.7}
    assert inputs.detectability == {"lag": 2.0}
    assert (inputs.tracking_s, inputs.extent_m, inputs.pose_interval_s) == (12.0, 1.5, 0.02)
    assert inputs.disturbance_sigma == pytest.approx((0.2, 0.2, 0.3, 0.4, 0.4, 0.4))
    assert (inputs.residual.flight_repeat, inputs.residual_without.flight_repeat) == (AFTER, BEFORE)
    assert (inputs.residual.force.repeat, inputs.residual_without.force.repeat) == (11.0, 12.0)
    assert (inputs.residual.pairs, inputs.residual_without.pairs) == (2, 2)


@pytest.mark.parametrize(
    ("unknown", "known"), [(frozenset(), True), (frozenset({"thrust"}), False), (frozenset({"torque"}), True)]
)
def test_evidence_without_a_known_thrust_leaves_out_the_axial_force(
    inputs_of: Any, unknown: frozenset[str], known: bool
) -> None:
    inputs = inputs_of(unknown=unknown)
    assert inputs.thrust_known == known
    assert (inputs.residual.force.repeat, inputs.residual_without.force.repeat) == (
        (11.0, 12.0) if known else (1.0, 2.0)
    )


@pytest.mark.parametrize("rate_driven", [False, True])
def test_evidence_states_whether_the_measured_rate_drives_the_attitude(
    inputs_of: Any, rate_driven: bool
) -> None:
    assert inputs_of().late_share == LATE
    assert inputs_of(best=build_fit(("drag",), rate_driven=rate_driven)).rate_driven == rate_driven
