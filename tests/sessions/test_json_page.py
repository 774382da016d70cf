"""docs/reference/json.md names every key that the verbs really print, and no other."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.host.apps.paper.controllers.made_up import pieces as controller_pieces
from tests.host.apps.paper.flight.made_up import made_up_world
from tests.sitl.studies.labels.made_up import made_up_world as made_up_labels
from trimtab.host import cli
from trimtab.host.apps.bench import control, machine, planning, table, tracing
from trimtab.host.apps.bench import flown as bench_flown
from trimtab.host.apps.bench import learning as bench
from trimtab.host.apps.bench.session import realtime_factor
from trimtab.host.apps.demo.compare import Comparison
from trimtab.host.apps.paper.controllers.summary import summary as controllers_summary
from trimtab.host.apps.paper.flight.summary import summary as flight_summary
from trimtab.host.apps.paper.learning import noise
from trimtab.host.apps.paper.learning.summary import summary as paper_summary
from trimtab.host.apps.paper.planning.compare import CLOSED_FORM, KINDS, NETWORKS
from trimtab.host.apps.paper.planning.summary import summary as planning_summary
from trimtab.host.apps.paper.tuning.summary import summary as tuning_summary
from trimtab.host.apps.paper.tuning.table import QUICK
from trimtab.host.base.parts import part_path
from trimtab.host.compare.prediction import Drift
from trimtab.host.link.download import Download
from trimtab.host.link.upload import UploadResult
from trimtab.host.log import read_flight
from trimtab.host.models.file import read_model, write_model
from trimtab.host.vehicle import load_vehicle
from trimtab.protocol.blobs import Reference
from trimtab.sitl.studies.labels.summary import NEURAL
from trimtab.sitl.studies.labels.summary import summary as labels_summary
from trimtab.sitl.studies.link import summary as link_summary
from trimtab.sitl.studies.recorded import Group, real_row
from trimtab.sitl.studies.scoring import correction
from trimtab.sitl.studies.scoring.labelled import score_row
from trimtab.sitl.studies.scoring.labelled import summary as labelled_summary
from trimtab.sitl.studies.scoring.metrics import baseline_rows, summary
from trimtab.sitl.studies.upload_cuts import INTERRUPTIONS
from trimtab.sitl.studies.upload_flight import RADIOS
from trimtab.sitl.studies.uploads import CHANNELS

ROOT = Path(__file__).parent.parent.parent
MADE = ROOT / "tests" / "data"
PAGE = (ROOT / "docs" / "reference" / "json.md").read_text(encoding="utf-8")
Steps = tuple[str, ...]


def documented(verb: str) -> list[Steps]:
    """Every key of a verb's table as steps, `[]` a step of its own."""
    (section,) = re.findall(rf"^## {verb}\n(.*?)(?=^## |\Z)", PAGE, flags=re.MULTILINE | re.DOTALL)
    keys = re.findall(r"^\| `([^`]+)` \| ([^|]*)\|", section, flags=re.MULTILINE)
    return [tuple(key.replace("[]", ".[]").split(".")) for key, _ in keys]


def leaves(value: Any, at: Steps = ()) -> Iterator[tuple[Steps, Any]]:
    """Every number, text, null or empty container with the steps to it."""
    if isinstance(value, dict) and value:
        for key, inner in value.items():
            yield from leaves(inner, (*at, key))
    elif isinstance(value, list) and value:
        for inner in value:
            yield from leaves(inner, (*at, "[]"))
    else:
        yield at, value


def fits(steps: Steps, key: Steps) -> bool:
    """Whether steps that were printed are those of a documented key, or lead towards it."""
    return len(steps) <= len(key) and all(
        wanted == step or wanted.isupper() for step, wanted in zip(steps, key, strict=False)
    )


def check(verb: str, told: dict[str, Any], *more: Steps) -> None:
    """Holds the page against what was printed."""
    keys = [*documented(verb), *more]
    found = list(leaves(told))
    for steps, value in found:
        whole = [key for key in keys if fits(steps, key)]
        assert whole, f"{verb} prints {'.'.join(steps)}, which the page does not name"
        # Only what is absent may end before the key does.
        assert any(len(key) == len(steps) for key in whole) or value in (None, [], {}), steps
    for key in keys:
        assert any(fits(steps, key) for steps, _ in found), f"{verb} prints no {'.'.join(key)}"


