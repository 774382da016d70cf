"""What a study flies."""

from __future__ import annotations

import pytest

from trimtab.host.route import list_routes
from trimtab.sitl.studies.flights import BLIND


@pytest.mark.parametrize("name", [*BLIND.learning, *BLIND.held_out])
def test_route_of_the_blind_study_is_its_own_or_a_shipped_one(name: str) -> None:
    assert (BLIND.routes / f"{name}.toml").is_file() != (name in list_routes())


def test_every_route_file_of_the_study_is_flown() -> None:
    own = {path.stem for path in BLIND.routes.glob("*.toml")}
    assert own <= {*BLIND.learning, *BLIND.held_out}
