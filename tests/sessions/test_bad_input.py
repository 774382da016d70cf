"""Bad input of every kind through the command line: one line a problem, the documented code, nothing left.

`refused` holds all of it for each case: the exit code, one line for each thing to mend, the same words in
the JSON object that ends stdout, and a folder that holds what it held before.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import math
import os
import random
import select
import signal
import subprocess
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from trimtab.host import cli
from trimtab.host.base import output
from trimtab.host.base.errors import EXIT_CODES
from trimtab.host.export.ros2 import write_bag
from trimtab.host.link.blob_files import read_reference
from trimtab.host.log import LogError, read_flight, recover
from trimtab.host.models.file import write_model
from trimtab.host.models.model import Assessment, Model
from trimtab.host.vehicle import Vehicle, load_vehicle
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Reference
from trimtab.protocol.codec import Codec

Refused = Callable[..., str]
HERE = Path(__file__).parent

BAD_TOML = {
    "syntax": ("name = \n", ["not valid TOML"]),
    "unknown key": ("wings = 2\n", ["wings: unknown key"]),
    "binary": ("\x00\x01", ["not valid TOML"]),
    "a whole number of thousands of digits": (f"wings = {'9' * 5000}\n", ["not valid TOML"]),
    "the same in hex": (f"wings = [1, 0x{'f' * 5000}]\n", ["wings[1]: a whole number beyond 64 bits"]),
}

MAP = """
world = "nwu"
body = "flu"
time = "t"
position_m = ["x", "y", "z"]
quaternion = ["qw", "qx", "qy", "qz"]
"""


def import_of(file: str) -> tuple[str, ...]:
    """The words that import a CSV file of the nano."""
    return ("import", "csv", file, "--columns", "map.toml", "--vehicle", "nano")


IMPORT = import_of("hover.csv")


def contents(folder: Path) -> dict[str, str]:
    """Every file and folder below `folder` by name, with what it holds."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
        for path in folder.rglob("*")
    }


@pytest.fixture
def run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, dict[str, Any], str]]:
    """Runs the command line in the test's folder: exit code, the JSON of the last line, stderr."""
    monkeypatch.chdir(tmp_path)

    def call(*words: str) -> tuple[int, dict[str, Any], str]:
        monkeypatch.setattr(output, "_emitted", False)
        monkeypatch.setattr("sys.argv", ["trimtab", *words, "--json"])
        capsys.readouterr()
        code = cli.main([*words, "--json"])
        told = capsys.readouterr()
        return code, json.loads(told.out.strip().splitlines()[-1]), told.err

    return call


@pytest.fixture
def refused(run: Callable[..., tuple[int, dict[str, Any], str]], tmp_path: Path) -> Refused:
    """Runs a verb that must fail with `code` and `parts` in its words, one line a problem; returns them."""

    def call(
        *words: str, code: int, parts: list[str], problems: int | None = 1, refusal: str | None = None
    ) -> str:
        before = contents(tmp_path)
        got, told, complaint = run(*words)
        assert got == code, complaint
        assert code in EXIT_CODES
        for part in parts:
            assert part in complaint
        lines = complaint.splitlines()
        assert all(line.startswith("trimtab: ") for line in lines)
        assert problems is None or len(lines) == problems
        assert told == {
            "error": "\n".join(line.removeprefix("trimtab: ") for line in lines),
            "exit_code": code,
            **({} if refusal is None else {"code": refusal}),
        }
        assert contents(tmp_path) == before
        return complaint

    return call


@pytest.fixture
def ref(tmp_path: Path, reference: Reference) -> str:
    (tmp_path / "eight.ref").write_bytes(reference.to_bytes())
    return "eight.ref"


@pytest.fixture
def log(tmp_path: Path, flown: Any) -> str:
    (tmp_path / "flight.mcap").write_bytes(flown[0].log.read_bytes())
    return "flight.mcap"


def hover_csv(path: Path, *, seconds: float = 8.0) -> None:
    """A nano quadrotor that drifts to and fro: poses, gyro, a collective, a reference."""
    rows = ["t,x,y,z,qw,qx,qy,qz,wx,wy,wz,m,rx,ry,rz"]
    noise = random.Random(4)
    for k in range(round(100 * seconds)):
        p = [noise.gauss(0.0, 1e-3) + x for x in (0.3 * math.sin(0.005 * k), 0.0, 1.0)]
        rate = [noise.gauss(0.0, 0.01) for _ in range(3)]
        row = [0.01 * k, *p, 1.0, 0.0, 0.0, 0.0, *rate, 0.6, 0.0, 0.0, 1.0]
        rows.append(",".join(f"{value:.6f}" for value in row))
    path.write_text("\n".join(rows))


