"""Whether flights are enough to be searched as whole flights."""

from __future__ import annotations

import pytest

from tests.host.trace.builders import build_flight
from trimtab.host.trace.flight_fit.loop import LEAST_S, MOVED_M, too_little

MS = 1e-3
MM = 1e-3


@pytest.mark.parametrize(
    ("tracked_s", "short"),
    [
        pytest.param((LEAST_S - MS,), True, id="one-just-below"),
        pytest.param((LEAST_S + MS,), False, id="one-just-above"),
        pytest.param((LEAST_S / 2, LEAST_S / 2 - MS), True, id="two-just-below-in-all"),
        pytest.param((LEAST_S / 2, LEAST_S / 2 + MS), False, id="two-just-above-in-all"),
        pytest.param((1.0, LEAST_S), False, id="a-short-one-beside-a-long-one"),
    ],
)
def test_too_little_tracking_in_all_is_said(tracked_s: tuple[float, ...], short: bool) -> None:
    flights = [build_flight(str(k), tracked_s=each) for k, each in enumerate(tracked_s)]
    assert (too_little(flights) is not None) == short


@pytest.mark.parametrize(
    ("extents_m", "hovered"),
    [
        pytest.param((0.0,), True, id="still"),
        pytest.param((MOVED_M - MM,), True, id="just-below"),
        pytest.param((MOVED_M + MM,), False, id="just-above"),
        pytest.param((0.0, 0.1), True, id="two-hovers"),
        pytest.param((0.0, MOVED_M + MM), False, id="the-second-moves"),
        pytest.param((MOVED_M + MM, 0.0), False, id="the-first-moves"),
    ],
)
def test_too_little_motion_of_every_flight_is_said(extents_m: tuple[float, ...], hovered: bool) -> None:
    flights = [build_flight(str(k), tracked_s=20.0, extent_m=each) for k, each in enumerate(extents_m)]
    assert (too_little(flights) is not None) == hovered


def test_too_little_motion_counts_only_while_tracked() -> None:
    assert too_little([build_flight(tracked_s=20.0, extent_m=0.1, elsewhere_m=5.0)]) is not None


@pytest.mark.parametrize("extent_m", [0.0, 1.0], ids=["hover", "manoeuvre"])
def test_too_little_tracking_is_said_before_a_hover_with_how_much_there_is(extent_m: float) -> None:
    said = too_little([build_flight(tracked_s=3.4, extent_m=extent_m)])
    assert said is not None
    assert "3.4" in said


def test_too_little_of_a_long_hover_mentions_no_time() -> None:
    said = too_little([build_flight(tracked_s=23.4, extent_m=0.0)])
    assert said is not None
    assert "23.4" not in said
