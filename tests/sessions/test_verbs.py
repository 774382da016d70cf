"""`fly`, `upload` and `log` as a user runs them; what a log may not tell."""

from __future__ import annotations

import json
import os
import pwd
import re
import shutil
import signal
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.docs.page_commands import page_of
from trimtab.host import cli
from trimtab.host.base import output
from trimtab.host.effects import load_effects
from trimtab.host.log import is_same_flight, read_flight
from trimtab.host.log.scan import scan
from trimtab.host.plan import Settings
from trimtab.protocol.blobs import Reference
from trimtab.sitl.vehicle import SimulatedVehicle

FLY_KEYS = {
    "log",
    "reference",
    "tracking_rmse_m",
    "tracking_max_m",
    "clipped_share",
    "realtime_factor",
    "link",
}
LINK_KEYS = {"frames_sent", "frames_lost", "rtt_ms", "mocap_age_ms_p99"}


@pytest.fixture
def trimtab(run_trimtab: Callable[..., tuple[int, dict[str, Any], str]]) -> Callable[..., Any]:
    return run_trimtab


@pytest.fixture
def ref(tmp_path: Path, reference: Reference) -> str:
    (tmp_path / "eight.ref").write_bytes(reference.to_bytes())
    return "eight.ref"


def test_fly_answers_with_the_documented_keys_and_leaves_log_and_truth(
    trimtab: Any, ref: str, tmp_path: Path
) -> None:
    code, told, _ = trimtab("fly", ref, "--json", "--seed", "4", "--flight", "2")
    assert code == 0
    assert set(told) >= FLY_KEYS
    assert set(told["link"]) >= LINK_KEYS
    assert told["log"] == "eight-2.mcap"
    truth = json.loads((tmp_path / "eight-2.mcap.truth.json").read_text())
    assert truth["log"] == told["log_id"]
    code, described, _ = trimtab("log", "info", "eight-2.mcap", "--json")
    assert code == 0
    assert described["id"] == told["log_id"]
    assert described["provenance"]["seed"] == "4"
    assert described["provenance"]["flight"] == "2"
    assert described["provenance"]["session_uid"] == truth["uid"]


def test_fly_with_parameters_has_them_on_board_and_in_its_provenance(trimtab: Any, ref: str) -> None:
    words = ("--parameter", "OBS_GAIN=2.5", "--parameter=HOLD_S=0.5")
    assert trimtab("fly", ref, *words, "-o", "x.mcap")[0] == 0
    flight = read_flight("x.mcap")
    assert flight.firmware_parameters is not None
    assert (flight.firmware_parameters["OBS_GAIN"], flight.firmware_parameters["HOLD_S"]) == (2.5, 0.5)
    assert " ".join(words) in flight.metadata["command"]


def test_fly_again_does_not_overwrite_unless_forced(trimtab: Any, ref: str, tmp_path: Path) -> None:
    log = tmp_path / "x.mcap"
    log.write_bytes(b"mine")
    code, _, complaint = trimtab("fly", ref, "-o", "x.mcap", "--json")
    assert code == 2
    assert "--force" in complaint
    assert log.read_bytes() == b"mine"


def test_fly_again_is_the_next_flight(trimtab: Any, ref: str, tmp_path: Path) -> None:
    (tmp_path / "eight-1.mcap.part").write_bytes(b"of a killed flight")
    logs = [trimtab("fly", ref, "--json")[1]["log"] for _ in range(2)]
    assert logs == ["eight-0.mcap", "eight-2.mcap"]
    first, second = map(read_flight, logs)
    assert not is_same_flight(first, second)
    assert second.metadata["flight"] == "2"
    assert second.metadata["command"] == "trimtab fly eight.ref --flight 2"
    code, _, complaint = trimtab("fly", ref, "--flight", "2")
    assert (code, "eight-2.mcap: exists" in complaint) == (2, True)
    assert trimtab("fly", ref, "--force", "--json")[1]["log"] == "eight-0.mcap"
    assert read_flight("eight-0.mcap").id == first.id


