"""Vehicles by the name of their file, and blobs that are for another one."""

from __future__ import annotations

from pathlib import Path

import pytest

from trimtab.host.base.errors import UsageError
from trimtab.host.link.tasks import Identity
from trimtab.host.link.vehicle_match import check_same_vehicle, name_of, neutral_feedforward
from trimtab.host.vehicle import load_vehicle
from trimtab.host.vehicle.canonical_toml import write_toml

STRANGER = Identity(vehicle_id="a" * 12, uid="1")


def test_name_of_a_shipped_vehicle_is_found_by_its_id() -> None:
    assert name_of(load_vehicle("nano").id) == "nano"
    assert name_of(STRANGER.vehicle_id) is None


def test_name_of_a_vehicle_goes_past_files_that_are_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "vehicles"
    folder.mkdir()
    (folder / "a.toml").write_text("wings = 2\n")
    mine = load_vehicle("research").model_copy(update={"mass_kg": 0.76})
    (folder / "mine.toml").write_text(write_toml(mine))
    assert name_of(mine.id) == "mine"


def test_check_same_vehicle_names_both_and_what_to_do() -> None:
    nano, research = load_vehicle("nano").id, load_vehicle("research").id
    check_same_vehicle(STRANGER, "a" * 12, what="the reference", port="ttyX")
    for identity, text in (
        (
            Identity(vehicle_id=nano, uid="1"),
            rf"^ttyX is the nano \({nano}\), the reference is for the research \({research}\); "
            "make it again with --vehicle nano, or check the port$",
        ),
        (STRANGER, "^ttyX is vehicle a{12}, the reference is .* --vehicle and the file of that vehicle, or"),
    ):
        with pytest.raises(UsageError, match=text):
            check_same_vehicle(identity, research, what="the reference", port="ttyX")


def test_neutral_feedforward_is_the_same_for_a_vehicle_every_time() -> None:
    assert neutral_feedforward("a" * 12).id == neutral_feedforward("a" * 12).id
