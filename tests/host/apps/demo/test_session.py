"""A short demo in a drawn and sealed world, checked afterwards: verdict, files, comparison, and the seal.

Only `opened_truth` opens a truth file, and only once the demo has answered. The demo itself opens one for its
last page, when its verdict is a file; an audit hook notes when.
"""

from __future__ import annotations

import base64
import json
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from tests.browser import ask, draws, fits, printed
from trimtab.host.apps.demo.files import JSON_NAME, MODEL_NAME, REPORT_NAME, TRUTH_PAGE, DemoFiles
from trimtab.host.apps.demo.flights import WORLD, Airfield
from trimtab.host.apps.demo.routes import DemoRoutes
from trimtab.host.apps.demo.seeds import host_seed, world_seed
from trimtab.host.apps.demo.session import DemoRequest, Outcome, run_demo
from trimtab.host.base.artefacts import content_id
from trimtab.host.base.workers import workers
from trimtab.host.effects import load_effects
from trimtab.host.link.simulated import TRUTH_SUFFIX
from trimtab.host.log import read_flight
from trimtab.host.models.file import read_model
from trimtab.host.trace.answer import to_json
from trimtab.host.vehicle import load_vehicle
from trimtab.protocol.blobs import FeedForward, Reference

pytestmark = pytest.mark.xdist_group("demo")

SEED = 13_806_490
NEUTRAL = {"gain": 1.0}
OPENED: list[tuple[str, bool]] = []
"""Each truth file that was read, and whether the verdict of its folder was a file by then."""
BY_DEMO: list[tuple[str, bool]] = []
"""Those that the demo read."""


def _note_truth(event: str, words: tuple[object, ...]) -> None:
    if event == "open" and str(words[0]).endswith(TRUTH_SUFFIX) and str(words[1]).startswith("r"):
        path = Path(str(words[0]))
        OPENED.append((path.name, path.with_name(JSON_NAME).is_file()))


sys.addaudithook(_note_truth)


@pytest.fixture(scope="module")
def demo(
    tmp_path_factory: pytest.TempPathFactory, short_routes: DemoRoutes
) -> tuple[Path, Outcome, list[str]]:
    folder = tmp_path_factory.mktemp("demo")
    order = DemoRequest(vehicle=load_vehicle("research"), folder=folder, seed=SEED, routes=short_routes)
    said: list[str] = []
    OPENED.clear()
    with workers(2) as pool:
        outcome = run_demo(order, load_effects(), pool, on_message=said.append)
    BY_DEMO.extend(OPENED)
    return folder, outcome, said


Demo = tuple[Path, Outcome, list[str]]


def opened_truth(demo: Demo) -> dict[str, Any]:
    """What the world held; asks for the answer so that nobody opens it before."""
    folder, outcome, _ = demo
    assert outcome.answer["verdict"]
    return json.loads(next(iter(sorted(folder.glob(f"*{TRUTH_SUFFIX}")))).read_text())


def drawn_values(truth: dict[str, Any]) -> list[float]:
    """Every number that the world drew."""
    effects = [value for values in truth["effects"].values() for value in values.values()]
    return [value for value in (*effects, *truth["deviations"].values()) if value]


def digits(value: float) -> set[str]:
    """The value as somebody would write it with six or more digits: rounded, and cut."""
    texts = {f"{value:.5e}".partition("e")[0], f"{value:.6g}"}
    texts |= {repr(value)[:length] for length in range(9, 12)}
    return {text.lstrip("-") for text in texts if len(text.strip("-0.").replace(".", "")) >= 6}


def decompressed(log: Path) -> Iterator[tuple[str, bytes]]:
    """Every record of a log, with its name."""
    with log.open("rb") as stream:
        reader = make_reader(stream)
        for record in reader.iter_metadata():
            yield f"metadata {record.name}", json.dumps(record.metadata).encode()
        for attachment in reader.iter_attachments():
            yield attachment.name, attachment.data
        for schema, channel, message in reader.iter_messages():
            yield channel.topic, message.data
            assert schema is not None
        summary = reader.get_summary()
        assert summary is not None
        for schema in summary.schemas.values():
            yield f"schema {schema.name}", schema.data
        for channel in summary.channels.values():
            yield f"channel {channel.topic}", json.dumps(channel.metadata).encode()


