"""A study from end to end, killed on its way and gone on with; what was scored is never traced again."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from trimtab.host.base.errors import UsageError
from trimtab.host.base.pieces import alone_in
from trimtab.host.vehicle import load_vehicle
from trimtab.host.vehicle.strict_toml import read_strict
from trimtab.sitl.draw import draw_world
from trimtab.sitl.studies import blind, flights
from trimtab.sitl.studies.files import Ledger, SealBroken, StudyError, read_json, sha256_of
from trimtab.sitl.studies.flights import (
    FLIGHTS,
    SCORE,
    STILL,
    TRUTH,
    VERDICT,
    Programme,
    fly_and_seal,
    plan_references,
)
from trimtab.sitl.studies.worlds import PlannedWorld, redrawn_seed
from trimtab.sitl.world import WorldFile

pytestmark = pytest.mark.timeout(1200)  # five worlds are flown and traced one after the other

ROOT = Path(__file__).parents[3]
KEYS = set(
    [
        "top1",
        "pairs_exact",
        "in_alias",
        "alias_size_mean",
        "false_alarm",
        "abstain_outside",
        "abstain_inside",
        "thin_wrong",
        "thin_told",
        "parameter_error_median",
        "parameter_error_p90",
        "coverage_2sigma",
        "width_over_bound",
        "after_over_floor_median",
        "after_over_floor_p90",
        "trace_s_median",
        "n",
    ]
)

RUN = """
import json, sys
from pathlib import Path
from trimtab.host.base.errors import UsageError
from trimtab.host.base.pieces import alone_in
from trimtab.host.vehicle import load_vehicle
from trimtab.host.vehicle.strict_toml import read_strict
from trimtab.sitl.draw import draw_world
from trimtab.sitl.studies import blind
from trimtab.sitl.studies.flights import Programme

def main():
    programme = Programme(routes=Path(sys.argv[2]), learning=("one",), held_out=("two",))
    outcome = blind.run(
        folder=Path(sys.argv[1]), seed=3, worlds=6, few_flights=0.25, vehicle="research", jobs=2,
        programme=programme,
        on_progress=lambda done, total, detail: print(f"{done:g} of {total:g} {detail}", flush=True),
    )
    print(json.dumps(outcome["answer"]))

if __name__ == "__main__":
    main()
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study")
    (folder / "run.py").write_text(RUN)
    return folder


def start(study: Path, programme: Programme) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, str(study / "run.py"), str(study / "state"), str(programme.routes)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])},
        stdout=subprocess.PIPE,
        text=True,
    )


def stages(study: Path) -> Iterator[tuple[Path, str]]:
    for name in (TRUTH, VERDICT, SCORE):
        for path in sorted((study / "state").glob(f"worlds/*/{name}")):
            yield path, sha256_of(path)


@pytest.fixture(scope="module")
def killed(study: Path, short_programme: Programme) -> dict[Path, str]:
    """What a study that was killed after its first score had done by then."""
    process = start(study, short_programme)
    assert process.stdout is not None
    try:
        for line in process.stdout:
            if line.split()[0] == "3" or ": " in line:
                break
    finally:
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        process.stdout.read()  # until the workers, which end with it, have let go of the pipe
        process.stdout.close()
    return dict(stages(study))


@pytest.fixture(scope="module")
def answer(study: Path, short_programme: Programme, killed: dict[Path, str]) -> dict[str, Any]:
    process = start(study, short_programme)
    out, _ = process.communicate()
    assert process.returncode == 0
    return json.loads(out.splitlines()[-1])


@pytest.mark.full
def test_killed_study_goes_on_and_leaves_what_was_done(
    study: Path, killed: dict[Path, str], answer: dict[str, Any]
) -> None:
    scored = [path for path in killed if path.name == SCORE]
    assert 1 <= len(scored) < 6
    after = dict(stages(study))
    assert {path: after[path] for path in killed} == killed
    assert len(after) == 18
    assert answer["n"]["worlds"] == 6
    assert set(answer) >= KEYS
    assert not list((study / "state").glob("worlds/*/trace"))


@pytest.mark.full
def test_truths_are_sealed_in_the_ledger(study: Path, answer: dict[str, Any]) -> None:
    ledger = read_json(study / "state" / "ledger.json")
    truths = {path.parent.name: digest for path, digest in stages(study) if path.name == TRUTH}
    assert ledger == truths
    for name in truths:
        folder = study / "state" / "worlds" / name
        logs = {path.name for path in (folder / "flights").iterdir()}
        truth = read_json(folder / TRUTH)
        assert logs == {f["log"] for f in truth["flights"]}
        if truth["class"] != "thin":
            assert logs == {"one-1.mcap", "one-2.mcap", "two.mcap"}


@pytest.mark.full
def test_finished_study_says_the_same_without_work_and_refuses_a_changed_truth(
    study: Path, answer: dict[str, Any], short_programme: Programme
) -> None:
    def again(**other: Any) -> dict[str, Any]:
        usual = {
            "seed": 3,
            "worlds": 6,
            "few_flights": 0.25,
            "vehicle": "research",
            "jobs": 1,
            "programme": short_programme,
        }
        return blind.run(folder=study / "state", **{**usual, **other})["answer"]

    assert again() == answer
    part = again(first=2)
    assert (part["worlds"], part["first"], part["n"]["worlds"]) == (6, 2, 2)
    with pytest.raises(UsageError, match="another seed"):
        again(seed=4)
    truth = study / "state" / "worlds" / "0001" / TRUTH
    kept = truth.read_bytes()
    truth.write_bytes(kept + b" ")
    try:
        with pytest.raises(SealBroken, match="world 0001"):
            again()
    finally:
        truth.write_bytes(kept)