@pytest.fixture
def log(tmp_path: Path, flown: Any) -> str:
    (tmp_path / "flight.mcap").write_bytes(flown[0].log.read_bytes())
    return "flight.mcap"


def test_page_has_a_table_for_every_verb() -> None:
    titles = re.findall(r"^## (\w+)", PAGE, flags=re.MULTILINE)
    assert set(titles) == {verb.name for verb in cli.VERBS}


@pytest.fixture
def hop(tmp_path: Path) -> str:
    (tmp_path / "hop.toml").write_text(
        'name = "hop"\ntotal_time_s = 2.0\nwaypoints_m = [[0.0, 0.0, -1.0], [1.0, 0.0, -1.2]]\n'
    )
    return "hop.toml"


def test_plan_and_fly_print_what_the_page_says(
    trimtab: Callable[..., dict[str, Any]], hop: str, drag_model: str
) -> None:
    known = ("--model", drag_model, "--kind", "min-snap")
    check("plan", trimtab("plan", hop, *known, "-o", "hop.ref", "--report", "hop.html"))
    check("fly", trimtab("fly", "hop.ref", "-o", "hop.mcap"))


def test_init_prints_what_the_page_says(trimtab: Callable[..., dict[str, Any]], tmp_path: Path) -> None:
    check("init", trimtab("init", "lab"))
    assert trimtab("init", "lab")["made"] == []
    (tmp_path / "lab" / "README.md").write_text("mine")
    (tmp_path / "lab" / "effects").rmdir()
    assert trimtab("init", "lab")["made"] == ["lab/effects"]
    assert (tmp_path / "lab" / "README.md").read_text() == "mine"
    trimtab("plan", "square", "--workspace", "lab", "-o", "square.ref")


def test_doctor_prints_what_the_page_says(trimtab: Callable[..., dict[str, Any]]) -> None:
    check("doctor", trimtab("doctor"))


def test_export_prints_what_the_page_says(trimtab: Callable[..., dict[str, Any]], hop: str) -> None:
    trimtab("plan", hop, "-o", "hop.ref")
    for form in ("csv", "crazyflie"):
        told = trimtab("export", "hop.ref", "--format", form)
        assert {(name,) for name in told} | {("samples",)} <= {key[:1] for key in documented("export")}


def test_key_new_prints_what_the_page_says(trimtab: Callable[..., dict[str, Any]]) -> None:
    check("key new", trimtab("key", "new", "lab.key"))
    assert set(documented("key install")) == {("file",), ("port",)}  # what test_pty.py sees printed
    assert set(documented("key revoke")) == {("port",)}


def test_fly_that_loses_its_link_prints_what_the_page_says(
    reference: Reference,
    world_file: Callable[[str], str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    world = world_file("[radio]\ncuts_s = [[6.0, 900.0]]\n")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "eight.ref").write_bytes(reference.to_bytes())
    assert cli.main(["fly", "eight.ref", "--world", world, "-o", "x.mcap", "--json"]) == 3
    told = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert "prints `log`, the log up to there, beside `error` and `exit_code`" in PAGE
    assert set(told) == {"log", "error", "exit_code"}
    assert read_flight(told["log"]).mocap is not None


def test_page_tells_a_whole_flight_from_a_whole_reference() -> None:
    said = re.findall(r"^\| `(?:tracking_)?whole` \| \| (.*) \|$", PAGE, flags=re.MULTILINE)
    assert len(said) == len(set(said)) == 2


def test_plan_pareto_prints_what_the_page_says(
    trimtab: Callable[..., dict[str, Any]], drag_model: str, hop: str
) -> None:
    words = ("plan", "hop.toml", "--model", drag_model, "--pareto")
    check("plan --pareto", trimtab(*words))
    flown = trimtab(*words, "--world", "quiet")
    check("plan --pareto", flown)
    assert flown["folder"] == "hop-pareto"
    assert all(point["error_mean_m"] > 0.0 for point in flown["points"])


def test_log_prints_what_the_page_says(
    trimtab: Callable[..., dict[str, Any]], log: str, tmp_path: Path
) -> None:
    check("log info", trimtab("log", "info", log))
    check("log export", trimtab("log", "export", log))
    check("log layout", trimtab("log", "layout"))
    check("watch", trimtab("watch", log))
    check("log recover", trimtab("log", "recover", log))
    (tmp_path / "cut.mcap").write_bytes((tmp_path / log).read_bytes()[:200_000])
    check("log recover", trimtab("log", "recover", "cut.mcap"))
    part_path(tmp_path / log).write_bytes((tmp_path / log).read_bytes()[:200_000])
    check("log info FOLDER", trimtab("log", "info", "."))


def test_show_prints_what_the_page_says(
    trimtab: Callable[..., dict[str, Any]], hop: str, log: str, drag_model: str, tmp_path: Path
) -> None:
    trimtab("plan", hop, "-o", "hop.ref")
    model = read_model(tmp_path / drag_model)
    assessment = replace(model.assessment, probabilities={"linear-drag": 1.0}) if model.assessment else None
    write_model(replace(model, assessment=assessment), tmp_path / "known.model.toml")
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "bad.mcap").write_bytes(b"no log")
    told = trimtab("show", log, "hop.ref", "known.model.toml", "bad")
    check("show", told)
    assert len(told["notes"]) == 1