@pytest.fixture
def foreign(tmp_path: Path, run: Callable[..., tuple[int, dict[str, Any], str]]) -> Callable[..., str]:
    """Imports a hover of the nano with more keys in its column map; the log's name."""

    def bring_in(more: str, *, name: str = "foreign.mcap", seconds: float = 8.0) -> str:
        hover_csv(tmp_path / "hover.csv", seconds=seconds)
        (tmp_path / "map.toml").write_text(MAP + more)
        code, _, complaint = run(*IMPORT, "-o", name, "--force")
        assert code == 0, complaint
        return name

    return bring_in


THRUST = 'thrust_n = "m"\ngyro = ["wx", "wy", "wz"]\n'
REFERENCE = 'reference_position_m = ["rx", "ry", "rz"]\n'


# Malformed TOML.


@pytest.mark.parametrize("kind", BAD_TOML)
@pytest.mark.parametrize(
    "words",
    [
        ("plan", "figure-eight", "--vehicle", "bad.toml"),
        ("plan", "bad.toml"),
        ("fly", "eight.ref", "--world", "bad.toml"),
        ("fly", "eight.ref", "--vehicle", "bad.toml"),
        ("import", "csv", "eight.ref", "--columns", "bad.toml", "--vehicle", "nano", "-o", "x.mcap"),
        ("plan", "figure-eight", "--model", "bad.toml"),
    ],
    ids=["vehicle", "route", "world", "vehicle of a flight", "columns", "model"],
)
def test_malformed_toml_is_told_by_file_and_key(
    refused: Refused, ref: str, tmp_path: Path, words: tuple[str, ...], kind: str
) -> None:
    text, parts = BAD_TOML[kind]
    (tmp_path / "bad.toml").write_text(text)
    complaint = refused(*words, code=2, parts=["bad.toml", *parts], problems=None)
    assert all(line.startswith("trimtab: bad.toml: ") for line in complaint.splitlines())


def test_vehicle_with_many_problems_tells_them_all_at_once(refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "v.toml").write_text('name = "v"\nmass_kg = "heavy"\nwings = 2\nthrust_curve = [0.5, 0.9]\n')
    parts = [
        "v.toml: mass_kg: 'heavy' is not a number",
        "wings: unknown key",
        "c1 + c2 is 1.4",
        "rotors: miss",
    ]
    refused("plan", "figure-eight", "--vehicle", "v.toml", code=2, parts=parts, problems=None)


def test_world_with_an_unknown_effect_is_refused(refused: Refused, ref: str, tmp_path: Path) -> None:
    (tmp_path / "w.toml").write_text('description = "x"\ntolerances = true\n[effects.magnetism]\nb = 1.0\n')
    refused("fly", ref, "--world", "w.toml", code=2, parts=["w.toml", "magnetism"], problems=None)


# Waypoints that cannot be reached.


def route(tmp_path: Path, waypoints: str, total_time_s: float, more: str = "") -> str:
    text = f'name = "r"\ntotal_time_s = {total_time_s}\nwaypoints_m = {waypoints}\n{more}'
    (tmp_path / "r.toml").write_text(text)
    return "r.toml"


@pytest.mark.parametrize("kind", ["min-snap", "min-control", "min-control-r", "min-residual"])
@pytest.mark.parametrize(
    ("waypoints", "time_s", "more", "parts"),
    [
        ("[[0.0, 0.0, -1.0], [50.0, 0.0, -1.0]]", 30.0, "", ["waypoints_m[1]: north 50 m is outside"]),
        ("[[0.0, 0.0, -1.0], [9.0, 0.0, -1.0]]", 0.5, "", ["needs 18.0 m/s, the limit is 10; give it more"]),
        (
            "[[0.0, 0.0, -1.0], [3.0, 0.0, -1.0]]",
            5.0,
            '[[keep_out]]\nkind = "sphere"\ncentre_m = [3.0, 0.0, -1.0]\nradius_m = 0.5\n',
            ["waypoints_m[1]", "keep_out[0]"],
        ),
        (
            "[[0.0, 0.0, -1.0], [3.0, 0.0, -1.0], [3.0, 2.0, -1.0]]",
            5.0,
            "[[gates]]\nwaypoint = 5\nradius_m = 0.3\n",
            ["r.toml", "gates[0].waypoint: 5 is no waypoint between", "give one of 1 to 1"],
        ),
        (
            "[[0.0, 0.0, -1.0], [3.0, 0.0, -1.0]]",
            5.0,
            "[limits]\nthrust_headroom = [0.1, 0.2]\n",
            ["r.toml", "limits.thrust_headroom: [0.1, 0.2] is without hover, 0.217"],
        ),
    ],
    ids=["outside the fence", "too fast", "inside a shape", "gate for no waypoint", "headroom below hover"],
)
def test_route_that_contradicts_itself_is_refused_before_solving(
    refused: Refused,
    tmp_path: Path,
    drag_model: str,
    waypoints: str,
    time_s: float,
    more: str,
    parts: list[str],
    kind: str,
) -> None:
    words = ("plan", route(tmp_path, waypoints, time_s, more), "--kind", kind, "--model", drag_model)
    refused(*words, code=2, parts=parts)


