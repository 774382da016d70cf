"""What `trimtab show` says of logs, whole and cut, of references and of models."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from trimtab.host.base.errors import UsageError
from trimtab.host.log import LogError, Mocap, RecordedInputs, read_flight, write_imported
from trimtab.host.log.provenance import is_simulated
from trimtab.host.log.scan import scan
from trimtab.host.log.tracking import reference_at, tracking_error
from trimtab.host.models.file import write_model
from trimtab.host.models.model import Assessment, Covariance, Model
from trimtab.host.plan import plan
from trimtab.host.plan.files import write_plan
from trimtab.host.report.show import page
from trimtab.host.route import Gate, Route
from trimtab.host.route.shapes import Box
from trimtab.host.show.content import Content, read_content
from trimtab.host.show.flights import read_shown
from trimtab.host.vehicle import load_vehicle
from trimtab.host.workspace import open_workspace

DATA = Path(__file__).parents[2] / "data"
VEHICLE = load_vehicle("research")
ROUTE = Route(
    name="hop",
    waypoints_m=((0.0, 0.0, -1.2), (1.0, 0.5, -1.5), (2.0, 0.0, -1.2)),
    total_time_s=5.0,
    gates=(Gate(waypoint=1, width_m=0.8, height_m=0.6, heading_deg=0.0),),
    keep_out=(Box(kind="box", min_m=(0.5, -2.0, -2.0), max_m=(1.0, -1.0, -0.5)),),
)


@pytest.fixture
def a1(tmp_path: Path) -> Path:
    return Path(shutil.copy(DATA / "a1.mcap", tmp_path / "a1.mcap"))


def show(*paths: Path) -> Content:
    return read_content(paths, open_workspace(paths[0] if paths[0].is_dir() else paths[0].parent))


def test_flight_has_the_error_of_the_log_and_its_peak_on_the_page(a1: Path) -> None:
    flight, content = read_flight(a1), show(a1)
    error = tracking_error(flight)
    (row,), (track,) = content.flights, content.tracks
    assert error is not None
    found = (row["error_mean_m"], row["error_rmse_m"], row["error_max_m"])
    assert found == pytest.approx((error.mean_m, error.rmse_m, error.max_m))
    assert np.nanmax(track.channels["error"]) == pytest.approx(1e3 * error.max_m)
    assert {"p", "p_ref", "v", "v_ref", "q", "attitude", "rate", "motor", "error"} <= set(track.channels)


def test_track_starts_with_tracking_and_points_up(a1: Path) -> None:
    flight, (track,) = read_flight(a1), show(a1).tracks
    assert flight.reference is not None
    at_us = np.array([2_000_000])
    north, east, down = reference_at(flight.reference, at_us)[0, :3]
    sample = 2_000_000 // track.step_us - track.first
    assert track.channels["p_ref"][sample] == pytest.approx([north, east, -down])
    assert track.channels["p"][sample] == pytest.approx([north, east, -down], abs=0.3)
    assert np.isnan(track.channels["p_ref"][: -track.first - 1]).all()  # before tracking


def test_events_hold_the_phases_in_order(a1: Path) -> None:
    phases = [event["text"] for event in show(a1).flights[0]["events"] if event["kind"] == "phase"]
    assert phases == ["takeoff", "tracking", "hold", "landing", "standby"][: len(phases)]
    assert "tracking" in phases
    tracking = next(event for event in show(a1).flights[0]["events"] if event["text"] == "tracking")
    assert tracking["t_s"] == 0.0


def test_log_cut_anywhere_shows_its_intact_part(a1: Path) -> None:
    content = a1.read_bytes()
    before = 0
    for share in (0.2, 0.5, 0.9, 0.999):
        a1.write_bytes(content[: int(share * len(content))])
        shown = show(a1)
        (row,) = shown.flights
        assert row["whole"] is False
        assert any("intact part" in note for note in row["notes"])
        assert len(shown.tracks[0].channels["p"]) >= before
        before = len(shown.tracks[0].channels["p"])
        page(shown)
    assert before > 1000


def test_log_cut_before_its_first_chunk_makes_a_page_without_a_path(a1: Path) -> None:
    content = a1.read_bytes()
    sizes = [size for size in range(0, 60_000, 500) if _has_vehicle(a1, content[:size])]
    a1.write_bytes(content[: sizes[0]])
    shown = show(a1)
    assert any("no pose" in note for note in shown.flights[0]["notes"])
    assert "no pose" in page(shown)


def _has_vehicle(path: Path, content: bytes) -> bool:
    path.write_bytes(content)
    try:
        return bool(scan(path).attachments)
    except LogError:
        return False


@pytest.mark.parametrize("size", [0, 4, 60, 400])
def test_log_without_a_vehicle_is_refused(a1: Path, size: int) -> None:
    a1.write_bytes(a1.read_bytes()[:size])
    with pytest.raises(LogError):
        read_shown(a1)


def test_folder_leaves_out_what_it_cannot_show(a1: Path) -> None:
    (a1.parent / "b.mcap").write_bytes(b"no log")
    shown = show(a1.parent)
    assert [Path(row["log"]).name for row in shown.flights] == ["a1.mcap"]
    assert ["b.mcap" in note for note in shown.notes] == [True]
    a1.unlink()
    with pytest.raises(LogError):
        show(a1.parent)
    (a1.parent / "b.mcap").unlink()
    with pytest.raises(UsageError, match=r"\.mcap"):
        show(a1.parent)


def test_unfinished_log_of_a_folder_is_shown(a1: Path) -> None:
    a1.with_name("cut.mcap.part").write_bytes(a1.read_bytes()[:300_000])
    rows = {Path(row["log"]).name: row["whole"] for row in show(a1.parent).flights}
    assert rows == {"a1.mcap": True, "cut.mcap.part": False}


def test_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("")
    with pytest.raises(UsageError, match=r"notes\.txt"):
        show(tmp_path / "notes.txt")


@pytest.fixture
def planned(tmp_path: Path) -> Path:
    made = plan(ROUTE, VEHICLE, kind="min-snap")
    return write_plan(made, tmp_path / "hop.ref")


def test_plan_has_margins_and_its_route_in_3d(planned: Path) -> None:
    shown = show(planned)
    (row,), (track,), scene = shown.plans, shown.tracks, shown.scene
    assert (row["vehicle"], row["route"], row["notes"]) == ("research", "hop", [])
    assert min(row["margins"].values()) > 0.0
    assert {"speed", "thrust", "margin", "q"} <= set(track.channels)
    assert [point["p"] for point in scene["waypoints"]] == [
        [0.0, 0.0, 1.2],
        [1.0, 0.5, 1.5],
        [2.0, 0.0, 1.2],
    ]
    (gate,), (box,) = scene["gates"], scene["keep_out"]
    assert np.mean(gate["corners"], axis=0) == pytest.approx([1.0, 0.5, 1.5])
    assert (box["low"], box["high"]) == ([0.5, -2.0, 0.5], [1.0, -1.0, 2.0])


def test_plan_without_its_record_says_that_the_route_is_not_known(planned: Path) -> None:
    planned.with_name("hop.ref.json").unlink()
    shown = show(planned)
    assert ["route is not known" in note for note in shown.plans[0]["notes"]] == [True]
    assert shown.scene == {"waypoints": [], "gates": [], "keep_out": []}
    assert "The route is not known" in page(shown)


def test_vehicle_of_another_reference_is_refused(planned: Path) -> None:
    with pytest.raises(UsageError, match="--vehicle"):
        read_content([planned], open_workspace(planned.parent), load_vehicle("nano"))


def test_model_has_intervals_verdict_and_probabilities(tmp_path: Path) -> None:
    model = Model(
        vehicle_id=VEHICLE.id,
        vehicle_name=VEHICLE.name,
        effects={"linear-drag": {"dx": 0.4, "dy": 0.3}},
        covariance=Covariance(names=("linear-drag.dx",), matrix=((0.0001,),)),
        assessment=Assessment(verdict="undecided", probabilities={"linear-drag": 0.7, "wind": 0.2}),
    )
    (row,) = show(write_model(model, tmp_path / "m.model.toml")).models
    dx, dy = row["parameters"]
    assert (dx["low"], dx["high"], dx["unit"]) == (pytest.approx(0.38), pytest.approx(0.42), "1/s")
    assert (dy["low"], dy["high"]) == (None, None)
    assert (row["verdict"], row["probabilities"]["wind"]) == ("undecided", 0.2)
    html = page(show(tmp_path / "m.model.toml"))
    assert "wind (probability 0.200)" in html
    assert "0.38 to 0.42" in html


@pytest.mark.parametrize(
    ("kind", "command", "expected"),
    [
        ("flight", "trimtab fly a.ref", True),
        ("flight", "trimtab demo", True),
        ("flight", "trimtab fly a.ref --port /dev/ttyUSB0", None),
        ("flight", "trimtab fly a.ref --port=/dev/ttyUSB0", None),
        ("flight", "somebody's own script", None),
        ("flight", "", None),
        ("imported", "trimtab import a.ulg", None),
    ],
)
def test_log_is_simulated_where_its_command_had_no_port(
    kind: str, command: str, expected: bool | None
) -> None:
    assert is_simulated({"kind": kind, "command": command}) is expected


@pytest.mark.parametrize(("stored", "expected"), [("yes", True), ("no", False)])
def test_log_is_simulated_where_the_firmware_said_so(stored: str, expected: bool) -> None:
    at_port = {"kind": "flight", "command": "trimtab fly a.ref --port /dev/ttyUSB0", "simulated": stored}
    assert is_simulated(at_port) is expected


def test_same_files_give_the_same_bytes_without_folders(
    a1: Path, planned: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    other = Path(shutil.copytree(a1.parent, tmp_path_factory.mktemp("other") / "copy"))
    first = page(show(a1, planned))
    assert first == page(show(other / a1.name, other / planned.name))
    assert str(a1.parent) not in first


TRUTHS_OPENED: list[str] = []


def _note_truth(event: str, words: tuple[object, ...]) -> None:
    """Note each truth file that this process opens."""
    if event == "open" and str(words[0]).endswith("truth.json"):
        TRUTHS_OPENED.append(str(words[0]))


sys.addaudithook(_note_truth)


def test_sealed_truth_is_not_opened(a1: Path, planned: Path) -> None:
    for name in ("a1.mcap.truth.json", "hop.truth.json", "truth.json"):
        (a1.parent / name).write_text("{}")
    TRUTHS_OPENED.clear()
    page(show(a1.parent))
    page(show(a1, planned))
    assert TRUTHS_OPENED == []
    (a1.parent / "truth.json").read_text()
    assert len(TRUTHS_OPENED) == 1  # the test can see it


def test_page_asks_nothing_of_a_network(a1: Path) -> None:
    html = page(show(a1))
    assert "default-src 'none'" in html
    for word in ('src="http', 'href="http', "@import", "fetch(", "XMLHttpRequest", "url(http"):
        assert word not in html, word
    assert len(html) < 3_000_000


def test_import_with_a_recorded_reference_has_its_error(tmp_path: Path) -> None:
    t_us = np.arange(0, 3_000_000, 10_000, dtype=np.int64)
    p = np.stack([np.sin(t_us * 1e-6), np.cos(t_us * 1e-6), -np.ones(len(t_us))], axis=1)
    path = tmp_path / "foreign.mcap"
    write_imported(
        path,
        vehicle=VEHICLE,
        mocap=Mocap(t_us=t_us, t_arrival_us=t_us, p=p, q=np.tile([1.0, 0.0, 0.0, 0.0], (len(t_us), 1))),
        inputs=RecordedInputs(t_us=t_us, level="reference", p_ref=p + np.array([0.03, 0.0, 0.04])),
        tracking_us=(1_000_000, 2_000_000),
        session={"source": "bench"},
    )
    shown = show(path)
    (row,), (track,) = shown.flights, shown.tracks
    assert row["error_rmse_m"] == pytest.approx(0.05)
    assert (row["kind"], row["simulated"], track.what) == ("imported", None, "import")
    assert np.isfinite(track.channels["error"]).sum() == 101
    assert "imported" in page(shown)