def test_predict_prints_what_the_page_says(
    trimtab: Callable[..., dict[str, Any]], drag_model: str, tmp_path: Path
) -> None:
    told = trimtab("predict", drag_model, str(MADE / "a1.mcap"), str(MADE / "b1.mcap"))
    assert (told["drift"], told["diverged"], told["inactive"]) == (None, [], [])
    drift = {"slope_m_month": 0.0, "low_m_month": 0.0, "high_m_month": 0.0, "flights": 3, "days": 2.0}
    check("predict", {**told, "drift": drift})
    assert Drift(**drift).to_dict() == drift
    assert trimtab("predict", "nominal", str(MADE / "a1.mcap"))["model_file"] is None


def test_compare_prints_what_the_page_says(
    trimtab: Callable[..., dict[str, Any]], drag_model: str, hop: str, tmp_path: Path
) -> None:
    for folder, names in (("one", ("a1", "b1")), ("two", ("a2", "c1"))):
        (tmp_path / folder).mkdir()
        for name in names:
            (tmp_path / folder / f"{name}.mcap").write_bytes((MADE / f"{name}.mcap").read_bytes())
        trimtab("plan", hop, "-o", f"{folder}/hop.ref")
        (tmp_path / folder / drag_model).write_bytes((tmp_path / drag_model).read_bytes())
    model = read_model(drag_model)
    write_model(replace(model, effects={**model.effects, "wind": {"wx": 1.0}}), "two/b.model.toml")
    write_model(replace(model, effects={"wind": {"wx": 1.0}}), "one/b.model.toml")
    trimtab("plan", hop, "-o", "two/more.ref")
    (tmp_path / "two" / "bad.mcap").write_bytes(b"no log")
    check("compare", trimtab("compare", "one", "two"))


def test_lineage_prints_what_the_page_says(
    trimtab: Callable[..., dict[str, Any]], drag_model: str, log: str, tmp_path: Path
) -> None:
    trimtab("correct", drag_model, "-o", "drag.ff")
    (tmp_path / "drag.ff").rename(tmp_path / "copy.ff")
    (tmp_path / "drag.ff.json").rename(tmp_path / "copy.ff.json")
    trimtab("correct", drag_model, "-o", "drag.ff")
    (tmp_path / "cut.mcap").write_bytes((tmp_path / log).read_bytes()[:-1])
    told = trimtab("lineage", "drag.ff")
    (tmp_path / log).unlink()
    (tmp_path / "flight.json").write_text(
        json.dumps({"provenance": {"parents": {"feedforward": told["id"]}}})
    )
    check("lineage", {**trimtab("lineage", "drag.ff"), "missing": ["0" * 12]})
    assert told["copies"] == ["copy.ff"]


