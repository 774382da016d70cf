"""Residuals with a cause outside the library: bounds, their dependencies, and the order of findings."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from typing import Any

import pytest

from tests.host.trace.builders import build_channel, build_flight_repeat, build_residual
from trimtab.host.trace.decision.findings import Code, Finding
from trimtab.host.trace.decision.residual_rules import (
    ResidualBounds,
    no_effect_bounds,
    residual_bounds,
    residual_findings,
)
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.residual.unexplained import FlightRepeat, SpectralLine, UnexplainedResidual
from trimtab.host.trace.sentences import sentence

BELOW, ABOVE = 1 - 1e-6, 1 + 1e-6
FLOOR = {"force": RULES.force_floor_m_s2, "torque": RULES.torque_floor_rad_s2}
UNIT = {"force": "m/s^2", "torque": "rad/s^2"}
REPEATS = {"force": Code.FORCE_REPEATS, "torque": Code.TORQUE_REPEATS}
RINGS = {"force": Code.FORCE_RINGS, "torque": Code.TORQUE_RINGS}
CHANNELS = ("force", "torque")
REPEAT_Z, REPEAT_SHARE = RULES.repeat_z, RULES.flight_repeat_share
LINE_RATIO, LINE_CHANCE = RULES.line_ratio, RULES.line_false_alarm
WORSENED, WORSENED_M = RULES.worsened_ratio, RULES.worsened_m


def channel(
    name: str,
    *,
    size: float = 0.0,
    z_score: float = 10.0,
    line: float = 1.0,
    chance: float = 1e-9,
    rms: float = 10.0,
    hz: float = 0.77,
) -> dict[str, Any]:
    """Return one channel by name; repeatable `size` and `rms` of the line are multiples of the floor."""
    spectral_line = SpectralLine(ratio=line, hz=hz, chance=chance, rms=rms * FLOOR[name])
    return {name: build_channel(repeat=size * FLOOR[name], z_score=z_score, line=spectral_line)}


def repeating(name: str, size: float = 10.0, z_score: float = 10.0) -> dict[str, Any]:
    """Return a channel in which `size` floors repeat with the z score z."""
    return channel(name, size=size, z_score=z_score)


def ringing(name: str, line: float = 20.0, **changes: float) -> dict[str, Any]:
    """Return a channel with a line and without a repeatable part."""
    return channel(name, line=line, **changes)


def found_in(residual: UnexplainedResidual, bounds: ResidualBounds | None = None) -> list[Finding]:
    """Return the findings by `bounds`, by default those of the model without effects."""
    return residual_findings(residual, bounds or no_effect_bounds(RULES), RULES)


def codes_in(residual: UnexplainedResidual, bounds: ResidualBounds | None = None) -> list[Code]:
    return [finding.code for finding in found_in(residual, bounds)]


LOUD = build_flight_repeat(share=1.0, z_score=10.0, position_m=0.0471)
CALM = build_flight_repeat(share=0.0, z_score=0.0, position_m=0.0)


def test_no_model_bounds_are_the_rules_without_a_position_bound() -> None:
    assert no_effect_bounds(RULES) == ResidualBounds(
        force=RULES.force_floor_m_s2,
        torque=RULES.torque_floor_rad_s2,
        line_ratio=RULES.line_ratio,
        flight_share=RULES.flight_repeat_share,
        position_m=math.inf,
    )


def test_findings_of_a_quiet_residual_are_empty() -> None:
    assert found_in(build_residual()) == []
    assert found_in(build_residual(flight_repeat=CALM)) == []
    assert found_in(build_residual(pairs=0)) == []


@pytest.mark.parametrize("name", CHANNELS)
@pytest.mark.parametrize(
    ("size", "z_score", "count"),
    [
        pytest.param(10.0, 10.0, 1, id="clear"),
        pytest.param(10.0, REPEAT_Z * BELOW, 0, id="z-just-below"),
        pytest.param(10.0, REPEAT_Z, 0, id="z-at"),
        pytest.param(10.0, REPEAT_Z * ABOVE, 1, id="z-just-above"),
        pytest.param(BELOW, 10.0, 0, id="size-just-below"),
        pytest.param(1.0, 10.0, 0, id="size-at"),
        pytest.param(ABOVE, 10.0, 1, id="size-just-above"),
        pytest.param(-10.0, -10.0, 0, id="reversed"),
        pytest.param(-10.0, 10.0, 0, id="size-reversed"),
        pytest.param(10.0, -10.0, 0, id="score-reversed"),
    ],
)
def test_repeatable_residual_of_segments_needs_z_score_and_size(
    name: str, size: float, z_score: float, count: int
) -> None:
    assert codes_in(build_residual(**repeating(name, size, z_score))) == [REPEATS[name]] * count


@pytest.mark.parametrize("name", CHANNELS)
@pytest.mark.parametrize(
    ("line", "chance", "rms", "count"),
    [
        pytest.param(20.0, 0.0, 10.0, 1, id="clear"),
        pytest.param(LINE_RATIO * BELOW, 0.0, 10.0, 0, id="ratio-just-below"),
        pytest.param(LINE_RATIO, 0.0, 10.0, 0, id="ratio-at"),
        pytest.param(LINE_RATIO * ABOVE, 0.0, 10.0, 1, id="ratio-just-above"),
        pytest.param(20.0, LINE_CHANCE * BELOW, 10.0, 1, id="chance-just-below"),
        pytest.param(20.0, LINE_CHANCE, 10.0, 0, id="chance-at"),
        pytest.param(20.0, LINE_CHANCE * ABOVE, 10.0, 0, id="chance-just-above"),
        pytest.param(20.0, 0.0, BELOW, 0, id="rms-just-below"),
        pytest.param(20.0, 0.0, 1.0, 0, id="rms-at"),
        pytest.param(20.0, 0.0, ABOVE, 1, id="rms-just-above"),
    ],
)
def test_line_needs_ratio_chance_and_size(
    name: str, line: float, chance: float, rms: float, count: int
) -> None:
    residual = build_residual(**ringing(name, line, chance=chance, rms=rms))
    assert codes_in(residual) == [RINGS[name]] * count


@pytest.mark.parametrize(
    ("residual", "expected", "mentioned"),
    [
        pytest.param(
            {"force": build_channel(repeat=1.37, z_score=12.3)},
            Finding(code=Code.FORCE_REPEATS, value=1.37, bound=0.06, unit="m/s^2", details={"z": 12.3}),
            ["force", "1.37", "12.3"],
            id="force",
        ),
        pytest.param(
            {"torque": build_channel(repeat=4.56, z_score=12.3)},
            Finding(code=Code.TORQUE_REPEATS, value=4.56, bound=0.8, unit="rad/s^2", details={"z": 12.3}),
            ["angular", "4.56", "12.3"],
            id="torque",
        ),
        pytest.param(
            ringing("force", line=8.9),
            Finding(code=Code.FORCE_RINGS, value=8.9, bound=3.5, details={"hz": 0.77}),
            ["force", "0.77", "8.9"],
            id="force-line",
        ),
        pytest.param(
            ringing("torque", line=8.9),
            Finding(code=Code.TORQUE_RINGS, value=8.9, bound=3.5, details={"hz": 0.77}),
            ["torque", "0.77", "8.9"],
            id="torque-line",
        ),
        pytest.param(
            # At z = 10, two standard errors are a fifth of the share.
            {"flight_repeat": build_flight_repeat(share=1.44, z_score=10.0, position_m=0.0471)},
            Finding(
                code=Code.FLIGHTS_REPEAT,
                value=1.44 * 0.8,
                bound=0.08,
                details={"position_m": 0.0471, "amplitude": 1.2, "z": 10.0},
            ),
            ["47.1", "1.2", "10.0"],
            id="whole-flights",
        ),
    ],
)
def test_finding_holds_value_bound_and_details(
    residual: dict[str, Any], expected: Finding, mentioned: list[str]
) -> None:
    (finding,) = found_in(build_residual(**residual))
    assert finding.to_json() == {
        **expected.to_json(),
        "value": pytest.approx(expected.value),
        "details": pytest.approx(dict(expected.details)),
    }
    text = sentence(finding)
    assert [number for number in mentioned if number not in text] == []


@pytest.mark.parametrize(
    ("flights", "expected"),
    [
        pytest.param(None, [Code.FORCE_REPEATS, Code.TORQUE_RINGS], id="no-whole-flights-segments-speak"),
        pytest.param(CALM, [Code.TORQUE_RINGS], id="calm-whole-flights-silence-what-repeats"),
        pytest.param(
            LOUD,
            [Code.FLIGHTS_REPEAT, Code.FORCE_REPEATS, Code.TORQUE_RINGS],
            id="whole-flights-first-then-segments",
        ),
    ],
)
def test_whole_flights_overrule_segments_in_repeatability_not_in_lines(
    flights: FlightRepeat | None, expected: list[Code]
) -> None:
    residual = build_residual(**repeating("force"), **ringing("torque"), flight_repeat=flights)
    assert codes_in(residual) == expected


def test_findings_list_force_first_and_repeatability_before_lines() -> None:
    residual = build_residual(
        **channel("torque", size=10.0, line=20.0, hz=0.55), **channel("force", size=10.0, line=20.0)
    )
    findings = found_in(residual)
    assert [finding.code for finding in findings] == [
        Code.FORCE_REPEATS,
        Code.TORQUE_REPEATS,
        Code.FORCE_RINGS,
        Code.TORQUE_RINGS,
    ]
    assert [findings[0].value, findings[1].value] == pytest.approx([0.6, 8.0])
    assert [findings[2].details["hz"], findings[3].details["hz"]] == [0.77, 0.55]


# At z = 40, two standard errors are a twentieth of the share.
@pytest.mark.parametrize(
    ("share", "z_score", "count"),
    [
        pytest.param(REPEAT_SHARE / 0.95 * BELOW, 40.0, 0, id="share-just-below"),
        pytest.param(REPEAT_SHARE / 0.95 * ABOVE, 40.0, 1, id="share-just-above"),
        pytest.param(10.0, REPEAT_Z * BELOW, 0, id="z-just-below"),
        pytest.param(10.0, REPEAT_Z * ABOVE, 1, id="z-just-above"),
        pytest.param(1.1 * REPEAT_SHARE, 10.0, 0, id="not-two-standard-errors-above"),
    ],
)
def test_whole_flights_need_a_significant_share(share: float, z_score: float, count: int) -> None:
    residual = build_residual(flight_repeat=build_flight_repeat(share=share, z_score=z_score))
    assert codes_in(residual) == [Code.FLIGHTS_REPEAT] * count


@pytest.mark.parametrize(
    ("position_m", "count"),
    [(0.02 * BELOW, 0), (0.02, 0), (0.02 * ABOVE, 1)],
    ids=["just-below", "at", "just-above"],
)
def test_repeatable_position_above_its_bound_counts_as_worsened(position_m: float, count: int) -> None:
    residual = build_residual(flight_repeat=build_flight_repeat(position_m=position_m))
    bounds = replace(no_effect_bounds(RULES), position_m=0.02)
    assert codes_in(residual, bounds) == [Code.FLIGHTS_WORSENED] * count
    assert codes_in(residual) == []


def test_worsened_position_also_reports_segments() -> None:
    residual = build_residual(**repeating("force"), flight_repeat=build_flight_repeat(position_m=0.03))
    worse, repeats = found_in(residual, replace(no_effect_bounds(RULES), position_m=0.02))
    assert worse == Finding(code=Code.FLIGHTS_WORSENED, value=0.03, bound=0.02, unit="m")
    assert repeats.code is Code.FORCE_REPEATS
    assert repeats.value == pytest.approx(0.6)
    assert "30.0" in sentence(worse)
    assert "20.0" in sentence(worse)
    assert "0.60" in sentence(repeats)


def test_flights_repeat_is_listed_before_flights_worsened() -> None:
    bounds = replace(no_effect_bounds(RULES), position_m=0.02)
    assert codes_in(build_residual(flight_repeat=LOUD), bounds) == [
        Code.FLIGHTS_REPEAT,
        Code.FLIGHTS_WORSENED,
    ]


@pytest.mark.parametrize(
    ("missing", "expected"),
    [
        pytest.param({}, {}, id="nothing-missing"),
        pytest.param(repeating("force", BELOW / RULES.equation_error_share), {}, id="force-just-below"),
        pytest.param({"force": build_channel(repeat=5.0)}, {"force": 0.5}, id="force"),
        pytest.param(repeating("torque", BELOW / RULES.equation_error_share), {}, id="torque-just-below"),
        pytest.param({"torque": build_channel(repeat=50.0)}, {"torque": 5.0}, id="torque"),
        pytest.param(
            {"force": build_channel(repeat=-5.0), "torque": build_channel(repeat=-50.0)}, {}, id="reversed"
        ),
        pytest.param(
            {
                "flight_repeat": build_flight_repeat(
                    share=REPEAT_SHARE / RULES.equation_error_amplitude**2 * BELOW
                )
            },
            {"position_m": WORSENED_M},
            id="share-just-below",
        ),
        pytest.param(
            {"flight_repeat": build_flight_repeat(share=25.0)},
            {"flight_share": 1.0, "position_m": WORSENED_M},
            id="share",
        ),
        pytest.param(
            {"flight_repeat": build_flight_repeat(share=-25.0)},
            {"position_m": WORSENED_M},
            id="share-reversed",
        ),
        pytest.param(
            {"flight_repeat": build_flight_repeat(position_m=WORSENED_M / WORSENED * BELOW)},
            {"position_m": WORSENED_M},
            id="position-just-below",
        ),
        pytest.param(
            {"flight_repeat": build_flight_repeat(position_m=0.2)}, {"position_m": 0.3}, id="position"
        ),
        pytest.param(ringing("force") | ringing("torque"), {}, id="lines-raise-nothing"),
    ],
)
def test_bounds_increase_with_the_residual_without_effects(
    missing: dict[str, Any], expected: dict[str, float]
) -> None:
    bounds = residual_bounds(build_residual(**missing), has_effects=True, has_memory=False, rules=RULES)
    assert asdict(bounds) == pytest.approx(asdict(no_effect_bounds(RULES)) | expected)


INEXACT = 25.0 * RULES.equation_error_amplitude**2
"""Share that may repeat if the model without effects leaves 25 and equations are inexact."""


@pytest.mark.parametrize(
    ("position_m", "has_effects", "has_memory", "expected"),
    [
        pytest.param(RULES.equation_error_m * BELOW, True, False, INEXACT, id="small"),
        pytest.param(RULES.equation_error_m * ABOVE, True, False, RULES.flight_repeat_share, id="great"),
        pytest.param(RULES.equation_error_m * ABOVE, True, True, INEXACT, id="great-beside-memory"),
        pytest.param(RULES.visible_error_m * ABOVE, True, False, INEXACT, id="visible-beside-an-effect"),
        pytest.param(RULES.visible_error_m * BELOW, False, False, INEXACT, id="too-small-to-see"),
        pytest.param(RULES.visible_error_m * ABOVE, False, False, RULES.flight_repeat_chance, id="visible"),
    ],
)
def test_great_position_error_is_no_inexact_equation_and_a_visible_one_is_an_effect(
    position_m: float, has_effects: bool, has_memory: bool, expected: float
) -> None:
    without = build_residual(flight_repeat=build_flight_repeat(share=25.0))
    bounds = residual_bounds(
        without, has_effects=has_effects, has_memory=has_memory, position_m=position_m, rules=RULES
    )
    assert bounds.flight_share == pytest.approx(expected)


def test_bounds_are_never_below_the_given_rules() -> None:
    strict = replace(
        RULES,
        force_floor_m_s2=7.0,
        torque_floor_rad_s2=8.0,
        line_ratio=9.0,
        flight_repeat_share=6.0,
        worsened_m=5.0,
    )
    without = build_residual(
        force=build_channel(repeat=5.0),
        torque=build_channel(repeat=50.0),
        flight_repeat=build_flight_repeat(share=25.0, position_m=0.2),
    )
    assert residual_bounds(without, has_effects=True, has_memory=False, rules=strict) == ResidualBounds(
        force=7.0, torque=8.0, line_ratio=9.0, flight_share=6.0, position_m=5.0
    )
    assert no_effect_bounds(strict) == ResidualBounds(force=7.0, torque=8.0, line_ratio=9.0, flight_share=6.0)


@pytest.mark.parametrize("name", CHANNELS)
@pytest.mark.parametrize(
    ("line", "has_memory", "count"),
    [
        pytest.param(RULES.line_ratio_with_memory * BELOW, False, 1, id="below-without-memory"),
        pytest.param(RULES.line_ratio_with_memory * BELOW, True, 0, id="below-beside-memory"),
        pytest.param(RULES.line_ratio_with_memory * ABOVE, True, 1, id="above-beside-memory"),
    ],
)
def test_line_must_be_stronger_with_an_effect_with_states(
    name: str, line: float, has_memory: bool, count: int
) -> None:
    bounds = residual_bounds(build_residual(), has_effects=True, has_memory=has_memory, rules=RULES)
    assert codes_in(build_residual(**ringing(name, line)), bounds) == [RINGS[name]] * count


@pytest.mark.parametrize("name", CHANNELS)
def test_line_must_exceed_the_repeatability_bound_of_its_channel(name: str) -> None:
    bounds = replace(no_effect_bounds(RULES), **{name: 20.0 * FLOOR[name]})
    assert codes_in(build_residual(**ringing(name, rms=20.0 * BELOW)), bounds) == []
    assert codes_in(build_residual(**ringing(name, rms=20.0 * ABOVE)), bounds) == [RINGS[name]]


@pytest.mark.parametrize(
    ("residual", "rule", "value"),
    [
        pytest.param(repeating("force"), "repeat_z", 11.0, id="score"),
        pytest.param({"flight_repeat": LOUD}, "repeat_z", 11.0, id="score-of-whole-flights"),
        pytest.param(ringing("force"), "line_false_alarm", 1e-10, id="chance"),
        pytest.param(ringing("force"), "line_ratio", 21.0, id="ratio"),
        pytest.param({"flight_repeat": LOUD}, "flight_repeat_share", 0.9, id="share"),
    ],
)
def test_residual_findings_use_the_given_rules(residual: dict[str, Any], rule: str, value: float) -> None:
    stricter = replace(RULES, **{rule: value})
    assert len(found_in(build_residual(**residual))) == 1
    assert residual_findings(build_residual(**residual), no_effect_bounds(stricter), stricter) == []