def test_fly_forced_that_writes_no_log_leaves_the_truth_of_the_old_one(
    trimtab: Any, ref: str, tmp_path: Path, world_file: Callable[[str], str]
) -> None:
    assert trimtab("fly", ref, "-o", "x.mcap")[0] == 0
    before = {path.name: path.read_bytes() for path in tmp_path.glob("x.mcap*")}
    assert len(before) == 2
    world = world_file("[mocap]\ngaps_s = [[0.0, 60.0]]\n")
    assert trimtab("fly", ref, "-o", "x.mcap", "--force", "--world", world, "--world-seed", "3")[0] == 3
    assert {path.name: path.read_bytes() for path in tmp_path.glob("x.mcap*")} == before
    assert trimtab("fly", ref, "-o", "x.mcap", "--force", "--world-seed", "3")[0] == 0
    truth = json.loads((tmp_path / "x.mcap.truth.json").read_text())
    assert truth["world_seed"] == 3
    assert truth["log"] == trimtab("log", "info", "x.mcap", "--json")[1]["id"]


def test_fly_over_what_a_killed_flight_left_is_refused_unless_forced(
    trimtab: Any, ref: str, tmp_path: Path
) -> None:
    left = tmp_path / "x.mcap.part"
    left.write_bytes(b"mine")
    code, _, complaint = trimtab("fly", ref, "-o", "x.mcap")
    assert code == 2
    assert "trimtab log recover x.mcap" in complaint
    assert left.read_bytes() == b"mine"
    assert trimtab("fly", ref, "-o", "x.mcap", "--force")[0] == 0
    assert not left.exists()


def test_fly_beside_the_part_of_another_user_names_the_user_and_leaves_it(
    trimtab: Any, ref: str, tmp_path: Path
) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root can give files to another user")
    part = tmp_path / "eight-0.mcap.part"
    part.write_bytes(b"of a killed flight")
    os.chown(part, 1, 1)
    user = pwd.getpwuid(1).pw_name
    assert trimtab("fly", ref, "--json")[1]["log"] == "eight-1.mcap"
    code, _, complaint = trimtab("fly", ref, "-o", "eight-0.mcap")
    refusal = f"eight-0.mcap.part: belongs to another user ({user}); choose another name"
    assert (code, complaint.splitlines()) == (2, [f"trimtab: {refusal}"])
    assert trimtab("fly", ref, "-o", "eight-0.mcap", "--force")[0] == 0
    assert part.read_bytes() == b"of a killed flight"
    (listed,) = trimtab("log", "info", ".", "--json")[1]["unfinished"]
    assert (listed["part"], listed["owner"]) == ("eight-0.mcap.part", user)


@pytest.mark.parametrize("option", ["--world-seed", "--world_seed"])
def test_fly_log_tells_nothing_of_world_seed_or_drawn_values(
    trimtab: Any, ref: str, tmp_path: Path, option: str
) -> None:
    seed = "918273645"
    code, told, _ = trimtab("fly", ref, "--world", "drawn-several", option, seed, "-o", "x.mcap", "--json")
    assert code == 0
    found = scan(tmp_path / "x.mcap")
    text = repr((found.metadata, found.attachments)).encode() + b"".join(e.data for e in found.messages)
    truth = json.loads((tmp_path / "x.mcap.truth.json").read_text())
    assert truth["world_seed"] == int(seed)
    assert truth["effects"]
    values = [value for effect in truth["effects"].values() for value in effect.values()]
    values += list(truth["deviations"].values())
    forbidden = ["drawn-several", seed, "--world", *(f"{value:.6g}" for value in values if value)]
    vehicle_file = found.attachments["vehicle.toml"][1].decode()
    forbidden += [name for name in load_effects() if not re.search(rf"\b{name}\b", vehicle_file)]
    assert len(forbidden) > 5
    for word in forbidden:
        assert word.encode() not in text, word
    assert told["link"]["frames_sent"] > 0


