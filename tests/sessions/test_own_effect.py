"""A cause outside the library is traced once the workspace has the page's one file about it."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "guide" / "workspace.md"
TRUTH = {"stiffness": 0.6, "slack_m": 0.8, "north_m": 0.4, "east_m": -0.3}
"""Of the shipped world `tether`, whose line also has a damper, and a corner where it comes taut."""

ROUTES = {
    "rounds": [[0, 0, -1.5], [2, 1.4, -1.5], [2, -1.4, -1.5], [0, 0, -1.4], [-2, 1.4, -1.5], [0, 0, -1.5]],
    "climbs": [[-2, -1.8, -1.2], [2.2, 0.6, -2.6], [-1.4, 2.2, -0.9], [0.6, -2.4, -2.4], [2, 1.8, -0.7]],
    "unseen": [[1.5, -1, -0.9], [-1.5, 0.5, -2.2], [0.5, 2.2, -1.1], [0.4, -1.8, -1.6], [-1, -0.5, -1.2]],
}
FLIGHTS = {"rounds": (1, 2), "climbs": (3, 4), "unseen": (5,)}


@pytest.mark.long
@pytest.mark.full
def test_tether_is_outside_the_library_until_the_workspace_has_its_file(
    trimtab: Callable[..., dict[str, Any]], tmp_path: Path
) -> None:
    logs: dict[str, list[str]] = {}
    for name, waypoints in ROUTES.items():
        route = f'name = "{name}"\ntotal_time_s = 7.0\nwaypoints_m = {waypoints}\n'
        (tmp_path / f"{name}.toml").write_text(route)
        trimtab("plan", f"./{name}.toml", "--kind", "min-snap", "-o", f"{name}.ref")
        for flight in FLIGHTS[name]:
            words = ("--world", "tether", "--world-seed", "12", "--flight", str(flight), "--seed", "1")
            logs.setdefault(name, []).append(trimtab("fly", f"{name}.ref", *words)["log"])
    words = (*logs["rounds"], *logs["climbs"], "--hold-out", *logs["unseen"], "--no-network")

    without = trimtab("trace", *words, "-o", "without.model.toml")
    assert without["verdict"] == "outside-library"
    assert without["effects"] == []

    (effect,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(effect.splitlines()) <= 25
    (tmp_path / "effects").mkdir()
    (tmp_path / "effects" / "elastic_tether.py").write_text(effect)
    with_it = trimtab("trace", *words, "-o", "with.model.toml")
    assert with_it["verdict"] == "traced"
    (found,) = (each for each in with_it["effects"] if each["name"] == "elastic-tether")
    for key, value in TRUTH.items():
        assert found["parameters"][key]["value"] == pytest.approx(value, abs=0.1)
    before, after = (with_it[when]["position_rmse_m"] for when in ("before", "after"))
    assert without["after"]["position_rmse_m"] == pytest.approx(before)
    assert after < 0.25 * before
