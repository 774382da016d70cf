"""What one flight cannot decide, the flight that tracing proposes does."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

GAIN = 0.95
WORLD = f'description = "weak motors"\ntolerances = true\n\n[effects.thrust-gain]\ngain = {GAIN}\n'


@pytest.mark.full
def test_hover_leaves_thrust_undecided_and_the_proposed_flight_decides(
    trimtab: Callable[..., dict[str, Any]], tmp_path: Path
) -> None:
    """At rest motors that are weak look like a payload on a line; what moves tells them apart."""
    (tmp_path / "weak.toml").write_text(WORLD)

    def fly(route: str, index: int) -> str:
        trimtab("plan", route, "-o", f"{route}.ref")
        world = ("--world", "weak.toml", "--world-seed", "5", "--seed", str(index), "--flight", str(index))
        return trimtab("fly", f"{route}.ref", *world)["log"]

    hover = fly("hover", 1)
    first = trimtab("trace", hover)
    assert first["verdict"] == "undecided"
    following = first["next_flight"]
    # Something is missing, and this flight does not say which.
    told = [*first["possible"], *first["effects"], *(a for e in first["effects"] for a in e["aliases"])]
    assert set(following["separates"]) <= {candidate["name"] for candidate in told}
    assert "thrust-gain" in following["separates"]
    assert following["so_far_sigma"] < 4.2 <= following["expected_sigma"]
    assert following["decides"]
    assert following["total_time_s"] is None

    second = trimtab("trace", hover, fly(following["route"], 2))
    assert second["verdict"] == "traced"
    assert [effect["name"] for effect in second["effects"]] == ["thrust-gain"]
    gain = second["effects"][0]["parameters"]["gain"]
    # The world deviates by up to some tolerances of 0.4 % besides, mass among them.
    assert gain["value"] == pytest.approx(GAIN, abs=0.015)
    assert second["next_flight"] is None
