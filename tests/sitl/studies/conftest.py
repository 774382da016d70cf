"""A programme short enough for tests: one route flown twice, one held out, a few seconds each."""

from __future__ import annotations

import pytest

from trimtab.sitl.studies.flights import Programme

ROUTE = """
name = "{name}"
total_time_s = 4.0
waypoints_m = [[0.0, 0.0, -1.0], [{x}, 1.0, -1.6], [-1.0, {x}, -1.2], [0.5, -0.5, -1.0]]
"""


@pytest.fixture(scope="session")
def short_programme(tmp_path_factory: pytest.TempPathFactory) -> Programme:
    folder = tmp_path_factory.mktemp("routes")
    for name, x in (("one", 1.5), ("two", -1.5)):
        (folder / f"{name}.toml").write_text(ROUTE.format(name=name, x=x))
    return Programme(routes=folder, learning=("one",), held_out=("two",))