def test_waypoints_out_of_reach_in_time_name_node_and_reason(refused: Refused, tmp_path: Path) -> None:
    quick = route(tmp_path, "[[0.0, 0.0, -1.0], [4.0, 0.0, -1.0], [0.0, 3.0, -1.5]]", 1.6)
    complaint = refused("plan", quick, "--kind", "min-snap", code=1, parts=["node 0 at 0.000 s", "rotor"])
    assert "give it more time: --time-s, or --stretch" in complaint


# Logs: cut anywhere, of another vehicle, mixed, with too little in them.


@pytest.mark.parametrize("share", [0.0, 1e-5, 0.02, 0.5, 0.999])
@pytest.mark.parametrize(
    "verb",
    [("trace",), ("learn",), ("log", "info"), ("log", "export"), ("trace", "flight.mcap", "--hold-out")],
)
def test_log_cut_anywhere_names_the_way_out(
    refused: Refused, log: str, tmp_path: Path, verb: tuple[str, ...], share: float
) -> None:
    content = (tmp_path / log).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: int(share * len(content))])
    way_out = (
        "run `trimtab log recover cut.mcap`" if share > 1e-3 else "give a flight log written by trimtab fly"
    )
    refused(*verb, "cut.mcap", code=5, parts=["cut.mcap: ", way_out])


def test_log_cut_at_any_byte_is_never_read_as_a_flight(log: str, tmp_path: Path) -> None:
    content = (tmp_path / log).read_bytes()
    cuts = [*range(40), *random.Random(7).sample(range(40, len(content)), 60), len(content) - 1]
    path = tmp_path / "cut.mcap"
    for length in cuts:
        path.write_bytes(content[:length])
        with pytest.raises(LogError) as caught:
            read_flight(path)
        assert caught.value.exit_code == 5
        assert "\n" not in str(caught.value)


def test_cut_log_that_is_recovered_can_be_read(
    run: Callable[..., tuple[int, dict[str, Any], str]], refused: Refused, log: str, tmp_path: Path
) -> None:
    content = (tmp_path / log).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: len(content) // 2])
    assert run("log", "recover", "cut.mcap")[0] == 0
    assert run("log", "info", "cut.recovered.mcap")[1]["recovered"]
    (tmp_path / "stub.mcap").write_bytes(content[:3000])
    refused("log", "recover", "stub.mcap", code=5, parts=["nothing can be recovered; fly again"])


def test_file_that_is_no_log_is_unreadable(refused: Refused, ref: str) -> None:
    for verb in (("trace",), ("learn",), ("log", "info"), ("log", "recover")):
        refused(*verb, ref, code=5, parts=["eight.ref: is not an MCAP file", "`trimtab import eight.ref`"])


