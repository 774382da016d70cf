"""Shortfalls of tracking that prevent the search of whole flights."""

from __future__ import annotations

import pytest

from tests.host.trace.builders import build_flight
from tests.narrowing import not_none
from trimtab.host.log import Flight
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.decision.decide import tracking_shortfall
from trimtab.host.trace.decision.findings import Code, Finding
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.flight_fit.loop import amount_of_tracking
from trimtab.host.trace.sentences import sentence

BELOW, ABOVE = 1 - 1e-6, 1 + 1e-6
MS = 1e-3
MM = 1e-3
MIN_S, HOVER_M, SLOW_S = RULES.flight_fit_min_s, RULES.hover_extent_m, RULES.flight_fit_pose_s
INTERVAL_S = 0.02


def shortfall_of(flights: list[Flight]) -> Finding | None:
    """Return why these flights cannot be fitted whole."""
    return tracking_shortfall(*amount_of_tracking([FlightData.of(each) for each in flights]))


def code_of(finding: Finding | None) -> Code | None:
    return None if finding is None else finding.code


@pytest.mark.parametrize(
    ("tracked_s", "short"),
    [
        pytest.param((MIN_S - MS,), True, id="one-just-below"),
        pytest.param((MIN_S + MS,), False, id="one-just-above"),
        pytest.param((MIN_S / 2, MIN_S / 2 - MS), True, id="two-just-below-in-all"),
        pytest.param((MIN_S / 2, MIN_S / 2 + MS), False, id="two-just-above-in-all"),
        pytest.param((1.0, MIN_S), False, id="a-short-one-beside-a-long-one"),
    ],
)
def test_shortfall_counts_the_tracking_time_of_all_flights(tracked_s: tuple[float, ...], short: bool) -> None:
    flights = [build_flight(str(k), tracked_s=each) for k, each in enumerate(tracked_s)]
    assert amount_of_tracking([FlightData.of(each) for each in flights])[0] == pytest.approx(
        sum(tracked_s), abs=1e-6
    )
    assert code_of(shortfall_of(flights)) == (Code.TRACKING_TOO_SHORT if short else None)


@pytest.mark.parametrize(
    ("extents_m", "hovered"),
    [
        pytest.param((0.0,), True, id="still"),
        pytest.param((HOVER_M - MM,), True, id="just-below"),
        pytest.param((HOVER_M + MM,), False, id="just-above"),
        pytest.param((0.0, 0.1), True, id="two-hovers"),
        pytest.param((0.0, HOVER_M + MM), False, id="the-second-moves"),
        pytest.param((HOVER_M + MM, 0.0), False, id="the-first-moves"),
    ],
)
def test_shortfall_is_a_hover_if_no_flight_moves(extents_m: tuple[float, ...], hovered: bool) -> None:
    flights = [build_flight(str(k), tracked_s=20.0, extent_m=each) for k, each in enumerate(extents_m)]
    assert amount_of_tracking([FlightData.of(each) for each in flights])[1] == pytest.approx(max(extents_m))
    assert code_of(shortfall_of(flights)) == (Code.HOVER_ONLY if hovered else None)


def test_tracking_extent_counts_only_motion_while_tracked() -> None:
    flights = [build_flight(tracked_s=20.0, extent_m=0.1, elsewhere_m=5.0)]
    tracking = amount_of_tracking([FlightData.of(each) for each in flights])
    assert tracking == pytest.approx((20.0, 0.1, INTERVAL_S))
    assert code_of(shortfall_of(flights)) is Code.HOVER_ONLY


@pytest.mark.parametrize(
    ("tracking_s", "extent_m", "expected"),
    [
        pytest.param(0.0, 0.0, Code.TRACKING_TOO_SHORT, id="nothing"),
        pytest.param(MIN_S * BELOW, 9.0, Code.TRACKING_TOO_SHORT, id="time-just-below"),
        pytest.param(MIN_S, 9.0, None, id="time-at"),
        pytest.param(MIN_S * ABOVE, 9.0, None, id="time-just-above"),
        pytest.param(99.0, HOVER_M * BELOW, Code.HOVER_ONLY, id="extent-just-below"),
        pytest.param(99.0, HOVER_M, None, id="extent-at"),
        pytest.param(99.0, HOVER_M * ABOVE, None, id="extent-just-above"),
        pytest.param(MIN_S * BELOW, HOVER_M * BELOW, Code.TRACKING_TOO_SHORT, id="time-before-extent"),
    ],
)
def test_tracking_shortfall_needs_time_then_extent(
    tracking_s: float, extent_m: float, expected: Code | None
) -> None:
    assert code_of(tracking_shortfall(tracking_s, extent_m, INTERVAL_S)) == expected


@pytest.mark.parametrize(
    ("extent_m", "interval_s", "expected"),
    [
        pytest.param(9.0, SLOW_S, None, id="at"),
        pytest.param(9.0, SLOW_S * ABOVE, Code.POSES_TOO_SLOW, id="just-above"),
        pytest.param(0.0, SLOW_S * ABOVE, Code.HOVER_ONLY, id="extent-first"),
    ],
)
def test_whole_flights_need_a_pose_in_each_bin(
    extent_m: float, interval_s: float, expected: Code | None
) -> None:
    assert code_of(tracking_shortfall(99.0, extent_m, interval_s)) == expected


@pytest.mark.parametrize("extent_m", [0.0, 1.0], ids=["hover", "manoeuvre"])
def test_shortfall_of_tracking_time_is_reported_before_a_hover(extent_m: float) -> None:
    finding = shortfall_of([build_flight(tracked_s=3.4, extent_m=extent_m)])
    assert finding is not None
    assert (finding.code, finding.bound, finding.unit) == (Code.TRACKING_TOO_SHORT, MIN_S, "s")
    assert finding.value == pytest.approx(3.4)
    assert "3.4 s" in sentence(finding)


def test_shortfall_of_a_long_hover_holds_its_extent_and_mentions_no_time() -> None:
    finding = not_none(shortfall_of([build_flight(tracked_s=23.4, extent_m=0.0)]))
    assert finding == Finding(code=Code.HOVER_ONLY, value=0.0, bound=HOVER_M, unit="m")
    assert "23.4" not in sentence(finding)