def test_world_is_flown_and_sealed_once(tmp_path: Path, short_programme: Programme) -> None:
    references = plan_references(tmp_path, "research", short_programme)
    world = PlannedWorld(name="0000", kind_class="single", kinds=("motor-lag",), seed=77, turbulence=1.0)
    folder = tmp_path / "0000"
    folder.mkdir()
    digest = fly_and_seal(world, folder, references, "research", short_programme)
    truth = read_json(folder / TRUTH)
    assert digest == sha256_of(folder / TRUTH)
    assert set(truth["effects"]) == {"motor-lag"}
    assert {f["log"]: f["sha256"] for f in truth["flights"]} == {
        path.name: sha256_of(path) for path in (folder / "flights").iterdir()
    }
    assert not list(folder.glob("*.toml"))
    # The same seeds make the same logs and truth, and what is sealed is not flown again.
    again = tmp_path / "again"
    again.mkdir()
    assert fly_and_seal(world, again, references, "research", short_programme) == digest
    shutil.rmtree(folder / "flights")
    assert fly_and_seal(world, folder, references, "research", short_programme) == digest
    assert not (folder / "flights").exists()
    Ledger(tmp_path / "ledger.json").record("0000", digest)


@pytest.mark.parametrize("first", [-1, 0, 7])
def test_first_worlds_are_some_of_those_drawn(tmp_path: Path, first: int) -> None:
    with pytest.raises(StudyError, match=f"--first {first}: the study has 6 worlds; give 1 to 6"):
        blind.run(folder=tmp_path, seed=1, worlds=6, first=first, vehicle="research", jobs=1)
    assert not list(tmp_path.iterdir())


def test_folder_in_use_is_refused(tmp_path: Path, short_programme: Programme) -> None:
    with (
        alone_in(tmp_path),
        pytest.raises(UsageError, match="another study is running"),
        alone_in(tmp_path),
    ):
        pass


def test_world_that_the_vehicle_cannot_fly_is_drawn_again(
    tmp_path: Path, short_programme: Programme, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Late and slow motors make it tip over. The next draw is flown, and the truth says which it was."""
    references = plan_references(tmp_path, "research", short_programme)
    kinds = ("actuation-delay", "motor-lag")
    usual = PlannedWorld(name="0000", kind_class="pair", kinds=kinds, seed=0, turbulence=1.0, wide=True)
    text = usual.toml().replace("size = [0.2, 4.0]", "size = [1.0, 8.0]")
    monkeypatch.setattr(PlannedWorld, "toml", lambda self, *, still=False: text)
    vehicle, file = load_vehicle("research"), read_strict(text, "w", WorldFile)

    def lateness(seed: int) -> tuple[float, float]:
        drawn = draw_world("w", file, seed, vehicle)
        return drawn.effects["actuation-delay"]["delay_s"], drawn.effects["motor-lag"]["extra_s"]

    seed = next(
        seed
        for seed in range(5000)
        if min(a / b for a, b in zip(lateness(seed), (0.028, 0.075), strict=True)) > 1.0
        and max(a / b for a, b in zip(lateness(redrawn_seed(seed, 1)), (0.010, 0.026), strict=True)) < 1.0
    )
    folder = tmp_path / "0000"
    folder.mkdir()
    programme = replace(short_programme, repeats=1)
    fly_and_seal(replace(usual, seed=seed), folder, references, "research", programme)
    truth = read_json(folder / TRUTH)
    assert (truth["redrawn"], truth["seed"]) == (1, redrawn_seed(seed, 1))
    assert truth["effects"]["motor-lag"]["extra_s"] == lateness(truth["seed"])[1]
    assert {path.name for path in (folder / FLIGHTS).iterdir()} == {"one-1.mcap", "two.mcap"}


def test_world_that_fails_in_still_air_is_drawn_again(
    tmp_path: Path, short_programme: Programme, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The effective values come from these flights. Nothing is flown here: the logs are empty."""
    world = PlannedWorld(name="0000", kind_class="single", kinds=("mass",), seed=7, turbulence=1.0, wide=True)
    flown: list[tuple[int, str]] = []

    def pretend(drawn: PlannedWorld, file: str, _: Path, __: int, ___: str, log: Path) -> bool:
        flown.append((drawn.seed, log.parent.name))
        (log.parent.parent / flights._WORLD).write_text(file)
        log.write_bytes(b"")
        truth = {"world_seed": drawn.seed, "effects": {}, "deviations": {}, "turbulence": {}}
        flights._truth_path(log).write_text(json.dumps(truth))
        return drawn.seed != world.seed or log.parent.name != STILL

    monkeypatch.setattr(flights, "_fly", pretend)
    fly_and_seal(world, tmp_path, tmp_path, "research", short_programme)
    assert read_json(tmp_path / TRUTH)["redrawn"] == 1
    assert [seed for seed, place in flown if place == STILL].count(world.seed) == 1
    assert flown[-1] == (redrawn_seed(world.seed, 1), STILL)