@pytest.mark.parametrize(
    "words",
    [
        ("trace", "nowhere.mcap"),
        ("learn", "nowhere.mcap"),
        ("log", "info", "nowhere.mcap"),
        ("log", "recover", "nowhere.mcap"),
        ("log", "export", "nowhere.mcap"),
        ("show", "nowhere.mcap"),
        ("lineage", "nowhere.mcap"),
        ("compare", "nowhere.mcap", "nowhere.mcap"),
        ("predict", "nowhere.model.toml", "nowhere.mcap"),
        ("vehicle", "check", "nowhere.mcap"),
        ("import", "nowhere.bag"),
        ("import", "csv", "nowhere.csv", "--columns", "map.toml"),
        ("import", "rosbag", "nowhere.bag", "--vehicle", "nano", "-o", "x.mcap"),
        ("plan", "nowhere.toml"),
        ("plan", "figure-eight", "--model", "nowhere.model.toml"),
        ("fly", "nowhere.ref"),
        ("correct", "nowhere.model.toml"),
        ("export", "nowhere.ref", "--format", "crazyflie"),
    ],
    ids=lambda words: "-".join(words[:2]),
)
def test_missing_input_file_has_one_exit_code(
    refused: Refused, tmp_path: Path, words: tuple[str, ...]
) -> None:
    (tmp_path / "map.toml").write_text(MAP)
    refused(*words, code=2, parts=["nowhere."])


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("import", "csv", "hover.csv"), 2),
        (("import", "csv", "hover.csv", "--columns", "map.toml"), 5),
    ],
)
def test_import_of_what_cannot_be_imported_fails_without_output_too(
    run: Callable[..., tuple[int, dict[str, Any], str]], tmp_path: Path, words: tuple[str, ...], code: int
) -> None:
    (tmp_path / "map.toml").write_text(MAP)
    (tmp_path / "hover.csv").write_text("t,x\n0,1\n1,1\n2,1\n")
    ended, answer, complaint = run(*words)
    assert ended == code
    assert answer["problem"] == complaint.strip().removeprefix("trimtab: ")
    assert run(*words, "--vehicle", "nano", "-o", "x.mcap")[0] == code


@pytest.mark.parametrize("verb", [("trace",), ("learn",), ("log", "info"), ("log", "recover"), ("show",)])
def test_bag_of_ros_names_its_import(
    refused: Refused, ref: str, tmp_path: Path, verb: tuple[str, ...]
) -> None:
    pytest.importorskip("rosbags", reason="rosbags is not installed; pip install -e '.[logs]'")
    write_bag(read_reference(tmp_path / ref), 20.0, tmp_path / "bag")
    inside = tmp_path / "bag" / "bag.mcap"
    (tmp_path / "ros.mcap").write_bytes(inside.read_bytes())
    refused(*verb, "ros.mcap", code=5, parts=["another program", "`trimtab import ros.mcap`"])
    (tmp_path / "cut.mcap").write_bytes(inside.read_bytes()[:-100])
    refused(*verb, "cut.mcap", code=5, parts=["another program", "`trimtab import cut.mcap`"])
    if verb != ("show",):  # takes a folder as one of logs
        refused(*verb, "bag", code=5, parts=["is a folder", "`trimtab import bag`"])


def test_log_of_another_vehicle_is_refused(refused: Refused, log: str) -> None:
    parts = ["flight.mcap: a log of vehicle research", "not of nano"]
    refused("trace", log, "--vehicle", "nano", code=2, parts=parts, refusal="mixed-vehicles")
    refused("trace", log, "--vehicle", "nano", "-o", "out", code=2, parts=parts, refusal="mixed-vehicles")


def test_reference_and_model_of_another_vehicle_are_refused(
    refused: Refused, ref: str, tmp_path: Path
) -> None:
    refused("fly", ref, "--vehicle", "nano", code=2, parts=["was made for vehicle", "--vehicle"])
    nano = load_vehicle("nano")
    write_model(Model(vehicle_id=nano.id, vehicle_name="nano"), tmp_path / "m.model.toml")
    refused("plan", "figure-eight", "--model", "m.model.toml", code=2, parts=["m.model.toml", nano.id])


def test_model_with_a_parameter_its_effect_lacks_is_refused(
    refused: Refused, vehicle: Vehicle, tmp_path: Path
) -> None:
    wrong = Model(
        vehicle_id=vehicle.id,
        vehicle_name=vehicle.name,
        effects={"linear-drag": {"dq": 0.4}},
        assessment=Assessment(verdict="traced"),
    )
    write_model(wrong, tmp_path / "m.model.toml")
    parts = ["m.model.toml: linear-drag has no parameter dq; it has dx, dy, dz"]
    refused("plan", "figure-eight", "--model", "m.model.toml", code=2, parts=parts)


def test_logs_of_several_vehicles_are_refused_together(
    refused: Refused, log: str, foreign: Callable[..., str]
) -> None:
    other = foreign(THRUST)
    refused(
        "trace",
        log,
        other,
        code=2,
        parts=["foreign.mcap: a log of vehicle nano", "separately"],
        refusal="mixed-vehicles",
    )
    refused(
        "trace",
        log,
        "--hold-out",
        other,
        code=2,
        parts=["foreign.mcap: a log of vehicle nano"],
        refusal="mixed-vehicles",
    )
    refused("learn", log, other, code=2, parts=["foreign.mcap"])