@pytest.mark.parametrize(
    ("words", "code", "part"),
    [
        (("fly", "none.ref"), 2, "none.ref: cannot be read"),
        (("fly", "bad.ref"), 2, "bad.ref: not a reference or feed-forward"),
        (("fly", "eight.ref", "--vehicle", "nano"), 2, "was made for vehicle"),
        (("fly", "eight.ref", "--world", "atlantis"), 2, "atlantis"),
        (("fly", "eight.ref", "--port", "/dev/null"), 2, "give --port and --mocap together"),
        (("fly", "eight.ref", "--port", "/dev/null", "--mocap", "udp://127.0.0.1:1x"), 2, "HOST:PORT"),
        (("fly", "eight.ref", "--flight", "-1"), 2, "is negative; give 0 or more"),
        (("fly", "eight.ref", "-o", "no/x.mcap"), 2, "folder"),
        (("fly", "eight.ref", "--parameter", "OBS_GAIN"), 2, "OBS_GAIN: no value; give NAME=VALUE"),
        (("fly", "eight.ref", "--parameter", "OBS_GAIN="), 2, "OBS_GAIN=: no value; give NAME=VALUE"),
        (
            ("fly", "eight.ref", "--parameter", "OBS_GAIN=x"),
            2,
            "OBS_GAIN=x: x is not a number; give NAME=VALUE",
        ),
        (("fly", "eight.ref", "--parameter", "OBSERVE=1"), 2, "there is no parameter OBSERVE"),
        (("fly", "eight.ref", "--parameter", "OBS_GAIN=99"), 2, "OBS_GAIN: 99 is outside 0..20 1/s"),
        (("upload", "eight.ref", "--port", "/dev/null"), 3, "cannot be opened as a serial port"),
        (("upload", "bad.ref", "--port", "/dev/null"), 2, "bad.ref"),
        (("log", "info", "bad.ref"), 5, "is not an MCAP file"),
        (("log", "recover", "bad.ref"), 5, "is not an MCAP file"),
    ],
)
def test_verb_with_bad_input_is_one_line_and_a_code_and_leaves_nothing(
    trimtab: Any, ref: str, tmp_path: Path, words: tuple[str, ...], code: int, part: str
) -> None:
    (tmp_path / "bad.ref").write_bytes(b"TRTB" + bytes(30))
    before = sorted(path.name for path in tmp_path.iterdir())
    got, told, complaint = trimtab(*words, "--json")
    assert got == code
    assert part in complaint
    assert complaint.count("\n") == 1
    assert told["exit_code"] == code
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_plan_writes_its_page_beside_the_reference_and_overwrites_it_only_when_forced(
    trimtab: Any, tmp_path: Path
) -> None:
    words = ("plan", "hover-turns", "-o", "x.ref", "--report", "x.html")
    code, told, _ = trimtab(*words, "--json")
    assert code == 0
    assert told["report"] == "x.html"
    html = (tmp_path / "x.html").read_text(encoding="utf-8")
    assert told["id"] in html
    assert "hover-turns: min-snap" in html
    (tmp_path / "x.ref").unlink()
    (tmp_path / "x.ref.json").unlink()
    code, _, complaint = trimtab(*words)
    assert code == 2
    assert "x.html: exists" in complaint
    assert not (tmp_path / "x.ref").exists()
    assert trimtab(*words, "--force")[0] == 0
    assert "--force" in (tmp_path / "x.html").read_text(encoding="utf-8")


def test_plan_that_is_refused_leaves_no_page(trimtab: Any, tmp_path: Path) -> None:
    words = ("plan", "pretzel", "--time-s", "5.6", "--report", "x.html")
    assert trimtab(*words)[0] == 1
    assert list(tmp_path.iterdir()) == []


def test_plan_page_onto_a_full_disk_is_one_line_and_no_file(
    trimtab: Any, tmp_path: Path, full_disk: Callable[[int], AbstractContextManager[None]]
) -> None:
    with full_disk(20_000):
        code, told, complaint = trimtab("plan", "hover-turns", "--report", "x.html", "--json")
    assert code == told["exit_code"] == 2
    assert complaint.count("\n") == 1
    assert "x.html" in complaint
    assert list(tmp_path.iterdir()) == []


def test_plan_pareto_writes_a_page_and_no_reference(trimtab: Any, drag_model: str, tmp_path: Path) -> None:
    words = ("plan", "pretzel", "--model", drag_model, "--pareto", "--time-s", "5.6", "--report", "x.html")
    code, told, _ = trimtab(*words, "--json")
    assert code == 0
    status = [point["status"] for point in told["points"]]
    assert status[0] == "refused"
    assert set(status[1:]) <= {"solved", "acceptable"}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drag.model.toml", "x.html"]
    assert "the min-snap plan is refused" in (tmp_path / "x.html").read_text(encoding="utf-8")