def test_demo_names_what_the_sealed_world_holds(demo: Demo) -> None:
    answer = demo[1].answer
    truth = opened_truth(demo)
    assert len(truth["effects"]) >= 2
    assert answer["verdict"] == "traced"
    assert {effect["name"] for effect in answer["effects"]} == set(truth["effects"])
    for effect in answer["effects"]:
        for key, true in truth["effects"][effect["name"]].items():
            size = abs(true - NEUTRAL.get(key, 0.0))
            assert effect["parameters"][key]["value"] == pytest.approx(true, abs=0.15 * size)


def test_demo_predicts_the_held_out_flight_better_afterwards(demo: Demo) -> None:
    answer = demo[1].answer
    assert answer["held_out_flights"] == 1
    assert answer["after"]["position_rmse_m"] < 0.4 * answer["before"]["position_rmse_m"]


def test_demo_flies_better_with_the_effects_applied(demo: Demo) -> None:
    answer = demo[1].answer
    assert answer["tracking_rmse_applied_m"] < 0.5 * answer["tracking_rmse_first_m"]
    assert answer["tracking_rmse_new_plan_m"] < 1.05 * answer["tracking_rmse_first_m"]


def test_demo_predicts_its_own_second_flights_before_it_flies_them(demo: Demo) -> None:
    flights = demo[1].answer["comparison"]["flights"]
    assert [flight["predicted_rmse_m"] is None for flight in flights] == [True, True, False, False]
    for flight in flights[2:]:
        assert flight["tracking_rmse_m"] == pytest.approx(flight["predicted_rmse_m"], rel=0.3, abs=0.003)


def test_demo_compares_plans_of_one_route_time_and_limits_that_differ_in_cost(demo: Demo) -> None:
    folder, outcome, _ = demo
    comparison = outcome.comparison
    assert comparison.first[0].planned.name == "fast"  # the fastest of the first routes, whatever came of it
    assert comparison.new_plan is not None
    assert comparison.applied is not None
    first, again = comparison.first[0].planned, comparison.new_plan.planned
    assert comparison.applied.planned is again
    assert first.route == again.route
    assert again.plan.duration_s == pytest.approx(first.plan.duration_s, abs=2e-3)
    assert all(margin >= 0.0 for margin in again.plan.margins.values())
    assert (first.plan.kind, again.plan.kind) == ("min-control", "min-residual")
    flights = [read_flight(folder / tracked.log) for tracked in comparison.flown]
    assert flights[0].firmware_parameters == flights[2].firmware_parameters == flights[3].firmware_parameters
    assert [flight.feedforward is None for flight in flights] == [True, True, True, False]
    assert flights[2].reference_id == flights[3].reference_id != flights[0].reference_id


def test_demo_in_several_processes_writes_the_logs_of_one(demo: Demo, tmp_path: Path) -> None:
    folder, outcome, _ = demo
    (log,) = folder.glob("03-*.mcap")
    first = read_flight(log)
    files = DemoFiles(folder=folder, vehicle=load_vehicle("research"), seed=host_seed(SEED), force=True)
    field = Airfield(vehicle=files.vehicle, world=WORLD, world_seed=world_seed(SEED), session=files.session())
    field.fly(outcome.comparison.first[0].planned.plan.reference, 3, tmp_path / log.name)
    assert first.reference_id == outcome.comparison.first[0].planned.plan.reference.id
    assert (tmp_path / log.name).read_bytes() == log.read_bytes()