def test_log_held_out_and_used_is_refused(refused: Refused, log: str) -> None:
    refused(
        "trace",
        log,
        "--hold-out",
        log,
        code=2,
        parts=["the same flight as", "give it once"],
        refusal="log-given-twice",
    )
    refused("learn", log, log, code=2, parts=["the same flight as", "give it once"])


def test_source_imported_twice_is_refused_as_the_same_flight(
    refused: Refused, foreign: Callable[..., str], run: Callable[..., Any], tmp_path: Path
) -> None:
    one = foreign(THRUST)
    (tmp_path / "hover.csv").rename(tmp_path / "renamed.csv")
    (tmp_path / "map.toml").write_text(MAP + 'thrust_n = "m"\n')
    assert run(*import_of("renamed.csv"), "-o", "again.mcap")[0] == 0
    parts = ["again.mcap: the same flight as foreign.mcap; give it once"]
    refused("trace", one, "--hold-out", "again.mcap", code=2, parts=parts, refusal="log-given-twice")


def test_recovered_copy_of_a_log_is_refused_as_the_same_flight(
    refused: Refused, log: str, tmp_path: Path
) -> None:
    content = (tmp_path / log).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: len(content) * 9 // 10])
    recover(tmp_path / "cut.mcap", tmp_path / "copy.mcap")
    parts = ["copy.mcap: the same flight as flight.mcap; give it once"]
    refused("trace", log, "copy.mcap", code=2, parts=parts, refusal="log-given-twice")
    refused("trace", log, "--hold-out", "copy.mcap", code=2, parts=parts, refusal="log-given-twice")
    refused("learn", log, "copy.mcap", code=2, parts=parts)
    refused("learn", log, "--hold-out", "copy.mcap", code=2, parts=parts)


def test_flights_without_noise_of_their_own_are_refused(refused: Refused, log: str, tmp_path: Path) -> None:
    """Of another session by its metadata, the copy is taken for a repeat flight with the same noise."""
    content = (tmp_path / log).read_bytes()
    uid = read_flight(tmp_path / log).metadata["session_uid"].encode()
    assert content.count(uid) == 1
    (tmp_path / "copy.mcap").write_bytes(content.replace(uid, uid[::-1]))
    refused("trace", log, "copy.mcap", code=2, parts=["the flights do not determine a fit"])


@pytest.mark.parametrize("more", ["", REFERENCE], ids=["no inputs", "reference only"])
def test_log_without_inputs_is_an_answer_with_what_poses_tell(
    run: Callable[..., tuple[int, dict[str, Any], str]], foreign: Callable[..., str], more: str
) -> None:
    code, told, complaint = run("trace", foreign(more))
    assert (code, complaint) == (0, "")
    assert told["drive"] == "inputs"
    assert "thrust-gain" not in {effect["name"] for effect in told["effects"]}


def test_flight_of_a_few_segments_is_too_little(refused: Refused, foreign: Callable[..., str]) -> None:
    parts, few = ["usable segments of 0.6 s; fly longer"], "too-few-segments"
    refused("trace", foreign(THRUST, seconds=2.5), code=2, parts=parts, refusal=few)
    refused("trace", foreign("", seconds=2.5), code=2, parts=parts, refusal=few)
    refused("learn", "foreign.mcap", code=2, parts=["foreign.mcap: no control telemetry"])


def test_verbs_without_a_log_say_so(refused: Refused) -> None:
    for verb in ("trace", "learn"):
        refused(verb, code=2, parts=["no log given; name one or more"])


# Outputs that are there already.


def test_output_that_exists_is_kept_unless_forced(
    refused: Refused, ref: str, log: str, tmp_path: Path
) -> None:
    for name in ("a.ref", "p.html", "b.mcap", "c.model.toml", "truth.json"):
        (tmp_path / name).write_text("mine")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "trace.html").write_text("mine")
    (tmp_path / "cut.mcap").write_bytes((tmp_path / log).read_bytes()[:200_000])
    hover_csv(tmp_path / "hover.csv")
    (tmp_path / "map.toml").write_text(MAP)
    for words in (
        ("plan", "figure-eight", "-o", "a.ref"),
        ("plan", "figure-eight", "--report", "p.html"),
        ("fly", ref, "-o", "b.mcap"),
        ("learn", log, "-o", "c.model.toml"),
        ("trace", log, "-o", "out"),
        (*IMPORT, "-o", "b.mcap"),
        ("log", "recover", "cut.mcap", "-o", "b.mcap"),
        ("sitl", "--port", "pty", "--truth", "truth.json"),
    ):
        refused(*words, code=2, parts=["exists; choose another name or add --force"])
        refused(
            *(word.replace(".", "/no/", 1) if word == words[-1] else word for word in words), code=2, parts=[]
        )


