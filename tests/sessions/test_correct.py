"""From a model file, or from another program's log, to a corrected flight, as a user does it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.one_table import COLUMNS, one_table
from trimtab.host.log import Flight, read_flight
from trimtab.host.log.info import to_lines
from trimtab.host.log.scan import scan
from trimtab.host.log.topics import LOG
from trimtab.host.log.tracking import feedforward_faded_s, tracking_error
from trimtab.host.models.file import write_model
from trimtab.host.models.model import Assessment, Model
from trimtab.host.models.network import Layout, Network
from trimtab.host.models.region import Region
from trimtab.host.vehicle import Vehicle, load_vehicle
from trimtab.protocol.blobs import NEUTRAL_BLOCK, FeedForward, Reference
from trimtab.sitl.serve import serve
from trimtab.sitl.vehicle import SimulatedVehicle

Run = Callable[..., tuple[int, dict[str, Any], str]]

DRAG = {"dx": 0.5, "dy": 0.5, "dz": 0.1}
"""That of the world paper-drag."""
EVERYWHERE = Region(speed_max_m_s=8.0, tilt_max_deg=50.0, thrust_min_n=2.0, thrust_max_n=25.0)
WORLD = ("--world", "paper-drag", "--world-seed", "5")
CLEARLY = 0.5
"""Greatest flown error with the correction over the one without."""


def saved(vehicle: Vehicle, name: str = "drag", **content: Any) -> str:
    """Write a model file to the current folder, and return its name."""
    model = Model(vehicle_id=vehicle.id, vehicle_name=vehicle.name, **content)
    return str(write_model(model, f"{name}.model.toml"))


def drag_network() -> Network:
    """Return a network in the body frame that gives the drag of the world: nearly linear in the velocity."""
    small = 0.05
    first = np.hstack([small * np.eye(3), np.zeros((3, 1))])
    last = np.hstack([np.diag([-d / small for d in DRAG.values()]), np.zeros((3, 1))])
    return Network(layout=Layout(hidden=(3,), frame="body"), xi=np.concatenate([first.ravel(), last.ravel()]))


@pytest.fixture
def run(run_trimtab: Run, reference: Reference, tmp_path: Path) -> Run:
    """Runs the command line with --json; the figure of eight is at eight.ref."""
    (tmp_path / "eight.ref").write_bytes(reference.to_bytes())
    return lambda *words: run_trimtab(*words, "--json")


@pytest.fixture
def flown(run: Run) -> Callable[..., tuple[dict[str, Any], Flight]]:
    """Flies the figure of eight in the world with drag: the answer and the log. The flight must be whole."""

    def fly(feedforward: str | None = None) -> tuple[dict[str, Any], Flight]:
        words = () if feedforward is None else ("--feedforward", feedforward)
        code, told, complaint = run("fly", "eight.ref", *WORLD, *words, "-o", "x.mcap", "--force")
        assert (code, told["whole"]) == (0, True), complaint
        return told, read_flight("x.mcap")

    return fly


@pytest.fixture(scope="session")
def uncorrected_m() -> dict[str, float]:
    """The error without a correction, flown once."""
    return {}


@pytest.fixture
def error_m(flown: Any, uncorrected_m: dict[str, float]) -> float:
    """The flown error without a correction."""
    if not uncorrected_m:
        told, flight = flown()
        assert told["feedforward_faded_s"] is flight.feedforward is None
        uncorrected_m["error"] = told["tracking_rmse_m"]
    return uncorrected_m["error"]


def test_correction_of_a_drag_lowers_the_flown_error_and_is_in_the_log(
    run: Run, flown: Any, error_m: float, vehicle: Vehicle
) -> None:
    model = saved(vehicle, effects={"linear-drag": DRAG}, region=EVERYWHERE)
    code, made, complaint = run("correct", model, "-o", "x.ff")
    assert code == 0
    assert "states no verdict" in complaint
    assert (made["feedforward"], list(made["corrected"]), made["uncorrected"]) == (
        "x.ff",
        ["linear-drag"],
        {},
    )
    told, flight = flown("x.ff")
    assert told["tracking_rmse_m"] < CLEARLY * error_m
    assert told["feedforward_faded_s"] == 0.0
    assert flight.feedforward is not None
    assert flight.feedforward.to_bytes() == Path("x.ff").read_bytes()
    assert flight.metadata["feedforward_id"] == flight.feedforward.id == made["feedforward_id"]
    code, described, _ = run("log", "info", "x.mcap")
    assert (described["feedforward"], described["feedforward_faded_s"]) == (made["feedforward_id"], 0.0)


def test_network_in_the_body_frame_corrects_on_board(
    run: Run, flown: Any, error_m: float, vehicle: Vehicle
) -> None:
    model = saved(vehicle, network=drag_network(), region=EVERYWHERE)
    code, made, _ = run("correct", model, "-o", "x.ff")
    assert (code, list(made["corrected"])) == (0, ["network"])
    told, _ = flown("x.ff")
    assert told["tracking_rmse_m"] < CLEARLY * error_m


def test_feedforward_of_version_1_flies(flown: Any, error_m: float, vehicle: Vehicle, tmp_path: Path) -> None:
    block = (*NEUTRAL_BLOCK[:4], *DRAG.values(), *NEUTRAL_BLOCK[7:])
    old = FeedForward(vehicle_id=vehicle.id, model_id="0" * 12, block=block, version=1)
    (tmp_path / "old.ff").write_bytes(old.to_bytes())
    told, flight = flown("old.ff")
    assert flight.feedforward == old
    assert told["tracking_rmse_m"] < CLEARLY * error_m


def test_reference_beyond_the_region_fades_the_correction_and_is_told(
    run: Run, flown: Any, error_m: float, vehicle: Vehicle
) -> None:
    slow = replace(EVERYWHERE, speed_max_m_s=0.4)
    model = saved(vehicle, effects={"linear-drag": DRAG}, region=slow)
    assert run("correct", model, "-o", "x.ff")[0] == 0
    told, flight = flown("x.ff")
    assert flight.status is not None
    assert flight.status.feedforward_faded.max() == 100
    assert 1.0 < told["feedforward_faded_s"] < 6.0
    assert told["tracking_rmse_m"] < 1.1 * error_m
    texts = [entry.data for entry in scan(flight.path).by_topic()[LOG]]
    assert sum(b"feed-forward fades: beyond its region" in text for text in texts) == 1
    described = flight.to_dict()
    assert described["feedforward_faded_s"] == told["feedforward_faded_s"] == feedforward_faded_s(flight)
    line = f"faded for {told['feedforward_faded_s']:.1f} s beyond its region"
    assert any(line in text for text in to_lines(described))
    assert flight.tracking is not None
    middle_us = sum(flight.tracking) // 2
    half = feedforward_faded_s(replace(flight, tracking=(flight.tracking[0], middle_us)))
    assert half is not None
    assert 0.0 < half < told["feedforward_faded_s"]


def test_error_with_the_age_of_poses_counts_them_when_they_were_true(flown: Any, error_m: float) -> None:
    _, flight = flown()
    late = replace(flight.mocap, t_us=flight.mocap.t_us + 20_000)
    stamped, true = (tracking_error(replace(flight, mocap=late), pose_age_s=age) for age in (0.0, 0.02))
    assert stamped is not None
    assert true is not None
    assert true.rmse_m == pytest.approx(error_m)
    assert abs(stamped.rmse_m - true.rmse_m) > 1e-3


def test_undecided_model_is_corrected_only_if_accepted(run: Run, vehicle: Vehicle, tmp_path: Path) -> None:
    assessment = Assessment(verdict="undecided", probabilities={"linear-drag": 0.6, "quadratic-drag": 0.4})
    model = saved(vehicle, effects={"linear-drag": DRAG}, region=EVERYWHERE, assessment=assessment)
    code, _, complaint = run("correct", model, "-o", "x.ff")
    assert code == 2
    assert "undecided (linear-drag 0.60, quadratic-drag 0.40)" in complaint
    assert "--accept-undecided" in complaint
    assert not (tmp_path / "x.ff").exists()
    code, made, _ = run("correct", model, "--accept-undecided", "-o", "x.ff")
    assert (code, made["verdict"]) == (0, "undecided")
    assert FeedForward.from_bytes((tmp_path / "x.ff").read_bytes()).id == made["feedforward_id"]


@pytest.mark.parametrize(
    ("content", "words", "code", "part"),
    [
        ({"effects": {"linear-drag": DRAG}}, ("--vehicle", "nano"), 2, "is of vehicle research"),
        ({"effects": {"com-offset": {"x": 0.01}}}, (), 1, "com-offset: not corrected, the feed-forward has"),
        ({}, (), 1, "nothing in it can be corrected on board"),
        ({"effects": {"wind": {"wx": 2.0}}}, (), 1, "wind: not corrected, "),
        ({"effects": {"thrust-gain": {"gain": 0.2}}}, (), 1, "gain 0.2 is beyond 0.3"),
        ({"effects": {"of-my-own": {"k": 0.2}}}, (), 2, "of-my-own, which is no known effect"),
    ],
)
def test_correct_that_cannot_be_is_one_line_and_a_code_and_leaves_nothing(
    run: Run, vehicle: Vehicle, tmp_path: Path, content: dict, words: tuple[str, ...], code: int, part: str
) -> None:
    assessment = Assessment(verdict="traced")
    model = saved(vehicle, assessment=assessment, **content)
    got, told, complaint = run("correct", model, *words, "-o", "x.ff")
    assert (got, told["exit_code"]) == (code, code)
    assert part in complaint
    assert complaint.count("\n") == 1
    assert not list(tmp_path.glob("x.ff*"))


@contextmanager
def served(board: SimulatedVehicle) -> Iterator[str]:
    """The vehicle at a port, in a thread."""
    stop, up = threading.Event(), threading.Event()
    addresses: list[str] = []

    def ready(address: str) -> None:
        addresses.append(address)
        up.set()

    thread = threading.Thread(
        target=lambda: serve(board, port="udp:127.0.0.1:0", stop=stop.is_set, ready=ready), daemon=True
    )
    thread.start()
    up.wait()
    try:
        yield addresses[0]
    finally:
        stop.set()
        thread.join()


def test_upload_sends_a_correction_and_the_vehicle_refuses_one_out_of_range(
    run: Run, vehicle: Vehicle, tmp_path: Path
) -> None:
    assert (
        run("correct", saved(vehicle, effects={"linear-drag": DRAG}, region=EVERYWHERE), "-o", "x.ff")[0] == 0
    )
    strong = FeedForward(vehicle_id=vehicle.id, model_id="0" * 12, block=(0.2, *NEUTRAL_BLOCK[1:]))
    (tmp_path / "strong.ff").write_bytes(strong.to_bytes())
    other = FeedForward(vehicle_id=load_vehicle("nano").id, model_id="0" * 12, block=NEUTRAL_BLOCK)
    (tmp_path / "other.ff").write_bytes(other.to_bytes())
    with served(SimulatedVehicle.create(vehicle)) as port:
        code, sent, _ = run("upload", "x.ff", "--port", port, "--read-back")
        assert (code, sent["kind"], sent["read_back"]) == (0, "feedforward", True)
        code, _, complaint = run("upload", "strong.ff", "--port", port)
        assert code == 1
        assert "gain 0.2 beyond 0.3" in complaint
        code, _, complaint = run("upload", "other.ff", "--port", port)
        assert code == 2
        assert "the feedforward is for the nano" in complaint
        assert run("download", "feedforward", "--port", port, "-o", "live.ff")[0] == 0
        assert (tmp_path / "live.ff").read_bytes() == (tmp_path / "x.ff").read_bytes()
        assert run("upload", "neutral", "--port", port)[0] == 0


def test_fly_refuses_the_correction_of_another_vehicle(run: Run, tmp_path: Path) -> None:
    other = FeedForward(vehicle_id=load_vehicle("nano").id, model_id="0" * 12, block=NEUTRAL_BLOCK)
    (tmp_path / "other.ff").write_bytes(other.to_bytes())
    code, _, complaint = run("fly", "eight.ref", "--feedforward", "other.ff")
    assert code == 2
    assert f"the feed-forward {other.id} was made for vehicle {other.vehicle_id}" in complaint
    assert complaint.count("\n") == 1


@pytest.mark.full  # three flights and a trace
def test_imported_log_is_traced_and_corrects_a_held_out_flight(
    run: Run, flown: Any, error_m: float, tmp_path: Path
) -> None:
    assert run("plan", "sprint")[0] == 0
    (tmp_path / "map.toml").write_text(COLUMNS)
    for k in ("1", "2"):
        assert run("fly", "sprint.ref", *WORLD, "--flight", k, "-o", f"{k}.mcap")[0] == 0
        assert run("log", "export", f"{k}.mcap")[0] == 0
        one_table(tmp_path / f"{k}.csv", tmp_path / f"flight-{k}.csv")
        words = ("import", "csv", f"flight-{k}.csv", "--columns", "map.toml", "--vehicle", "research")
        assert run(*words, "-o", f"imported-{k}.mcap")[0] == 0
    code, traced, _ = run("trace", "imported-1.mcap", "imported-2.mcap", "-o", "traced")
    assert (code, traced["verdict"]) == (0, "traced")
    code, made, _ = run("correct", "traced/trace.model.toml", "-o", "x.ff")
    assert (code, made["verdict"]) == (0, "traced")
    assert "linear-drag" in made["corrected"]
    told, _ = flown("x.ff")
    assert told["tracking_rmse_m"] < CLEARLY * error_m