def test_vehicle_prints_what_the_page_says(
    trimtab: Callable[..., dict[str, Any]], log: str, tmp_path: Path
) -> None:
    (tmp_path / "quad.param").write_text("FRAME_CLASS,1\nFRAME_TYPE,1\n")
    known = ("--mass-kg", "0.75", "--arm-m", "0.125", "--propeller", "5x4.3", "--parameters", "quad.param")
    check("vehicle new", trimtab("vehicle", "new", "mine", *known))
    check("vehicle check", trimtab("vehicle", "check", log), ("differing", "[]"))


def test_trace_prints_what_the_page_says(trimtab: Callable[..., dict[str, Any]]) -> None:
    found = trimtab("trace", str(MADE / "b1.mcap"), "-o", "out")
    assert found["effects"]
    check("trace", found)


@pytest.mark.usefixtures("virtual_machine")
def test_learn_prints_what_the_page_says(trimtab: Callable[..., dict[str, Any]]) -> None:
    logs = (str(MADE / "a1.mcap"), "--hold-out", str(MADE / "b1.mcap"))
    check("learn", trimtab("learn", *logs, "-o", "x.model.toml", "--epochs", "1", "--hidden", "2"))
    used, held_out = (read_flight(MADE / name).id for name in ("a1.mcap", "b1.mcap"))
    assert read_model("x.model.toml").provenance["parents"] == {"log 0": used, "held-out log 0": held_out}


def test_import_prints_what_the_page_says(trimtab: Callable[..., dict[str, Any]], tmp_path: Path) -> None:
    rows = [f"{0.01 * k},{0.3 * k / 400:.4f},0,1,1,0,0,0,0.3" for k in range(400)]
    (tmp_path / "f.csv").write_text("\n".join(["t,x,y,z,qw,qx,qy,qz,T", *rows]))
    (tmp_path / "m.toml").write_text(
        'world = "nwu"\nbody = "flu"\ntime = "t"\nposition_m = ["x", "y", "z"]\n'
        'quaternion = ["qw", "qx", "qy", "qz"]\nthrust_n = "T"\n'
    )
    check(
        "import",
        trimtab("import", "csv", "f.csv", "--columns", "m.toml", "--vehicle", "nano", "-o", "f.mcap"),
    )


def test_upload_prints_what_the_page_says(reference: Reference) -> None:
    result = UploadResult(kind="reference", id=reference.id, seconds=0.1, frames_sent=9, frames_repeated=0)
    check("upload", result.to_json())


def test_download_prints_what_the_page_says(reference: Reference) -> None:
    data = reference.to_bytes()
    result = Download(name="reference", id=reference.id, data=data, seconds=0.1, repeated=0)
    check("download", {**result.to_json(), "file": "reference.ref"})


