"""Worlds of a study in the plant of another simulator, and plants that cannot be chosen."""

from __future__ import annotations

import dataclasses

import pytest

from trimtab.sitl.kinds import KINDS
from trimtab.sitl.studies.files import StudyError
from trimtab.sitl.studies.plants import PLANTS, check_plant
from trimtab.sitl.studies.worlds import IN_PLANTS, plan_worlds


def test_study_in_a_plant_draws_only_what_it_can_have() -> None:
    worlds = plan_worlds(3, 40, set(KINDS), plant="rotorpy")
    assert len(worlds) == 40
    assert {w.kind_class for w in worlds} == set(IN_PLANTS)
    assert {kind for w in worlds for kind in w.kinds} <= PLANTS["rotorpy"].effects
    assert {w.plant for w in worlds} == {"rotorpy"}


def test_study_in_an_unknown_plant_is_refused() -> None:
    with pytest.raises(StudyError, match="--plant gazebo: no such plant"):
        check_plant("gazebo")


def test_study_in_a_plant_that_is_not_installed_names_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    missing = dataclasses.replace(PLANTS["rotorpy"], package="no_such_simulator")
    monkeypatch.setitem(PLANTS, "rotorpy", missing)
    with pytest.raises(StudyError, match=r"no_such_simulator is not installed; install trimtab\[plants\]"):
        check_plant("rotorpy")
