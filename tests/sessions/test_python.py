"""`import trimtab as tt` does what the verbs do: same artefacts, same answers, and a sealed truth."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import trimtab as tt
from tests.foreign.flight import made_up
from tests.foreign.tables import nanobench_columns, write_csv
from trimtab.host.base.output import json_text
from trimtab.protocol.blobs import Reference

DATA = Path(__file__).parents[1] / "data"
SHIPPED_EFFECT = Path(__file__).parents[2] / "host" / "effects" / "linear_drag.py"
TIMED = {"realtime_factor", "solve_s", "seconds"}
"""Numbers that depend on the machine."""

Run = Callable[..., tuple[int, dict[str, Any], str]]


def same(answer: dict[str, Any], printed: dict[str, Any]) -> bool:
    """Whether a `to_dict` is what a verb printed, except for times."""
    plain = json.loads(json_text(answer))
    assert plain.keys() | TIMED == printed.keys() | TIMED
    return all(plain[key] == printed[key] for key in plain.keys() - TIMED)


@pytest.fixture
def ref(tmp_path: Path, reference: Reference, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "eight.ref").write_bytes(reference.to_bytes())
    return Path("eight.ref")


def test_fly_writes_the_log_and_the_truth_of_the_verb(run_trimtab: Run, ref: Path) -> None:
    words = ("--world", "drawn-several", "--world-seed", "918273645", "--seed", "4", "--flight", "2")
    code, printed, _ = run_trimtab("fly", str(ref), *words, "-o", "verb.mcap", "--json")
    assert code == 0
    result = tt.fly(ref, world="drawn-several", world_seed=918273645, seed=4, flight=2, log="own.mcap")
    for end in ("", ".truth.json"):
        assert Path(f"own.mcap{end}").read_bytes() == Path(f"verb.mcap{end}").read_bytes()
    assert same(result.to_dict(), {**printed, "log": "own.mcap"})
    assert result.simulated
    assert tt.read_flight(result.log).metadata["command"] == "trimtab fly eight.ref --seed 4 --flight 2"


def test_fly_returns_and_logs_nothing_of_the_truth(ref: Path) -> None:
    result = tt.fly(ref, world="drawn-several", world_seed=918273645)
    truth = json.loads(Path("eight-0.mcap.truth.json").read_text())
    flight = tt.read_flight(result.log)
    told = repr((result, result.to_dict(), result._repr_html_(), flight.metadata, flight._repr_html_()))
    drawn = [value for values in truth["effects"].values() for value in values.values()]
    assert drawn
    for secret in ("918273645", "drawn-several", *truth["effects"], *(f"{value:.6g}" for value in drawn)):
        assert secret not in told


def test_fly_names_its_log_as_the_verb_does(ref: Path) -> None:
    assert [tt.fly(ref).log.name for _ in range(2)] == ["eight-0.mcap", "eight-1.mcap"]


def test_fly_over_a_log_is_refused_and_writes_nothing(ref: Path) -> None:
    Path("x.mcap").write_bytes(b"mine")
    with pytest.raises(tt.UsageError, match=r"x\.mcap: exists"):
        tt.fly(ref, log="x.mcap")
    assert Path("x.mcap").read_bytes() == b"mine"
    assert not Path("x.mcap.truth.json").exists()


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"port": "/dev/null"}, "give --port and --mocap together"),
        ({"seed": -1}, "negative"),
        ({"parameters": {"OBSERVE": 1.0}}, "there is no parameter OBSERVE"),
        ({"at_s": 1.0}, "--at needs --then"),
        ({"model": "x.model.toml"}, "--model needs --controller"),
    ],
)
def test_fly_refuses_options_that_do_not_go_together(
    ref: Path, options: dict[str, Any], complaint: str
) -> None:
    with pytest.raises(tt.UsageError, match=complaint):
        tt.fly(ref, **options)
    assert list(Path().glob("*.mcap*")) == []


def test_fly_that_ends_in_failsafe_raises_with_its_result(
    ref: Path, world_file: Callable[[str], str]
) -> None:
    with pytest.raises(tt.FlightEnded) as caught:
        tt.fly(ref, world=world_file("[mocap]\ngaps_s = [[5.0, 60.0]]\n"))
    assert caught.value.result.to_dict()["failsafe"] == "mocap-lost"
    assert "mocap-lost" in caught.value.result._repr_html_()
    assert Path("eight-0.mcap.truth.json").is_file()


def test_plan_gives_the_reference_and_the_answer_of_the_verb(
    run_trimtab: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, printed, _ = run_trimtab("plan", "pretzel", "--stretch", "-o", "verb.ref", "--json")
    assert code == 0
    made = tt.plan("pretzel", stretch=True)
    path = tt.write_plan(made, "own.ref")
    assert path.read_bytes() == Path("verb.ref").read_bytes()
    assert same(made.to_dict(path="verb.ref"), printed)
    records = [json.loads(Path(f"{name}.ref.json").read_text()) for name in ("own", "verb")]
    assert records[0]["provenance"]["parents"] == records[1]["provenance"]["parents"]
    assert records[0]["provenance"]["command"] is None
    assert records[0]["plan"] == records[1]["plan"]
    assert "thrust_low" in made._repr_html_()
    assert repr(made) == f"<Plan pretzel, min-snap, {made.duration_s:.2f} s, id {made.reference.id}>"


def test_read_flight_has_the_answer_of_log_info(run_trimtab: Run) -> None:
    _, printed, _ = run_trimtab("log", "info", str(DATA / "a1.mcap"), "--json")
    flight = tt.read_flight(DATA / "a1.mcap")
    assert same(flight.to_dict(), printed)
    assert "/mocap/pose" in flight._repr_html_()
    assert repr(flight) == f"<Flight a1.mcap, id {flight.id}, {flight.duration_s:.2f} s>"


def test_names_are_found_in_the_workspace_which_is_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("effects", "vehicles", "routes"):
        (tmp_path / folder).mkdir()
    effect = SHIPPED_EFFECT.read_text(encoding="utf-8").replace('"linear-drag"', '"my-drag"')
    (tmp_path / "effects" / "my_drag.py").write_text(effect, encoding="utf-8")
    mine = tt.load_vehicle("nano").replace(name="mine", tolerances={"my-drag.dx": 0.1})
    (tmp_path / "vehicles" / "mine.toml").write_text(mine.to_toml())
    (tmp_path / "routes" / "hop.toml").write_text(
        'name = "hop"\ntotal_time_s = 4.0\nwaypoints_m = [[0, 0, -1], [1, 0, -1]]\n'
    )
    with pytest.raises(tt.TrimtabError, match="hop: no such route"):
        tt.load_route("hop")
    assert "my-drag" not in tt.load_effects()
    assert "my-drag" in tt.load_effects(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert "my-drag" in tt.load_effects()
    assert tt.load_vehicle("mine") == mine
    assert tt.load_route("hop").waypoints_m[-1] == (1.0, 0.0, -1.0)
    assert tt.plan("hop", "mine").reference.vehicle_id == mine.id


def test_import_log_writes_the_log_of_the_verb(
    run_trimtab: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_csv(tmp_path / "bench.csv", nanobench_columns(made_up()))
    words = ("import", "nanobench", "bench.csv", "--vehicle", "nano")
    code, printed, _ = run_trimtab(*words, "-o", "verb.mcap", "--json")
    assert code == 0
    imported = tt.import_log("bench.csv", "own.mcap", vehicle="nano", format="nanobench")
    assert same(imported.to_dict(), {**printed, "log": "own.mcap"})
    assert imported.flight.id == tt.read_flight("own.mcap").id
    assert imported.flight.metadata["source_id"] == tt.read_flight("verb.mcap").metadata["source_id"]
    assert "command" not in imported.flight.metadata
    with pytest.raises(tt.UsageError, match="which vehicle flew"):
        tt.import_log("bench.csv", "x.mcap", format="nanobench")
    assert not Path("x.mcap").exists()


def test_learn_gives_the_answer_of_the_verb(run_trimtab: Run) -> None:
    log = str(DATA / "a1.mcap")
    words = ("--hold-out", str(DATA / "b1.mcap"), "--epochs", "1", "--hidden", "1", "--effects", "none")
    _, printed, _ = run_trimtab("learn", log, *words, "--as-asked", "-o", "verb.model.toml", "--json")
    learned = tt.learn(
        [tt.read_flight(log)],
        [tt.read_flight(DATA / "b1.mcap")],
        epochs=1,
        hidden=[1],
        forms=[],
        as_asked=True,
    )
    assert same(learned.to_dict(path="verb.model.toml"), printed)
    assert tt.read_model("verb.model.toml").id == learned.model.id == learned.model.to_dict()["id"]
    assert "held out" in learned._repr_html_()


@pytest.mark.full  # two traces
def test_trace_gives_the_answer_and_the_files_of_the_verb(
    run_trimtab: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("a1", "b1", "c1"):
        shutil.copy(DATA / f"{name}.mcap", tmp_path)
    words = ("a1.mcap", "b1.mcap", "--hold-out", "c1.mcap")
    code, printed, _ = run_trimtab("trace", *words, "-o", "verb", "--json")
    assert code == 0
    flights, held_out = [tt.read_flight("a1.mcap"), tt.read_flight("b1.mcap")], [tt.read_flight("c1.mcap")]
    result = tt.trace(flights, held_out)
    answer = tt.write_trace(result, "own", flights, held_out)
    assert same(json.loads(json.dumps(answer).replace('"own/', '"verb/')), printed)
    assert result.to_dict() | {"model": answer["model"], "report": answer["report"]} == answer
    assert tt.read_model("own/trace.model.toml").id == tt.read_model("verb/trace.model.toml").id
    assert str(result.verdict) in result._repr_html_()


def test_predict_gives_the_answer_of_the_verb(run_trimtab: Run, tmp_path: Path, drag_model: str) -> None:
    shutil.copy(DATA / "a1.mcap", tmp_path)
    code, printed, _ = run_trimtab("predict", drag_model, "a1.mcap", "--json")
    assert code == 0
    result = tt.predict(drag_model, [tt.read_flight("a1.mcap")])
    assert same({"model_file": drag_model, **json.loads(json.dumps(result.to_dict()))}, printed)
    assert "a1.mcap" in result._repr_html_()
    assert tt.predict(None, [tt.read_flight("a1.mcap")]).model_id is None


def test_predict_without_flights_is_refused() -> None:
    with pytest.raises(tt.UsageError, match="no flight to predict"):
        tt.predict(None, [])


def test_trace_without_flights_is_refused() -> None:
    with pytest.raises(tt.UsageError, match="no flight given"):
        tt.trace([])