def test_log_that_is_not_named_like_one_is_refused(refused: Refused, ref: str, tmp_path: Path) -> None:
    hover_csv(tmp_path / "hover.csv")
    (tmp_path / "map.toml").write_text(MAP)
    for words in (("fly", ref), IMPORT):
        refused(
            *words,
            "-o",
            "foo.mcap.bad",
            code=2,
            parts=["foo.mcap.bad: give the flight log a name that ends in .mcap"],
        )


@pytest.mark.parametrize(
    ("verb", "option"), [("trace", "--hold-out"), ("learn", "--hold-out"), ("trace", "--baseline")]
)
def test_option_that_names_no_log_is_refused(refused: Refused, log: str, verb: str, option: str) -> None:
    refused(verb, log, option, code=2, parts=[f"{option} names no log; give one or more"])


def test_baseline_that_shares_a_flight_is_refused(refused: Refused, log: str) -> None:
    refused(
        "trace",
        log,
        "--baseline",
        log,
        code=2,
        parts=["the same flight as", "give it either as the baseline"],
        refusal="sets-share-a-flight",
    )


def test_workspace_with_a_file_for_a_folder_is_refused(refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "ws").mkdir()
    (tmp_path / "ws" / "effects").write_text("")
    refused(
        "plan", "pretzel", "--workspace", "ws", code=2, parts=["ws/effects: is a file where", "rename it"]
    )


def test_time_given_two_ways_is_refused(refused: Refused) -> None:
    words = ("plan", "pretzel", "--kind", "min-control", "--stretch")
    refused(*words, code=2, parts=["--stretch goes with min-snap, not with min-control"])


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("--report", "p.ref"), "p.ref: give the report a name that ends in .html"),
        (("--pareto",), "--pareto needs --model"),
        (("--pareto", "--model", "drag.model.toml", "-o", "x.ref"), "without --world does not take --output"),
        (("--pareto", "--model", "drag.model.toml", "--stretch"), "does not take --stretch"),
        (("--world", "quiet"), "--world needs --pareto"),
        (("--pareto", "--model", "drag.model.toml", "--world-seed", "3"), "--world-seed needs --world"),
        (("--pareto", "--model", "drag.model.toml", "--world", "nosuch"), "nosuch: no such world"),
        (
            ("--pareto", "--model", "drag.model.toml", "--world", "quiet", "-o", "drag.model.toml"),
            "drag.model.toml: is a file",
        ),
        (
            ("--pareto", "--model", "drag.model.toml", "--kind", "min-snap"),
            "the trade is that of min-residual",
        ),
    ],
)
def test_plan_options_that_do_not_go_together_are_refused(
    refused: Refused, drag_model: str, words: tuple[str, ...], part: str
) -> None:
    refused("plan", "hover-turns", *words, code=2, parts=[part])


def test_import_of_poses_that_never_change_says_what_to_check(refused: Refused, tmp_path: Path) -> None:
    rows = [f"{0.01 * k},0,0,1,1,0,0,0" for k in range(400)]
    (tmp_path / "still.csv").write_text("\n".join(["t,x,y,z,qw,qx,qy,qz", *rows]))
    (tmp_path / "map.toml").write_text(MAP)
    parts = ["still.csv: fewer than two different poses", "check the columns of time, position and attitude"]
    refused(*import_of("still.csv"), "-o", "x.mcap", code=5, parts=parts)


def test_import_of_a_short_flight_is_too_little(refused: Refused, tmp_path: Path) -> None:
    hover_csv(tmp_path / "short.csv", seconds=1.5)
    (tmp_path / "map.toml").write_text(MAP)
    parts = ["short.csv: airborne for 1.5 s, but 2 s are needed"]
    refused(*import_of("short.csv"), "-o", "x.mcap", code=2, parts=parts)


