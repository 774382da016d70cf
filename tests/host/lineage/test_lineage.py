"""Lineages of real artefacts: what is found, what is missing, what is damaged and what is sealed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from trimtab.host.base.artefacts import content_id
from trimtab.host.lineage.files import LineageError
from trimtab.host.lineage.search import Lineage, lineage
from trimtab.host.lineage.words import lines
from trimtab.host.log import LogError, Mocap, write_imported
from trimtab.host.models.file import write_model
from trimtab.host.models.model import Model
from trimtab.host.vehicle import load_vehicle
from trimtab.protocol.blobs import Node, Reference

DATA = Path(__file__).parents[2] / "data"
VEHICLE = load_vehicle("research")
EPOCH_US = 1_700_000_000_000_000


def imported(path: Path, **session: str) -> str:
    t_us = np.arange(0, 2_000_000, 10_000)
    p = np.column_stack([np.sin(1e-6 * t_us), np.zeros(len(t_us)), np.full(len(t_us), -1.0)])
    q = np.tile([1.0, 0.0, 0.0, 0.0], (len(t_us), 1))
    mocap = Mocap(t_us=t_us, t_arrival_us=t_us, p=p, q=q)
    write_imported(path, vehicle=VEHICLE, mocap=mocap, session=session)
    return content_id(path.read_bytes())


def model(path: Path, **parents: str) -> str:
    made = Model(
        vehicle_id=VEHICLE.id,
        vehicle_name=VEHICLE.name,
        effects={"mass": {"factor": 1.1}},
        provenance={"command": "trimtab trace a.mcap --truth x.json -o out", "parents": parents},
    )
    write_model(made, path)
    return made.id


def reference(path: Path, **parents: str) -> str:
    nodes = (Node(0, (0.0,) * 12), Node(1_000_000, (1.0,) + (0.0,) * 11))
    made = Reference(vehicle_id=VEHICLE.id, origin_ned=(0.0, 0.0, -1.0), nodes=nodes)
    path.write_bytes(made.to_bytes())
    record = {"reference": made.id, "provenance": {"command": "trimtab plan hop", "parents": parents}}
    path.with_name(path.name + ".json").write_text(json.dumps(record))
    return made.id


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    log = imported(tmp_path / "a.mcap", epoch_us=str(EPOCH_US), source_id="5" * 12)
    traced = model(tmp_path / "a.model.toml", **{"log 0": log})
    reference(tmp_path / "hop.ref", model=traced, route="7" * 12)
    return tmp_path


def steps(found: Lineage, which: str) -> list[tuple[int, str, str | None]]:
    relations = getattr(found, which)
    return [(r.depth, r.role, r.artefacts[0].name if r.artefacts else None) for r in relations]


def test_lineage_of_reference_leads_to_log_and_source(folder: Path) -> None:
    found = lineage(folder / "hop.ref.json")  # the record stands for its reference
    assert found.artefact.name == "hop.ref"
    assert steps(found, "ancestors") == [
        (1, "vehicle", "research"),
        (1, "model", "a.model.toml"),
        (2, "vehicle", "research"),
        (2, "log 0", "a.mcap"),
        (3, "vehicle", "research"),
        (3, "source", None),
        (1, "route", None),
    ]
    assert any("7" * 12 + ", missing" in line for line in lines(found))


def test_lineage_of_log_leads_to_model_and_reference(folder: Path) -> None:
    found = lineage(folder / "a.mcap")
    assert steps(found, "descendants") == [(1, "log 0", "a.model.toml"), (2, "model", "hop.ref")]
    assert (found.artefact.origin, found.artefact.date) == ("imported", "2023-11-14T22:13:20Z")


def test_lineage_in_another_folder_finds_parents_there(folder: Path, tmp_path: Path) -> None:
    (folder / "out").mkdir()
    (folder / "hop.ref").rename(folder / "out" / "hop.ref")
    (folder / "hop.ref.json").rename(folder / "out" / "hop.ref.json")
    alone = lineage(folder / "out" / "hop.ref")
    assert (1, "model", None) in steps(alone, "ancestors")
    assert (1, "model", "a.model.toml") in steps(lineage(folder / "out" / "hop.ref", folder), "ancestors")


def test_copy_of_a_file_is_named(folder: Path) -> None:
    (folder / "b.mcap").write_bytes((folder / "a.mcap").read_bytes())
    (copy,) = lineage(folder / "a.mcap").copies
    assert copy.name == "b.mcap"


def test_edited_vehicle_is_no_longer_the_parent(folder: Path) -> None:
    (folder / "mine.toml").write_text(VEHICLE.to_toml())
    children = steps(lineage(folder / "mine.toml"), "descendants")
    assert {name for _, _, name in children} == {"a.mcap", "a.model.toml", "hop.ref"}
    (folder / "mine.toml").write_text(VEHICLE.replace(mass_kg=0.9).to_toml())
    assert lineage(folder / "mine.toml").descendants == ()


def test_damaged_files_are_one_line_each_and_do_not_stop_it(folder: Path) -> None:
    whole = (folder / "a.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(whole[:-9])
    (folder / "empty.ref").write_bytes(b"")
    (folder / "half.ref").write_bytes((folder / "hop.ref").read_bytes()[:60])
    (folder / "no.model.toml").write_text("id = ")
    (folder / "list.json").write_text("[")
    (folder / "bad.toml").write_text("rotors = 1\nmass_kg = -1.0\n")
    found = lineage(folder / "a.mcap")
    names = ["bad.toml", "cut.mcap", "empty.ref", "half.ref", "list.json", "no.model.toml"]
    assert [line.split(":")[0].rpartition("/")[2] for line in found.damaged] == names
    assert not any("\n" in line for line in found.damaged)
    assert len(found.descendants) == 2


def test_sealed_options_and_files_stay_sealed(folder: Path) -> None:
    (folder / "a.mcap.truth.json").write_text("{not opened")
    found = lineage(folder / "a.model.toml")
    assert found.artefact.command == "trimtab trace a.mcap -o out"
    assert found.damaged == ()


@pytest.mark.parametrize(
    ("command", "origin", "port"),
    [
        ("trimtab fly hop.ref --port ttyACM0", "port", "ttyACM0"),
        ("trimtab fly hop.ref --port=udp:1.2.3.4:5", "port", "udp:1.2.3.4:5"),
        ("trimtab fly hop.ref", "simulated", None),
        ("somebody's own script", None, None),
    ],
)
def test_log_says_where_it_was_flown(
    tmp_path: Path, command: str, origin: str | None, port: str | None
) -> None:
    from trimtab.host.log import FLIGHT_TOPICS, LogWriter, Provenance

    provenance = Provenance(vehicle=VEHICLE, session={"command": command})
    with LogWriter(tmp_path / "f.mcap", provenance, FLIGHT_TOPICS):
        pass
    artefact = lineage(tmp_path / "f.mcap").artefact
    assert (artefact.origin, artefact.port, artefact.date) == (origin, port, None)


def test_old_log_without_command_has_no_origin(tmp_path: Path) -> None:
    (tmp_path / "c1.mcap").write_bytes((DATA / "c1.mcap").read_bytes())
    artefact = lineage(tmp_path / "c1.mcap").artefact
    assert (artefact.kind, artefact.origin, artefact.command) == ("log", None, None)
    assert set(artefact.parents) == {"vehicle", "reference"}


def test_file_without_lineage_is_refused(folder: Path) -> None:
    (folder / "notes.txt").write_text("x")
    for path in (folder / "notes.txt", folder / "none.ref", folder):
        with pytest.raises(LineageError) as refused:
            lineage(path)
        assert refused.value.exit_code == 2
    with pytest.raises(LineageError):
        lineage(folder / "a.mcap", folder / "none")
    (folder / "cut.mcap").write_bytes((folder / "a.mcap").read_bytes()[:500])
    with pytest.raises(LogError):
        lineage(folder / "cut.mcap")