def test_plan_pareto_with_a_world_flies_every_plan_as_fly_does(
    trimtab: Any, drag_model: str, tmp_path: Path
) -> None:
    (tmp_path / "hop.toml").write_text(
        'name = "hop"\ntotal_time_s = 2.0\nwaypoints_m = [[0.0, 0.0, -1.0], [1.0, 0.0, -1.2]]\n'
    )
    place = ("--world", "paper-drag", "--world-seed", "812345678")
    trade = ("plan", "hop.toml", "--model", drag_model, "--pareto")
    words = (*trade, *place, "-o", "flown", "--report", "x.html")
    code, told, _ = trimtab(*words, "--json")
    assert code == 0
    point = told["points"][-1]
    assert (point["kind"], point["factor"]) == ("min-residual", 10.0)
    assert point["log"] == "flown/min-residual-x10.mcap"
    _, again, _ = trimtab("fly", "flown/min-residual-x10.ref", *place, "-o", "again.mcap", "--json")
    assert point["error_rmse_m"] == again["tracking_rmse_m"]
    assert point["error_max_m"] == again["tracking_max_m"]
    assert point["clipped_share"] == again["clipped_share"]
    for path in [tmp_path / "x.html", *(tmp_path / "flown").glob("*.json")]:
        if not path.name.endswith(".truth.json"):
            text = path.read_text(encoding="utf-8")
            assert "paper-drag" not in text
            assert "812345678" not in text