def test_import_without_a_vehicle_says_what_to_give(refused: Refused, tmp_path: Path) -> None:
    hover_csv(tmp_path / "hover.csv")
    (tmp_path / "map.toml").write_text(MAP)
    (tmp_path / "vehicles").mkdir()
    (tmp_path / "vehicles" / "mine.toml").write_text(load_vehicle("nano").to_toml())
    words = [word for word in IMPORT if word not in ("--vehicle", "nano")]
    parts = ["which vehicle flew? give --vehicle one of mine, nano, research, or the .toml file"]
    refused(*words, "-o", "x.mcap", code=2, parts=parts)
    assert not (tmp_path / "x.mcap").exists()


def test_bench_without_courses_is_refused(refused: Refused) -> None:
    refused("bench", "--courses", "0", code=2, parts=["--courses 0: give 1 or more"])


def test_demo_refused_makes_no_folder(refused: Refused, ref: str) -> None:
    refused("demo", "--world", "atlantis", code=2, parts=["atlantis: no such world"])
    refused("demo", "-o", f"{ref}/demo", code=2, parts=["eight.ref is a file; choose another folder"])
    refused("demo", "--seed", "-1", code=2, parts=["--seed -1 is negative"])
    refused("demo", "-o", ref, code=2, parts=["eight.ref: is a file; give a folder"])
    refused("demo", "-o", ".", code=2, parts=["is not empty; choose another folder or add --force"])
    refused("demo", "--vehicle", "none", code=2, parts=["none: no such vehicle"])


# Ports.


@pytest.fixture
def terminal(require: Callable[[str], None]) -> Iterator[tuple[int, str]]:
    """A pseudo terminal without echo: the descriptor of our end, and the name of the other."""
    require("pty")
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    name = os.ttyname(theirs)
    try:
        yield ours, name
    finally:
        os.close(ours)
        os.close(theirs)


@contextlib.contextmanager
def speaking(terminal: int, speech: Callable[[], bytes]) -> Iterator[None]:
    """Says `speech` at the terminal ten times a second and takes what is written there."""
    stop = threading.Event()

    def speak() -> None:
        while not stop.is_set():
            with contextlib.suppress(OSError):
                if select.select([terminal], [], [], 0.1)[0]:
                    os.read(terminal, 65536)
                if select.select([], [terminal], [], 0.0)[1]:
                    os.write(terminal, speech())

    thread = threading.Thread(target=speak)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


@pytest.fixture
def fly_words(ref: str, mocap_url: str) -> Callable[[str], tuple[str, ...]]:
    return lambda port: ("fly", ref, "--port", port, "--mocap", mocap_url, "-o", "x.mcap")


@pytest.mark.realtime
def test_port_in_silence_is_no_vehicle(refused: Refused, ref: str, terminal: tuple[int, str]) -> None:
    with speaking(terminal[0], bytes):
        refused(
            "upload", ref, "--port", terminal[1], code=3, parts=[terminal[1], "nothing was received in 5 s"]
        )


@pytest.mark.realtime
def test_port_with_something_else_is_no_vehicle(
    refused: Refused, fly_words: Callable[[str], tuple[str, ...]], terminal: tuple[int, str]
) -> None:
    noise = random.Random(3)
    with speaking(terminal[0], lambda: noise.randbytes(200)):
        refused(*fly_words(terminal[1]), code=3, parts=["bytes that are not MAVLink", "check port and baud"])


def heartbeat(autopilot: int, custom_mode: int) -> bytes:
    codec = Codec(*m.VEHICLE)
    return codec.encode(m.Heartbeat(m.mavlink.MAV_TYPE_QUADROTOR, autopilot, 1, custom_mode, 3, 3))


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("answer", "parts"),
    [
        (
            heartbeat(
                m.mavlink.MAV_AUTOPILOT_GENERIC,
                m.vehicle_heartbeat(1, armed=False).custom_mode + (1 << 4),
            ),
            [f"speaks version {m.DIALECT_VERSION + 1} of the dialect", "bring both to the same release"],
        ),
        (
            heartbeat(m.mavlink.MAV_AUTOPILOT_GENERIC, 0x54020001),  # as versions 1 and 2 laid it out
            ["speaks version 2 of the dialect", "bring both to the same release"],
        ),
        (heartbeat(3, 0), ["this MAVLink vehicle does not speak Trimtab's dialect"]),
    ],
    ids=["another version", "an older layout", "another make"],
)
def test_port_with_another_dialect_is_refused_at_once(
    refused: Refused,
    ref: str,
    fly_words: Callable[[str], tuple[str, ...]],
    terminal: tuple[int, str],
    answer: bytes,
    parts: list[str],
) -> None:
    with speaking(terminal[0], lambda: answer):
        refused("upload", ref, "--port", terminal[1], code=3, parts=[terminal[1], *parts])
        refused(*fly_words(terminal[1]), code=3, parts=[terminal[1], *parts])