def test_demo_leaves_every_artefact_whole(demo: Demo) -> None:
    folder, outcome, said = demo
    names = {path.name for path in folder.iterdir()}
    flown = ["turning"] * 2 + ["fast"] * 2 + ["unseen"] + ["fast-again"] * 2
    logs = [f"{k:02d}-{name}.mcap" for k, name in enumerate(flown, start=1)]
    wanted = {REPORT_NAME, MODEL_NAME, JSON_NAME, TRUTH_PAGE, "applied.ff"} | set(logs)
    wanted |= {log + TRUTH_SUFFIX for log in logs}
    wanted |= {f"{name}.ref{end}" for name in {*flown} for end in ("", ".json")}
    assert names == wanted
    assert [read_flight(folder / log).metadata["flight"] for log in logs] == [
        "1",
        "2",
        "3",
        "4",
        "5",
        "6",
        "7",
    ]
    model = read_model(folder / MODEL_NAME)
    block = FeedForward.from_bytes((folder / "applied.ff").read_bytes())
    assert block.model_id == model.id == outcome.result.model.id
    assert list(model.data) == [read_flight(folder / log).id for log in logs[:4]]
    record = json.loads((folder / "fast-again.ref.json").read_text())
    assert record["provenance"]["parents"]["model"] == model.id
    assert record["reference"] == Reference.from_bytes((folder / "fast-again.ref").read_bytes()).id
    begin, *lines = said
    assert str(folder) in begin
    assert len(lines) == len(outcome.steps) == 8
    assert all(line.startswith(f"{k}. ") for k, line in enumerate(lines, start=1))


def test_demo_answers_with_the_keys_of_trace_and_its_own(demo: Demo) -> None:
    folder, outcome, _ = demo
    keys = set(to_json(outcome.result))
    own = {"tracking_rmse_first_m", "tracking_rmse_new_plan_m", "tracking_rmse_applied_m", "comparison"}
    assert set(outcome.answer) == keys | own | {"truth"}
    written = json.loads((folder / JSON_NAME).read_text())
    told = {key: value for key, value in outcome.answer.items() if key != "truth"}
    assert written == {**told, "model": MODEL_NAME, "report": REPORT_NAME}


def test_demo_report_is_one_file_with_both_comparisons_and_its_numbers(demo: Demo) -> None:
    html = (demo[0] / REPORT_NAME).read_text()
    for text in ("Flown before and after", "Deteriorations", "new plan, effects applied", "planned path, m"):
        assert text in html
    assert "http://" not in html.replace("http://www.w3.org", "")
    data = html.partition('<script type="application/json" id="data">')[2].partition("</script>")[0]
    assert json.loads(data)["comparison"] == demo[1].answer["comparison"]
    assert len(html.encode()) < 3_000_000


def test_demo_report_shows_every_flight_by_route_and_index(demo: Demo) -> None:
    html = (demo[0] / REPORT_NAME).read_text()
    data = html.partition('<script type="application/json" id="show-data">')[2].partition("</script>")[0]
    shown = json.loads(data)
    names = {track["name"]: (track["group"], track["shown"]) for track in shown["tracks"]}
    assert names == {
        "first flight 1 (fast 3)": ("route fast", True),
        "first flight 2 (fast 4)": ("route fast", False),
        "new plan (fast 6)": ("route fast", True),
        "new plan, effects applied (fast 7)": ("route fast", True),
        "turning 1": ("learned from", False),
        "turning 2": ("learned from", False),
        "unseen 5": ("held out", False),
    }
    (unseen,) = [track for track in shown["tracks"] if track["name"] == "unseen 5"]
    rows = np.frombuffer(base64.b64decode(unseen["channels"]["prediction"]["data"]), dtype="<f4")
    before, after = (
        np.sqrt(np.nanmean(rows.reshape(-1, unseen["channels"]["prediction"]["width"])[:, k] ** 2))
        for k in (0, 1)
    )
    answer = demo[1].answer
    assert before == pytest.approx(1e3 * answer["before"]["position_rmse_m"], rel=0.05)
    assert after == pytest.approx(1e3 * answer["after"]["position_rmse_m"], rel=0.15)  # of peaks
    flown = {reference for point in shown["scene"]["waypoints"] for reference in point["references"]}
    assert flown == {track["reference_id"] for track in shown["tracks"]}
    assert all(track["simulated"] for track in shown["tracks"])


def test_demo_opens_one_truth_and_only_after_its_verdict_is_a_file(demo: Demo) -> None:
    assert demo[1].answer["verdict"]
    opened = list(BY_DEMO)
    assert opened == [(f"01-turning.mcap{TRUTH_SUFFIX}", True)]