@pytest.mark.usefixtures("virtual_machine")
def test_plan_pareto_without_any_plan_tells_why_and_exits_with_1(
    trimtab: Any, drag_model: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    impatient = partial(Settings, iterations_max=20, rounds=1)
    monkeypatch.setattr("trimtab.host.plan.pareto.Settings", impatient)
    words = ("plan", "pretzel", "--model", drag_model, "--pareto", "--time-s", "3.0", "--nodes", "40")
    code, told, complaint = trimtab(*words, "--json")
    assert code == 1
    assert {point["status"] for point in told["points"]} <= {"refused", "unsolved"}
    assert all(point["reason"] for point in told["points"])
    assert "no plan was found" in complaint


def test_fly_that_ends_in_failsafe_answers_and_exits_with_1(
    trimtab: Any, ref: str, world_file: Callable[[str], str]
) -> None:
    world = world_file("[mocap]\ngaps_s = [[7.0, 20.0]]\n")
    code, told, complaint = trimtab("fly", ref, "--world", world, "-o", "x.mcap", "--json")
    assert code == 1
    assert told["failsafe"] == "mocap-lost"
    assert "ended in failsafe: mocap lost" in complaint
    assert trimtab("log", "info", "x.mcap", "--json")[1]["failsafe"] == "mocap-lost"


def test_log_export_makes_its_folder(trimtab: Any, flown: Any, tmp_path: Path) -> None:
    shutil.copy(flown[0].log, tmp_path / "a.mcap")
    code, told, _ = trimtab("log", "export", "a.mcap", "-o", "tables/first", "--json")
    assert (code, told["folder"]) == (0, "tables/first")
    assert sorted(told["rows"]) == sorted(path.name for path in (tmp_path / "tables" / "first").iterdir())


def test_log_export_forced_leaves_no_table_of_another_log(trimtab: Any, flown: Any, tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(flown[0].log.read_bytes())
    (tmp_path / "a.csv").mkdir()
    for name in ("recorded-imu.csv", "link.csv", "notes.csv"):
        (tmp_path / "a.csv" / name).write_text("mine")
    code, _, complaint = trimtab("log", "export", "a.mcap")
    assert code == 2
    assert "exists; choose another name or add --force" in complaint
    code, told, _ = trimtab("log", "export", "a.mcap", "--force", "--json")
    assert code == 0
    names = {path.name for path in (tmp_path / "a.csv").iterdir()}
    assert names == set(told["rows"]) | {"notes.csv"}
    assert "recorded-imu.csv" not in names
    assert (tmp_path / "a.csv" / "link.csv").read_text() != "mine"


def test_log_export_onto_a_full_disk_is_one_line_and_no_half_table(
    trimtab: Any, flown: Any, tmp_path: Path, full_disk: Callable[[int], AbstractContextManager[None]]
) -> None:
    (tmp_path / "a.mcap").write_bytes(flown[0].log.read_bytes())
    with full_disk(20_000):
        code, told, complaint = trimtab("log", "export", "a.mcap", "--json")
    assert code == told["exit_code"] == 2
    assert complaint.count("\n") == 1
    assert "a.csv" in complaint
    assert "File too large" in complaint
    for path in (tmp_path / "a.csv").iterdir():
        assert path.suffix == ".csv"
        assert path.read_text().endswith("\n")


def test_log_recover_of_a_cut_log_writes_one_that_can_be_read(
    trimtab: Any, flown: Any, tmp_path: Path
) -> None:
    content = flown[0].log.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: len(content) // 2])
    code, _, complaint = trimtab("log", "info", "cut.mcap")
    assert code == 5
    assert "trimtab log recover cut.mcap" in complaint
    code, told, _ = trimtab("log", "recover", "cut.mcap", "--json")
    assert code == 0
    assert told["recovered"]
    code, described, _ = trimtab("log", "info", told["log"], "--json")
    assert code == 0
    assert described["recovered"]
    assert trimtab("log", "recover", "cut.mcap")[0] == 2  # it is there already


def test_plan_that_moves_at_its_ends_says_so_and_the_vehicle_does_not_arm_for_it(
    trimtab: Callable[..., tuple[int, dict[str, Any], str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines: list[str] = []
    monkeypatch.setattr(output, "say", lambda *said: lines.extend(said))
    (tmp_path / "m.toml").write_text(
        'name = "m"\ntotal_time_s = 3.0\nwaypoints_m = [[0, 0, -1.2], [3, 0, -1.2]]\n'
        "start_velocity_m_s = [1.0, 0, 0]\n"
    )
    assert trimtab("plan", "m.toml")[0] == 0
    assert sum("moves at an end" in line for line in lines) == 1
    code, _, complaint = trimtab("fly", "m.ref")
    assert code == 1
    assert "reference not at rest at its ends" in complaint


def test_sitl_interrupted_while_the_vehicle_is_built_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    class Built(SimulatedVehicle):
        @classmethod
        def create(cls, *of: Any, **how: Any) -> Built:
            os.kill(os.getpid(), signal.SIGINT)
            return super().create(*of, **how)

    monkeypatch.setattr("trimtab.host.link.vehicle.vehicle_class", lambda: Built)
    assert cli.main(["sitl", "--port", "udp:127.0.0.1:0"]) == 0


def test_first_flight_page_shows_what_fly_prints_and_files_that_are_not_there_yet(flown: Any) -> None:
    page = (Path(__file__).parent.parent.parent / "docs" / "guide" / "first-flight.md").read_text(
        encoding="utf-8"
    )
    shape = re.compile(r"\d[\d.]*")
    shown = [shape.sub("0", line.strip()) for line in page.splitlines()]
    for line in flown[0].to_lines()[1:]:
        assert shape.sub("0", line) in shown
    logs = []
    printed = [command.text for command in page_of(page).commands if command.printed]
    for reference, words in re.findall(
        r"^trimtab fly (\S+)\.ref (.*)$", "\n".join(printed), flags=re.MULTILINE
    ):
        flight = re.search(r"--flight (\d+)", words)
        logs.append(f"{reference}-{flight[1] if flight else 0}.mcap")
    assert len(logs) == len(set(logs)) == 5


def test_fly_tells_how_far_it_was_from_the_obstacles_of_its_route(trimtab: Any, tmp_path: Path) -> None:
    route = """
        name = "slalom"
        total_time_s = 5.0
        waypoints_m = [[-2, 0, -1.2], [0, 0.6, -1.5], [2, 0, -1.2]]
        gates = [{waypoint = 1, width_m = 0.9, height_m = 0.8, heading_deg = 0}]
        keep_out = [{kind = "cylinder", centre_m = [1.0, -0.4], radius_m = 0.2, down_m = [-3, 0]}]
    """
    (tmp_path / "slalom.toml").write_text(route)
    code, planned, _ = trimtab("plan", "slalom.toml", "--kind", "min-control", "-o", "a.ref", "--json")
    assert (code, planned["clearance_m"]) == (0, 0.1)
    _, flown, _ = trimtab("fly", "a.ref", "-o", "a.mcap", "--json")
    assert [each["obstacle"] for each in flown["clearance"]] == ["gates[0]", "keep_out[0]"]
    for each, margin in zip(flown["clearance"], ("gates_m", "keep_out_m"), strict=True):
        assert each["distance_m"] == pytest.approx(planned["margins"][margin], abs=0.03)
    (tmp_path / "a.ref.json").unlink()
    assert trimtab("fly", "a.ref", "-o", "b.mcap", "--json")[1]["clearance"] == []