@pytest.mark.realtime
def test_blob_for_another_vehicle_than_the_ports_is_refused(
    refused: Refused,
    ref: str,
    fly_words: Callable[[str], tuple[str, ...]],
    vehicle: Vehicle,
    require: Callable[[str], None],
) -> None:
    require("pty")
    words = [sys.executable, "-m", "trimtab.host.cli", "sitl", "--port", "pty", "--vehicle", "nano"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=HERE.parent.parent)
    assert process.stdout is not None
    try:
        port = process.stdout.readline().strip()
        wanted = (
            f"the reference is for the research ({vehicle.id}); make it again with --vehicle nano, or check"
        )
        refused("upload", ref, "--port", port, code=2, parts=[f"{port} is the nano (", wanted])
        refused(*fly_words(port), code=2, parts=[f"{port} is the nano (", wanted])
    finally:
        process.terminate()
        process.communicate(timeout=60)


def test_sitl_refused_leaves_no_truth(refused: Refused) -> None:
    refused("sitl", "--port", "foo", "--truth", "t.json", code=2, parts=["foo", "give pty"])
    for place in (("nan", "0"), ("0", "inf")):
        refused("sitl", "--port", "pty", "--start", *place, code=2, parts=["--start", "two numbers in m"])
    outside = ["--start 0 -10.5: east -10.5 m is outside the fence of research; give -10 to 10"]
    refused("sitl", "--port", "pty", "--start", "0", "-10.5", code=2, parts=outside)


def test_port_that_cannot_be_opened_is_a_link_error(
    refused: Refused, ref: str, fly_words: Callable[[str], tuple[str, ...]]
) -> None:
    for port, part in (
        ("/dev/null", "serial port"),
        ("no-device", "serial port"),
        ("tcp:127.0.0.1:1", "reached"),
    ):
        refused("upload", ref, "--port", port, code=3, parts=[port, part])
        refused(*fly_words(port), code=3, parts=[port, part])


# Ctrl-C.


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("realtime", "number"),
    [(False, signal.SIGTERM), (True, signal.SIGINT)],
    ids=["lock-step", "real time"],
)
def test_flight_interrupted_in_the_air_leaves_a_readable_log(
    require: Callable[[str], None],
    figure_eight: Callable[..., Reference],
    vehicle: Any,
    tmp_path: Path,
    realtime: bool,
    number: signal.Signals,
) -> None:
    require("pty")
    slow = figure_eight(vehicle, duration_s=10.0 if realtime else 120.0)
    (tmp_path / "slow.ref").write_bytes(slow.to_bytes())
    words = ["fly", "slow.ref", "-o", "x.mcap", "--json", *(["--realtime"] if realtime else [])]
    ours, theirs = os.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, b"\x20\x00\xc8\x00" + bytes(4))
    process = subprocess.Popen(
        [sys.executable, "-m", "trimtab.host.cli", *words],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=theirs,
        text=True,
        env={**os.environ, "PYTHONPATH": str(HERE.parent.parent)},
    )
    os.close(theirs)
    shown = b""
    try:
        # The progress bar says when the flight has come to its tracking phase. A phase with a single status,
        # which may be that of its first tick, is none.
        while shown.count(b"tracking") < 4:
            assert select.select([ours], [], [], 60.0)[0], shown
            shown += os.read(ours, 65536)
        process.send_signal(number)
        with contextlib.suppress(OSError):  # the terminal ends with the process
            while part := os.read(ours, 65536):
                shown += part
        said, _ = process.communicate(timeout=60)
    finally:
        process.kill()
        os.close(ours)
    assert process.returncode == 130
    told = json.loads(said.strip().splitlines()[-1])
    assert (told["log"], told["interrupted"], told["whole"]) == ("x.mcap", True, False)
    end = "trimtab: interrupted; the vehicle has landed; its log is x.mcap"
    assert (end if realtime else "trimtab: interrupted; its log is x.mcap") in shown.decode()
    assert (b"trimtab: landing; Ctrl-C again leaves" in shown) == realtime
    flight = read_flight(tmp_path / "x.mcap")
    assert flight.tracking is not None
    assert not flight.tracking_whole
    assert flight.mocap is not None
    if realtime:  # the vehicle was told to land first
        assert abs(flight.mocap.p[-1, 2]) < 0.1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["slow.ref", "x.mcap", "x.mcap.truth.json"]
