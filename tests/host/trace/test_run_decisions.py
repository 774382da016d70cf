"""What a trace decides beside its verdict: which logs, which candidates, which set, and what is named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from trimtab.host.trace.verdict import SOMETHING

from tests.host.trace.builders import (
    VEHICLE,
    build_closed_fit,
    build_diagnosis,
    build_effect,
    build_fit,
    build_flight,
    build_parameter,
    build_repeat,
    build_search_result,
    build_space,
    weights_of_nothing,
)
from trimtab.host.errors import UsageError
from trimtab.host.log.errors import TooLittleData
from trimtab.host.trace import run as module
from trimtab.host.trace.assembly import _named
from trimtab.host.trace.data.logs import _observable, check_logs
from trimtab.host.trace.flight_fit.fit import FlightFit, FlightFitter
from trimtab.host.trace.parameters import MASS, ParameterSpace
from trimtab.host.trace.residual.unexplained import Repeat
from trimtab.host.trace.run import FAULT, SAG_SEEN, WEIGHED
from trimtab.host.trace.search import WITHIN_NATS, Names, SearchResult
from trimtab.host.trace.selection import _is_judged, _without_faults
from trimtab.host.vehicle import Vehicle

BELOW, ABOVE = 1 - 1e-6, 1 + 1e-6
OTHER = VEHICLE.replace(mass_kg=0.8)


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
def test_check_logs_that_belong_together_is_their_vehicle(
    used: list[dict[str, Any]], held_out: list[dict[str, Any]]
) -> None:
    flights = [build_flight(f"used-{k}", **each) for k, each in enumerate(used)]
    others = [build_flight(f"held-{k}", **each) for k, each in enumerate(held_out)]
    assert check_logs(flights, others, None) == VEHICLE


def test_check_logs_against_a_given_vehicle_is_that_vehicle() -> None:
    flight = build_flight("one", vehicle=OTHER)
    assert check_logs([flight], [], OTHER) is OTHER
    with pytest.raises(UsageError, match=r"one\.mcap.*mass_kg"):
        check_logs([flight], [], VEHICLE)


BARE = {"poses": 99}
WRONG = [
    pytest.param([build_flight("a"), build_flight("b", vehicle=OTHER)], [], "b", "mass_kg", id="vehicle"),
    pytest.param(
        [build_flight("a")], [build_flight("b", vehicle=OTHER)], "b", "mass_kg", id="held-out-vehicle"
    ),
    pytest.param([build_flight("a"), build_flight("a")], [], "a", "a.mcap", id="twice"),
    pytest.param([build_flight("a")], [build_flight("a")], "a", "a.mcap", id="held-out-and-used"),
    pytest.param(
        [build_flight("a")], [build_flight("b"), build_flight("b")], "b", "b.mcap", id="held-out-twice"
    ),
    pytest.param(
        [build_flight("a", reference_id="ref-17")],
        [build_flight("b", reference_id="s"), build_flight("c", reference_id="ref-17")],
        "c",
        "ref-17",
        id="reference-used",
    ),
    pytest.param(
        [build_flight("a"), build_flight("a", vehicle=OTHER)], [], "a", "mass_kg", id="vehicle-before-twice"
    ),
    pytest.param([build_flight("a"), build_flight("a", **BARE)], [], "a", "a.mcap", id="twice-before-poses"),
    pytest.param(
        [build_flight("a"), build_flight("b", vehicle=OTHER, **BARE)],
        [],
        "b",
        "mass_kg",
        id="vehicle-before-poses",
    ),
]


@pytest.mark.parametrize(("flights", "held_out", "log", "mentioned"), WRONG)
def test_check_logs_that_do_not_belong_together_is_a_usage_error(
    flights: list[Any], held_out: list[Any], log: str, mentioned: str
) -> None:
    with pytest.raises(UsageError) as caught:
        check_logs(flights, held_out, None)
    assert str(caught.value).startswith(f"{log}.mcap")
    assert mentioned in str(caught.value)


@pytest.mark.parametrize(
    ("flights", "held_out", "log"),
    [
        pytest.param([build_flight("a", **BARE)], [], "a", id="used"),
        pytest.param([build_flight("a")], [build_flight("b", **BARE)], "b", id="held-out"),
        pytest.param(
            [build_flight("a", reference_id="r")],
            [build_flight("b", reference_id="r", **BARE)],
            "b",
            id="poses-before-reference",
        ),
        pytest.param([replace(build_flight("a"), tracking=None)], [], "a", id="no-tracking"),
    ],
)
def test_check_logs_without_poses_or_tracking_is_too_little_data(
    flights: list[Any], held_out: list[Any], log: str
) -> None:
    with pytest.raises(TooLittleData) as caught:
        check_logs(flights, held_out, None)
    assert str(caught.value).startswith(f"{log}.mcap")


SAG = {name: build_effect(name) for name in ("battery-sag", "drag")}


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
def test_observable_is_a_sag_only_where_a_battery_left_full_voltage(
    ratios: list[list[float] | None], observable: bool
) -> None:
    flights = [build_flight(str(k), voltage_ratio=each) for k, each in enumerate(ratios)]
    assert set(_observable(SAG, flights)) == ({"battery-sag", "drag"} if observable else {"drag"})


def test_observable_of_a_library_without_sag_is_that_library() -> None:
    drag = {"drag": SAG["drag"]}
    assert _observable(drag, [build_flight(voltage_ratio=[1.0, 0.9])]) == drag
    assert _observable({}, [build_flight()]) == {}


@pytest.mark.parametrize("kind", ["search", "diagnosis"])
@pytest.mark.parametrize(
    ("kept", "none", "judged"),
    [
        pytest.param(("drag",), 0.0, True, id="kept"),
        pytest.param(("drag",), 0.9, True, id="kept-though-nothing-is-probable"),
        pytest.param((), 0.0, False, id="nothing-kept-impossible"),
        pytest.param((), SOMETHING * BELOW, False, id="nothing-kept-just-below"),
        pytest.param((), SOMETHING, False, id="nothing-kept-at"),
        pytest.param((), SOMETHING * ABOVE, True, id="nothing-kept-just-above"),
    ],
)
def test_abstention_is_judged_by_what_was_kept_unless_nothing_is_improbable(
    kept: Names, none: float, judged: bool, kind: str
) -> None:
    weights = weights_of_nothing(none, ("drag",))
    found = (
        build_search_result(build_closed_fit(kept), weights=weights)
        if kind == "search"
        else build_diagnosis(kept, weights=weights)
    )
    assert _is_judged(found) == judged


class KnownLoopFitter:
    """Stand in for the closed-loop fitter; record what it fits."""

    loop = None
    order = 3

    def __init__(self, space: ParameterSpace) -> None:
        self.space = space
        self.calls: list[tuple[Names, FlightFit]] = []

    def fit(self, effects: Names, start: FlightFit) -> FlightFit:
        self.calls.append((tuple(effects), start))
        return build_closed_fit(tuple(effects))


SWINGING = build_space(build_effect("payload", memory=2), "drag", "gain")
BOTH = build_closed_fit(("drag", "payload"), log_evidence=100.0)


def without_faults(
    monkeypatch: pytest.MonkeyPatch,
    found: SearchResult[FlightFit],
    left: Repeat | None,
) -> tuple[SearchResult[FlightFit], KnownLoopFitter]:
    """Return the search result where whole flights repeat by `left`, and the fitter that was used."""
    monkeypatch.setattr(module, "repeat", lambda loop, z, order, twins: left)
    fitter = KnownLoopFitter(SWINGING)
    return _without_faults(found, cast(FlightFitter, fitter), [(0, 1)]), fitter


def nats(value: float) -> Repeat:
    """Return what repeats of whole flights, worth so many nats."""
    made = build_repeat(share=value / 500.0, z=100.0, size=1000)
    assert made.nats == pytest.approx(value)
    return made


NOT_SURE = build_repeat(share=10.0, z=2.9, size=1000)


@pytest.mark.parametrize(
    ("gap", "left", "reduced"),
    [
        pytest.param(WITHIN_NATS * BELOW, None, True, id="no-twins-just-within"),
        pytest.param(WITHIN_NATS * ABOVE, None, False, id="no-twins-just-beyond"),
        pytest.param(WITHIN_NATS * ABOVE, NOT_SURE, False, id="repeats-by-chance"),
        pytest.param(WITHIN_NATS * BELOW, nats(1.0), True, id="repeats-a-little-just-within"),
        pytest.param(WITHIN_NATS * ABOVE, nats(1.0), False, id="repeats-a-little-just-beyond"),
        pytest.param(FAULT * 400.0 * BELOW, nats(400.0), True, id="repeats-much-just-within"),
        pytest.param(FAULT * 400.0 * ABOVE, nats(400.0), False, id="repeats-much-just-beyond"),
    ],
)
def test_without_faults_a_swinging_effect_leaves_others_out_that_explain_little_of_what_repeats(
    monkeypatch: pytest.MonkeyPatch, gap: float, left: Repeat | None, reduced: bool
) -> None:
    found = build_search_result(BOTH, sets={BOTH.effects: 100.0, ("payload",): 100.0 - gap, (): -1e6})
    kept, fitter = without_faults(monkeypatch, found, left)
    if reduced:
        assert kept.best.effects == ("payload",)
        assert fitter.calls == [(("payload",), BOTH)]
        assert (kept.sets, kept.weights) == (found.sets, found.weights)
    else:
        assert kept is found
        assert fitter.calls == []


def test_without_faults_of_a_set_that_does_not_swing_is_unchanged(monkeypatch: pytest.MonkeyPatch) -> None:
    best = build_closed_fit(("drag", "gain"), log_evidence=100.0)
    found = build_search_result(best, sets={best.effects: 100.0, ("drag",): 100.0})
    kept, fitter = without_faults(monkeypatch, found, nats(1e6))
    assert kept is found
    assert fitter.calls == []


def test_without_faults_of_nothing_kept_is_unchanged(monkeypatch: pytest.MonkeyPatch) -> None:
    found = build_search_result(build_closed_fit(), sets={(): 0.0, ("payload",): 50.0})
    assert without_faults(monkeypatch, found, nats(1e6))[0] is found


def test_without_faults_another_set_of_the_same_size_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    found = build_search_result(BOTH, sets={BOTH.effects: 100.0, ("gain", "payload"): 101.0})
    assert without_faults(monkeypatch, found, nats(1e6))[0] is found


GAIN = build_effect("thrust-gain", build_parameter("gain", neutral=1.0, typical=0.1, tolerance=0.01))
WEIGHT = build_effect(MASS, build_parameter("factor", neutral=1.0, typical=0.1, tolerance=0.01))
TILT = build_effect("tilt", build_parameter("x", typical=0.5), build_parameter("y", neutral=3.0))
ROTORS = build_effect("rotor", *(build_parameter(f"loss_{k}", typical=0.2) for k in (1, 2, 3)), one_of=True)
NAMEABLE = build_space(GAIN, WEIGHT, TILT, ROTORS, "drag")
"""Columns: thrust-gain.gain, mass.factor, tilt.x, tilt.y, rotor.loss_1 to 3, drag.size."""
Z = (-0.5, 0.2, 2.0, -1.0, 0.5, 0.6, 0.7, 4.0)
COVARIANCE = np.diag([0.04, 0.01, 0.09, 0.16, 1.0, 4.0, 9.0, 0.25])
COVARIANCE[0, 1] = COVARIANCE[1, 0] = 0.012
INCLUSION = {"thrust-gain": 0.97, "tilt": 0.8, "rotor.loss_2": 0.6, "drag": 0.55}


def named(
    kept: Names, aliases: Mapping[str, Mapping[str, float]] | None = None, vehicle: Vehicle = VEHICLE
) -> Sequence[Any]:
    best = build_fit(kept, z=Z, covariance=COVARIANCE)
    diagnosis = build_diagnosis(kept, inclusion=INCLUSION, best=best)
    return _named(vehicle, NAMEABLE, diagnosis, aliases or {name: {} for name in kept})


def of_mass_tolerance(tolerance: float | None) -> Vehicle:
    """Return the vehicle with this tolerance of its mass, or without an entry for it."""
    others = {key: value for key, value in VEHICLE.tolerances.items() if not key.startswith(MASS)}
    return VEHICLE.replace(tolerances=others if tolerance is None else {**others, "mass.factor": tolerance})


@pytest.mark.parametrize(
    ("kept", "name", "expected"),
    [
        pytest.param("thrust-gain", "thrust-gain", {"gain": (0.95, 0.02)}, id="one-parameter"),
        pytest.param("tilt", "tilt", {"x": (1.0, 0.15), "y": (2.0, 0.4)}, id="two-parameters"),
        pytest.param("rotor.loss_2", "rotor", {"loss_2": (0.12, 0.4)}, id="one-of-several"),
    ],
)
def test_named_effect_has_physical_values_with_standard_deviations(
    kept: str, name: str, expected: dict[str, tuple[float, float]]
) -> None:
    (found,) = named((kept,))
    assert found.name == name
    assert found.title == NAMEABLE.effects[name].title
    assert found.probability == INCLUSION[kept]
    values = {key: (value.value, value.sd) for key, value in found.parameters.items()}
    assert set(values) == set(expected)
    for key, pair in expected.items():
        assert values[key] == pytest.approx(pair)
        assert found.parameters[key].unit == "1"


def test_named_effects_are_the_kept_ones_in_their_order() -> None:
    assert [found.name for found in named(("drag", "rotor.loss_2", "tilt"))] == ["drag", "rotor", "tilt"]
    assert named(()) == ()


def test_named_effect_adds_up_aliases_that_are_one_effect() -> None:
    aliases = {"tilt": {"rotor.loss_1": 0.1, "drag": 0.2, "rotor.loss_3": 0.15}, "drag": {}}
    tilt, drag = named(("tilt", "drag"), aliases)
    assert tilt.aliases == pytest.approx({"rotor": 0.25, "drag": 0.2})
    assert drag.aliases == {}


@pytest.mark.parametrize(
    ("tolerance", "alias"),
    [
        pytest.param(None, True, id="the-default"),
        pytest.param(0.1, True, id="not-weighed"),
        pytest.param(WEIGHED, True, id="at"),
        pytest.param(WEIGHED * BELOW, False, id="just-weighed"),
        pytest.param(0.001, False, id="weighed-well"),
    ],
)
def test_named_thrust_gain_has_the_mass_for_an_alias_unless_the_vehicle_was_weighed(
    tolerance: float | None, alias: bool
) -> None:
    aliases = {"thrust-gain": {"drag": 0.2}, "tilt": {}}
    gain, tilt = named(("thrust-gain", "tilt"), aliases, of_mass_tolerance(tolerance))
    assert gain.aliases == ({"drag": 0.2, MASS: INCLUSION["thrust-gain"]} if alias else {"drag": 0.2})
    assert (gain.exact_alias is not None) == alias
    assert (tilt.aliases, tilt.exact_alias) == ({}, None)


def test_named_thrust_gain_mentions_thrust_over_mass_with_two_standard_deviations() -> None:
    (gain,) = named(("thrust-gain",), vehicle=of_mass_tolerance(0.1))
    # Relative errors of a ratio: sd 0.02 of 0.95, sd 0.01 of 1.02, covariance 0.012 * 0.1 * 0.1.
    ratio = 0.95 / 1.02
    relative = np.sqrt((0.02 / 0.95) ** 2 + (0.01 / 1.02) ** 2 - 2.0 * 0.00012 / (0.95 * 1.02))
    assert gain.exact_alias is not None
    assert f"{ratio:.4f}" in gain.exact_alias
    assert f"{2.0 * ratio * relative:.4f}" in gain.exact_alias