@contextmanager
def running(*words: str) -> Iterator[tuple[str, Callable[[], Any]]]:
    """First line of a verb that stays, in a process of its own, and a function that ends it: its JSON."""
    command = [sys.executable, "-m", "trimtab.host.cli", *words, "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    assert process.stdout is not None

    def end() -> Any:
        process.send_signal(signal.SIGTERM)
        said, _ = process.communicate(timeout=60)
        assert process.returncode == 0
        return json.loads(said.strip().splitlines()[-1])

    try:
        yield process.stdout.readline().strip(), end
    finally:
        process.kill()
        process.communicate()


def test_correct_prints_what_the_page_says(trimtab: Callable[..., dict[str, Any]], drag_model: str) -> None:
    model = read_model(drag_model)
    more = replace(model, effects={**model.effects, "com-offset": {"x": 0.01}})
    write_model(more, "more.model.toml")
    check("correct", trimtab("correct", "more.model.toml", "-o", "more.ff"))


def test_sitl_and_poses_print_what_the_page_says(mocap_url: str) -> None:
    with running("sitl", "--port", "udp:127.0.0.1:0", "--mocap", mocap_url) as (port, end):
        with running("poses", "--port", port, "--mocap", mocap_url) as (said, end_poses):
            assert said == f"forwarding poses from {mocap_url} to {port}"
            check("poses", end_poses())
        check("sitl", end())


def test_demo_prints_what_the_page_says(trimtab: Callable[..., dict[str, Any]], log: str) -> None:
    plan = SimpleNamespace(path_length_m=1.0, mean_speed_m_s=1.0)
    planned = SimpleNamespace(plan=plan, route=SimpleNamespace(name="r"))
    flight: Any = SimpleNamespace(
        label="first",
        log="1.mcap",
        rmse_m=0.1,
        max_m=0.2,
        stamped_rmse_m=0.1,
        predicted_rmse_m=None,
        clipped_share=0.0,
        battery_v=16.8,
        planned=planned,
    )
    compared = Comparison(first=(flight,), latency_s=0.0, no_new_plan="no", no_applied="no").to_json()
    told = {**trimtab("trace", log), **compared, "truth": "truth.html"}
    told |= {"seconds": 1.0, "steps": [{"step": "plan", "seconds": 1.0}]}
    check("demo", told, *documented("trace"))


def test_study_prints_what_the_page_says() -> None:
    row = {"effect": "wind", "key": "wx", "family": "aerodynamic", "turned": False, "true": 3.0, "drawn": 3.0}
    row |= {"estimate": 3.0, "sd": 0.1, "bound_sd": 0.1, "neutral": 0.0, "typical": 1.0}
    said = {"top1": True, "exact": True, "in_alias": True, "identifiable": True, "alias_sizes": [1]}
    said |= {"in_answer": True, "answer_size": 1}
    said |= {
        "verdict": "traced",
        "named": ["wind"],
        "before_m": 0.1,
        "after_m": 0.1,
        "floor_m": 0.1,
        "trace_s": 1.0,
        "wrong": False,
        "few": {},
        "redrawn": 0,
        "false_names": [],
        "detectable": True,
        "detection": [{"effect": "wind", "sigma": 5.0, "tolerances": 20.0, "found": True}],
        "probabilities": [{"name": "wind", "probability": 0.98, "there": True}],
    }
    scores = [
        {
            "world": "0000",
            "class": name,
            "kinds": ["wind"],
            "parameters": [row],
            "few": {},
            "redrawn": 0,
            "false_names": [],
            "detectable": True,
            "detection": [{"effect": "wind", "sigma": 5.0, "tolerances": 20.0, "found": True}],
            **said,
        }
        for name in ("single", "pair", "none", "outside")
    ]
    scores[0]["baselines"] = {"network": {"names": None, "first_right": None, "exact": None, "after_m": 0.1}}
    for score in scores[1:]:
        score["baselines"] = None
    told = {"study": "blind", "seed": 1, "worlds": 4, "first": None, "plant": None}
    told |= {"folder": "f", "report": "f/report.html"}
    told |= {"secret": None, "secret_sha256": None}
    group = Group(name="g", logs=("a.mcap",), hold_out=("b.mcap",))
    refused = {"answer": {}, "errors": "", "exit_code": 2, "trace_s": 1.0}
    beside = {"baselines": baseline_rows(scores), "real": [real_row(group, refused)]}
    check("study", {**told, **summary(scores), **beside})


def test_study_real_prints_what_the_page_says() -> None:
    group = Group(name="g", label="cut", logs=("a.mcap",), expected=(("rotor-loss",),))
    refused = {"answer": {}, "errors": "too short", "exit_code": 2, "trace_s": None}
    row = real_row(group, refused)
    row |= score_row(row, group.expected)
    check(
        "study real",
        {"study": "real", "folder": "f", "report": "r", **labelled_summary([row]), "groups": [row]},
    )


def test_study_correction_prints_what_the_page_says() -> None:
    flight = {"whole": True, "rmse_m": 0.1, "stamped_rmse_m": 0.1, "faded_s": 0.0}
    score = {
        "models": {name: {"id": "0" * 12, "verdict": "traced"} for name in correction.MODELS},
        "flights": [{"uncorrected": flight, **dict.fromkeys(correction.MODELS, flight)}],
    }
    told = {"study": "correction", "seed": 1, "worlds": 2, "quick": False, "folder": "f", "report": "r.html"}
    check("study correction", {**told, **correction.summary({"0000": score, "0001": score}, 1)})


def test_study_labels_prints_what_the_page_says() -> None:
    told = {"study": "labels", "seed": 1, "worlds": 3, "quick": False, "folder": "f"}
    worlds = [made_up_labels(0, failed=(NEURAL, 1)), made_up_labels(1), made_up_labels(2)]
    outcome = labels_summary(told, worlds)
    check("study labels", {**outcome["answer"], "report": "f/report.html"})


def test_study_link_prints_what_the_page_says() -> None:
    upload = {"seconds": 0.6, "answered_s": 0.02}
    flight = {"seconds": 2.0, "slot_share": 0.2, "mocap_delays_us": [0, 1000]}
    trial = {"failed": False, "resent": 0, "held": 9, "seconds": 0.3}
    found = {
        **{channel: [upload] for channel in CHANNELS},
        **{channel: [flight] for channel in RADIOS},
        "cuts": [dict.fromkeys(INTERRUPTIONS, trial)],
        "fuzz": [{"inputs": 9, "crashes": []}],
    }
    outcome = link_summary({"seed": 1, "quick": True, "folder": "f"}, found)
    check("study link", {**outcome["answer"], "report": "f/report.html"})


def test_study_paper_learning_prints_what_the_page_says() -> None:
    errors = {name: {"pointwise_norm": 0.1, "rolled_norm": 0.2} for name in ("train", "test", "ood")}
    for each in errors.values():
        each |= {"pointwise_component": 0.1, "rolled_component": 0.1}
    flown = {"position_rmse_m": 0.1, "velocity_rmse_m_s": 0.1}
    methods = {name: flown for name in ("nominal", "paper", "hybrid", "body")}
    moves = {f"{q}_{w}": 1.0 for q in ("speed_m_s", "acceleration_m_s2", "jerk_m_s3") for w in ("mean", "sd")}
    law = {"acceleration_rmse": 0.1, "position_rmse_m": 0.1, "nominal_position_rmse_m": 0.1}
    pieces: dict[str, Any] = {
        "nominal": errors,
        "curve-0": {"weight": "identity", "held": False, "seconds": 1.0, "errors": errors},
        "regressor-0": {"regressor": "r", "iterations": 9, "seconds": 1.0, "errors": errors},
        "noise-0": [
            {"regressor": "r", "scale": 1.0, "method": method, "test": 0.1, "ood": 0.1}
            for method in (
                noise.TRAJECTORY, noise.TRAJECTORY_RAW, noise.SUPERVISED, noise.SUPERVISED_RAW
            )
        ],
        "transfer": {
            "steps": [{"step_s": 0.02, "position_rmse_m": 0.1}],
            "laws": [{"law": "a", "network": "n", "test": law, "ood": law}],
        },
        "world-00": {
            "errors": {name: methods for name in ("train", "test", "ood")},
            "kept": dict.fromkeys(("paper", "hybrid", "body"), "network"),
            "flights": {"train": 13, "test": 3, "ood": 2},
            "failed": [{"flight": "ood-0", "why": "tilted"}],
            "statistics": {"known": moves, "ood": moves},
        },
    }  # fmt: skip
    told = {"study": "paper-learning", "seed": 1, "worlds": 1, "quick": False, "folder": "f"}
    outcome = paper_summary(told, {name: {"result": piece} for name, piece in pieces.items()})
    check("study paper-learning", {**outcome["answer"], "report": "f/report.html"})


def test_study_paper_planning_prints_what_the_page_says() -> None:
    keys = (
        "residual_mean_m_s2", "drag_mean_n", "first_solve_s", "solve_s", "iterations", "path_length_m",
        "mean_speed_m_s", "jerk_max_m_s3", "outside_region", "error_mean_m", "error_max_m", "clipped_share",
    )  # fmt: skip
    course = {"course": "c", "kinds": {kind: dict.fromkeys(keys, 1.0) for kind in KINDS}}
    refused = {**course, "kinds": {**course["kinds"], "min-control": {"failed": "no way"}}}
    either = {what: {kind: dict.fromkeys(keys, 1.0) for kind in KINDS} for what in (CLOSED_FORM, *NETWORKS)}
    flown = {**course, "residuals": either}
    pieces = {"planned-00": course, "planned-01": refused, "world-00": {"courses": [flown]}}
    told = {"study": "paper-planning", "seed": 1, "worlds": 1, "quick": False, "folder": "f"}
    outcome = planning_summary(told, {name: {"result": piece} for name, piece in pieces.items()})
    check("study paper-planning", {**outcome["answer"], "report": "f/report.html"})


def test_study_controller_tuning_prints_what_the_page_says() -> None:
    lost = {"course": "pretzel", "pace": 0.8, "why": "tilted"}
    point = {"search": "dfbc", "controller": "dfbc-do", "factors": {"observer": 1.0}, "repetition": 0}
    flown = {
        "a": {"result": {**point, "errors_m": [0.1], "failed": []}},
        "b": {"result": {**point, "errors_m": [None], "failed": [lost]}},
    }
    tuned = {"dfbc": {"spread": 0.01, "parameters": {"observer": {"factor": 1.0, "best": 1.5, "gain": 0.0}}}}
    told = {"study": "controller-tuning", "seed": 1, "quick": True, "folder": "f"}
    outcome = tuning_summary(told, QUICK, tuned, flown, load_vehicle("research"))
    check("study controller-tuning", {**outcome["answer"], "report": "f/report.html"})


def test_study_paper_controllers_prints_what_the_page_says() -> None:
    told = {"study": "paper-controllers", "seed": 1, "worlds": 1, "quick": False, "folder": "f"}
    outcome = controllers_summary(told, controller_pieces(1, 1))
    check("study paper-controllers", {**outcome["answer"], "report": "f/report.html"})


def test_study_paper_flight_prints_what_the_page_says() -> None:
    lost = {**made_up_world(), "failed": [{"flight": "ood-0, baseline", "why": "tilted"}]}
    told = {"study": "paper-flight", "seed": 1, "worlds": 1, "quick": False, "folder": "f"}
    outcome = flight_summary(told, {"world-00": {"result": lost}})
    check("study paper-flight", {**outcome["answer"], "report": "f/report.html"})


@pytest.mark.full  # a whole bench
def test_bench_prints_what_the_page_says(monkeypatch: pytest.MonkeyPatch) -> None:
    row = {"name": "JAX", "gradient_ms": 1.0, "build_s": 1.0, "differs": 0.0}
    monkeypatch.setattr(bench.peers, "measure", lambda *of, repeats: [row])
    vehicle = load_vehicle("research")
    counts = {"train": 6, "test": 2, "validation": 2, "ood": 2}
    found = bench.measure(vehicle, 1, epochs=1, iterations=3, repeats=1, counts=counts)
    assert found["gradient_vm_ms"] > 0.0
    assert found["test_rmse"] < 0.6  # less than what the nominal model lacks
    size = planning.Size(
        plans=1,
        nodes=60,
        free_time=1,
        scaling=1,
        scaling_nodes=(60,),
        success=1,
        naive_nodes=20,
        rockit_nodes=20,
    )
    monkeypatch.setattr(planning.rockit_ocp, "installed", lambda: True)
    monkeypatch.setattr(planning.rockit_ocp, "solve", planning.naive.solve)
    spline = {"waypoints": 5, "ms": 1.0, "ours_ms": 0.1, "differs": 0.0}
    monkeypatch.setattr(planning.snap_peer, "measure", lambda *of: spline)
    planned = planning.measure(vehicle, 1, size=size, fit_iterations=50)
    figures = {"residual_mean_m_s2": 1.0, "error_mean_m": 0.1, "clipped_share": 0.0}
    figures |= {"path_length_m": 30.0, "mean_speed_m_s": 3.0}
    course = {"course": "c", "kinds": {kind: figures for kind in bench_flown.KINDS}}
    refused = {"course": "d", "kinds": {**course["kinds"], "min-residual": {"failed": "no way"}}}
    monkeypatch.setattr(bench_flown, "flown", lambda *of, **how: {"courses": [course, refused]})
    compared = bench_flown.measure(vehicle, 1, size=bench_flown.Size(worlds=1, courses=2))
    session = {"realtime_factor": realtime_factor(vehicle)}
    mpc = control.measure(vehicle, 1, size=control.Size(steps=100, courses=1, peer_problems=3))
    monkeypatch.setattr(tracing, "flown", lambda *of: [])
    monkeypatch.setattr(tracing, "traced", lambda logs: (1.0, 1.0))
    trace = tracing.measure(vehicle, 1, size=tracing.Size(many=0))
    answer = table.answer(
        machine=machine.measure(),
        learning=found,
        planning=planned,
        control=mpc,
        flown=compared,
        trace=trace,
        session=session,
    )
    check("bench", answer)