def test_truth_page_has_the_sealed_values_beside_the_found_ones(demo: Demo) -> None:
    folder, outcome, _ = demo
    html, truth = (folder / TRUTH_PAGE).read_text(), opened_truth(demo)
    assert "The verdict is right" in html
    for effect in outcome.answer["effects"]:
        for key, true in truth["effects"][effect["name"]].items():
            found = effect["parameters"][key]
            for value in (f"{true:.4g}", f"{found['value']:.4g}", f"{found['sd']:.2g}"):
                assert f">{value}<" in html, (effect["name"], key)
            assert f">{round((found['value'] - true) / found['sd'], 1) + 0.0:.1f}<" in html
    assert content_id((folder / JSON_NAME).read_bytes()) in html


@pytest.mark.full  # a browser
@pytest.mark.parametrize(("width", "dark"), [(390, True), (1280, False)])
def test_pages_of_a_demo_are_drawn_and_fit(
    demo: Demo, require: Callable[[str], None], tmp_path: Path, width: int, dark: bool
) -> None:
    require("browser")
    for name in (REPORT_NAME, TRUTH_PAGE):
        copy = Path(shutil.copy(demo[0] / name, tmp_path))
        said = ask(copy, tmp_path, width=width, dark=dark)
        fits(said, width, dark=dark)
        if name == REPORT_NAME:
            draws(said, dark=dark)
            assert said["choices"] == 7
            assert said["plots"][0] | {"colours": 0, "colours_in_print": 0} == {
                "title": "Tracking error",
                "series": 3,
                "colours": 0,
                "colours_in_print": 0,
            }


@pytest.mark.full  # a browser
def test_pages_of_a_demo_print(demo: Demo, require: Callable[[str], None], tmp_path: Path) -> None:
    require("browser")
    for name in (REPORT_NAME, TRUTH_PAGE):
        pdf = printed(demo[0] / name, tmp_path)
        assert pdf.startswith(b"%PDF")
        assert len(pdf) > 10_000


def test_logs_of_a_demo_tell_nothing_of_the_world(demo: Demo) -> None:
    folder, _, _ = demo
    truth = opened_truth(demo)
    forbidden = [truth["world"], str(truth["world_seed"]), hex(truth["world_seed"])[2:], str(SEED)]
    forbidden += [name.replace("-", mark) for name in truth["effects"] for mark in "-_"]
    forbidden += [text for value in drawn_values(truth) for text in digits(value)]
    needles = [text.encode() for text in forbidden]
    needles += [struct.pack("<d", value) for value in drawn_values(truth)]
    for log in sorted(folder.glob("*.mcap")):
        raw = log.read_bytes()
        assert not any(needle in raw for needle in needles[:4])
        for name, data in decompressed(log):
            if name != "vehicle.toml":
                found = [needle for needle in needles if needle in data]
                assert not found, (log.name, name, found)


def test_model_and_report_tell_neither_world_nor_seed_nor_drawn_values(demo: Demo) -> None:
    folder, _, _ = demo
    truth = opened_truth(demo)
    assert world_seed(SEED) == truth["world_seed"]
    forbidden = [truth["world"], str(truth["world_seed"]), str(SEED), str(folder)]
    forbidden += [repr(value) for value in drawn_values(truth)]
    others = [path for path in folder.iterdir() if not path.name.endswith((TRUTH_SUFFIX, ".mcap"))]
    others.remove(folder / TRUTH_PAGE)  # the one exception
    for path in others:
        text = path.read_bytes()
        assert not [word for word in forbidden if word.encode() in text], path.name
    assert str(host_seed(SEED)) in (folder / MODEL_NAME).read_text()


def test_logs_alone_give_the_same_verdict_where_there_is_no_simulator(demo: Demo, tmp_path: Path) -> None:
    folder, outcome, _ = demo
    logs = [path.name for path in sorted(folder.glob("*.mcap"))]
    for name in logs[:5]:
        shutil.copy(folder / name, tmp_path)
    code = (
        "import sys; sys.modules['trimtab.sitl'] = None; from trimtab.host.cli import main; sys.exit(main())"
    )
    command = [sys.executable, "-c", code, "trace", *logs[:4], "--hold-out", logs[4], "--json"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=280)
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout.splitlines()[-1])
    for key in ("verdict", "effects", "drive", "before", "after", "noise_floor", "held_out_flights"):
        assert answer[key] == outcome.answer[key], key
