"""When what is left speaks against the library: thresholds, their order, and what raises them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.host.trace.builders import build_leftover, build_repeat
from trimtab.host.trace.residual.unexplained import (
    FORCE_FLOOR,
    FORM_SHARE,
    LINE_CHANCE,
    LINE_RATIO,
    REPEAT_FORM,
    REPEAT_SHARE,
    REPEAT_Z,
    SWINGING_LINE_RATIO,
    TORQUE_FLOOR,
    WORSENED,
    WORSENED_M,
    Repeat,
)

BELOW, ABOVE = 1 - 1e-6, 1 + 1e-6
FLOOR = {"force": FORCE_FLOOR, "torque": TORQUE_FLOOR}
CHANNELS = ("force", "torque")


def repeating(name: str, size: float = 10.0, z: float = 10.0) -> dict[str, Any]:
    """Return a channel that repeats by `size` floors with the score z."""
    return {f"{name}_repeat": size * FLOOR[name], f"{name}_z": z}


def ringing(
    name: str, line: float = 20.0, chance: float = 1e-9, rms: float = 10.0, hz: float = 0.77
) -> dict[str, Any]:
    """Return a channel with a line: its ratio, chance, rms in floors, and frequency in Hz."""
    return {
        f"{name}_line": line,
        f"{name}_line_hz": hz,
        f"{name}_line_chance": chance,
        f"{name}_line_rms": rms * FLOOR[name],
    }


LOUD = build_repeat(share=1.0, z=10.0, position_m=0.0471)
CALM = build_repeat(share=0.0, z=0.0, position_m=0.0)


@pytest.mark.parametrize(
    ("repeat", "least", "nats"),
    [
        pytest.param(build_repeat(share=0.5, z=0.0), 0.0, 0.0, id="nothing"),
        pytest.param(build_repeat(share=0.5, z=REPEAT_Z), 0.0, 0.0, id="z-at"),
        pytest.param(build_repeat(share=0.6, z=REPEAT_Z * ABOVE), 0.2, 300.0, id="z-just-above"),
        pytest.param(build_repeat(share=0.5, z=4.0), 0.25, 250.0, id="two-standard-errors-down"),
        pytest.param(build_repeat(share=0.5, z=40.0), 0.475, 250.0, id="well-known"),
        pytest.param(build_repeat(share=0.5, z=40.0, size=10), 0.475, 2.5, id="few-numbers"),
        pytest.param(build_repeat(share=0.5, z=40.0, position_m=9.0), 0.475, 250.0, id="any-position"),
        pytest.param(build_repeat(share=-0.5, z=-40.0), 0.0, 0.0, id="reversed"),
    ],
)
def test_repeat_counts_two_standard_errors_down_where_its_score_is_high(
    repeat: Repeat, least: float, nats: float
) -> None:
    assert repeat.least == pytest.approx(least, rel=1e-5)
    assert repeat.nats == pytest.approx(nats, rel=1e-5)


@pytest.mark.parametrize(("share", "amplitude"), [(-0.5, 0.0), (0.0, 0.0), (0.25, 0.5), (4.0, 2.0)])
def test_repeat_amplitude_is_the_root_of_its_share(share: float, amplitude: float) -> None:
    assert build_repeat(share=share, z=10.0).amplitude == pytest.approx(amplitude)


def test_reasons_of_nothing_left_are_none() -> None:
    assert build_leftover().reasons == ()
    assert build_leftover(whole=CALM).reasons == ()


@pytest.mark.parametrize("name", CHANNELS)
@pytest.mark.parametrize(
    ("size", "z", "count"),
    [
        pytest.param(10.0, 10.0, 1, id="clear"),
        pytest.param(10.0, REPEAT_Z * BELOW, 0, id="z-just-below"),
        pytest.param(10.0, REPEAT_Z * ABOVE, 1, id="z-just-above"),
        pytest.param(BELOW, 10.0, 0, id="size-just-below"),
        pytest.param(ABOVE, 10.0, 1, id="size-just-above"),
        pytest.param(-10.0, -10.0, 0, id="reversed"),
    ],
)
def test_reasons_of_what_repeats_need_score_and_size(name: str, size: float, z: float, count: int) -> None:
    assert len(build_leftover(**repeating(name, size, z)).reasons) == count


@pytest.mark.parametrize("name", CHANNELS)
@pytest.mark.parametrize(
    ("line", "chance", "rms", "count"),
    [
        pytest.param(20.0, 0.0, 10.0, 1, id="clear"),
        pytest.param(LINE_RATIO * BELOW, 0.0, 10.0, 0, id="ratio-just-below"),
        pytest.param(LINE_RATIO * ABOVE, 0.0, 10.0, 1, id="ratio-just-above"),
        pytest.param(20.0, LINE_CHANCE * BELOW, 10.0, 1, id="chance-just-below"),
        pytest.param(20.0, LINE_CHANCE * ABOVE, 10.0, 0, id="chance-just-above"),
        pytest.param(20.0, 0.0, BELOW, 0, id="rms-just-below"),
        pytest.param(20.0, 0.0, ABOVE, 1, id="rms-just-above"),
    ],
)
def test_reasons_of_a_line_need_ratio_chance_and_size(
    name: str, line: float, chance: float, rms: float, count: int
) -> None:
    assert len(build_leftover(**ringing(name, line, chance, rms)).reasons) == count


@pytest.mark.parametrize(
    ("left", "mentioned"),
    [
        pytest.param({"force_repeat": 1.37, "force_z": 12.3}, ["1.37", "12.3"], id="force"),
        pytest.param({"torque_repeat": 4.56, "torque_z": 12.3}, ["4.56", "12.3"], id="torque"),
        pytest.param(ringing("force", line=8.9), ["force", "0.77", "8.9"], id="force-line"),
        pytest.param(ringing("torque", line=8.9), ["torque", "0.77", "8.9"], id="torque-line"),
        pytest.param({"whole": build_repeat(share=1.44, z=12.3, position_m=0.0471)},
                     ["47.1", "1.2", "12.3"], id="whole-flights"),
    ],
)  # fmt: skip
def test_reasons_mention_what_they_rest_on(left: dict[str, Any], mentioned: list[str]) -> None:
    (reason,) = build_leftover(**left).reasons
    assert [number for number in mentioned if number not in reason] == []


@pytest.mark.parametrize(
    ("whole", "expected"),
    [
        # The 47.1 mm are those of whole flights, the 0.60 m/s^2 those of the segments.
        pytest.param(None, ["0.60", "0.77"], id="no-whole-flights-segments-speak"),
        pytest.param(CALM, ["0.77"], id="calm-whole-flights-silence-what-repeats"),
        pytest.param(LOUD, ["47.1", "0.60", "0.77"], id="whole-flights-first-then-segments"),
    ],
)
def test_reasons_of_segments_follow_whole_flights_in_what_repeats_not_in_lines(
    whole: Repeat | None, expected: list[str]
) -> None:
    reasons = build_leftover(**repeating("force"), **ringing("torque"), whole=whole).reasons
    assert len(reasons) == len(expected)
    assert [number for number, reason in zip(expected, reasons, strict=True) if number not in reason] == []


def test_reasons_of_both_channels_are_told_force_first_and_what_repeats_before_lines() -> None:
    left = {**repeating("torque"), **repeating("force"), **ringing("torque", hz=0.55), **ringing("force")}
    reasons = build_leftover(**left).reasons
    wanted = ["0.60", "8.00", "0.77", "0.55"]
    assert [number for number, reason in zip(wanted, reasons, strict=True) if number not in reason] == []


# At z = 40 a twentieth is taken off the share.
@pytest.mark.parametrize(
    ("share", "z", "count"),
    [
        pytest.param(REPEAT_SHARE / 0.95 * BELOW, 40.0, 0, id="share-just-below"),
        pytest.param(REPEAT_SHARE / 0.95 * ABOVE, 40.0, 1, id="share-just-above"),
        pytest.param(10.0, REPEAT_Z * BELOW, 0, id="z-just-below"),
        pytest.param(10.0, REPEAT_Z * ABOVE, 1, id="z-just-above"),
        pytest.param(1.1 * REPEAT_SHARE, 10.0, 0, id="not-two-standard-errors-above"),
    ],
)
def test_reasons_of_whole_flights_need_a_share_that_is_known_well(share: float, z: float, count: int) -> None:
    assert len(build_leftover(whole=build_repeat(share=share, z=z)).reasons) == count


@pytest.mark.parametrize(
    ("position_m", "count"),
    [(0.02 * BELOW, 0), (0.02 * ABOVE, 1)],
    ids=["just-below", "just-above"],
)
def test_reasons_of_a_position_that_repeats_more_than_it_may(position_m: float, count: int) -> None:
    whole = build_repeat(position_m=position_m)
    assert len(build_leftover(whole=whole, position_ceiling_m=0.02).reasons) == count
    assert build_leftover(whole=whole).reasons == ()


def test_reasons_of_a_worse_position_let_segments_speak_too() -> None:
    left = build_leftover(**repeating("force"), whole=build_repeat(position_m=0.03), position_ceiling_m=0.02)
    first, second = left.reasons
    assert "30.0" in first
    assert "20.0" in first
    assert "0.60" in second


@pytest.mark.parametrize(
    ("missing", "expected"),
    [
        pytest.param({}, {}, id="nothing-missing"),
        pytest.param({"force_repeat": FORCE_FLOOR / FORM_SHARE * BELOW}, {}, id="force-just-below"),
        pytest.param({"force_repeat": 5.0}, {"force_floor": 0.5}, id="force"),
        pytest.param({"torque_repeat": TORQUE_FLOOR / FORM_SHARE * BELOW}, {}, id="torque-just-below"),
        pytest.param({"torque_repeat": 50.0}, {"torque_floor": 5.0}, id="torque"),
        pytest.param({"force_repeat": -5.0, "torque_repeat": -50.0}, {}, id="reversed"),
        pytest.param(
            {"whole": build_repeat(share=REPEAT_SHARE / REPEAT_FORM**2 * BELOW)},
            {"position_ceiling_m": WORSENED_M},
            id="share-just-below",
        ),
        pytest.param(
            {"whole": build_repeat(share=25.0)},
            {"whole_floor": 1.0, "position_ceiling_m": WORSENED_M},
            id="share",
        ),
        pytest.param(
            {"whole": build_repeat(share=-25.0)}, {"position_ceiling_m": WORSENED_M}, id="share-reversed"
        ),
        pytest.param(
            {"whole": build_repeat(position_m=WORSENED_M / WORSENED * BELOW)},
            {"position_ceiling_m": WORSENED_M},
            id="position-just-below",
        ),
        pytest.param({"whole": build_repeat(position_m=0.2)}, {"position_ceiling_m": 0.3}, id="position"),
        pytest.param(ringing("force") | ringing("torque"), {}, id="lines-raise-nothing"),
    ],
)
def test_beside_what_is_missing_the_floors_rise(missing: dict[str, Any], expected: dict[str, float]) -> None:
    floors = {
        "force_floor": FORCE_FLOOR,
        "torque_floor": TORQUE_FLOOR,
        "line_floor": LINE_RATIO,
        "whole_floor": REPEAT_SHARE,
        "position_ceiling_m": np.inf,
    }
    found = build_leftover().beside(build_leftover(**missing))
    assert {key: getattr(found, key) for key in floors} == pytest.approx(floors | expected)


def test_beside_keeps_floors_that_are_higher_already_and_all_that_is_left() -> None:
    left = build_leftover(
        **repeating("force"),
        **ringing("torque"),
        whole=LOUD,
        force_floor=7.0,
        torque_floor=8.0,
        line_floor=9.0,
        whole_floor=6.0,
    )
    found = left.beside(build_leftover(force_repeat=5.0, torque_repeat=50.0, whole=build_repeat(share=25.0)))
    assert (found.force_floor, found.torque_floor, found.line_floor, found.whole_floor) == (
        7.0,
        8.0,
        9.0,
        6.0,
    )
    assert found.whole == LOUD
    assert (found.force_repeat, found.torque_line) == (left.force_repeat, left.torque_line)


@pytest.mark.parametrize("name", CHANNELS)
@pytest.mark.parametrize(
    ("line", "swinging", "count"),
    [
        pytest.param(SWINGING_LINE_RATIO * BELOW, False, 1, id="below-without-a-swing"),
        pytest.param(SWINGING_LINE_RATIO * BELOW, True, 0, id="below-beside-a-swing"),
        pytest.param(SWINGING_LINE_RATIO * ABOVE, True, 1, id="above-beside-a-swing"),
    ],
)
def test_beside_a_swinging_effect_a_line_must_be_stronger(
    name: str, line: float, swinging: bool, count: int
) -> None:
    left = build_leftover(**ringing(name, line=line))
    assert len(left.beside(build_leftover(), swinging=swinging).reasons) == count
