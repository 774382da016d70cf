"""The study of labels: what it learns, that it marks the true labels, and that it flies and resumes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.sitl.studies.labels.made_up import made_up_world
from trimtab.host.apps.paper.controllers import models
from trimtab.host.apps.paper.controllers.models import LABEL_SETTINGS
from trimtab.host.apps.paper.controllers.table import REGRESSORS
from trimtab.host.base.errors import UsageError
from trimtab.host.base.pieces import Piece
from trimtab.host.learn import CondensedSettings
from trimtab.host.learn.supervised import learn_supervised
from trimtab.host.log import read_flight
from trimtab.host.log.prepare import prepare
from trimtab.host.models.file import read_model
from trimtab.host.models.network import Layout
from trimtab.host.report.labels import page
from trimtab.sitl.studies.labels import study
from trimtab.sitl.studies.labels.study import label_figures, learn_from_truth
from trimtab.sitl.studies.labels.summary import NEURAL, NOMINAL, SMOOTHED, TRUTH

DATA = Path(__file__).parents[3] / "data"
SMALL = {
    regressor: CondensedSettings(layout=Layout(hidden=(4,), frame=settings.layout.frame), iterations=20)
    for regressor, settings in LABEL_SETTINGS.items()
    if settings.layout is not None
}


def test_no_world_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--worlds 0"):
        study.run(folder=tmp_path, seed=1, vehicle="research", jobs=1, worlds=0)


def test_networks_from_true_labels_are_twins_that_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "LABEL_SETTINGS", SMALL)
    flights = [read_flight(DATA / "a1.mcap")]
    prepared = prepare(flights)
    smoothed = {r: learn_supervised(flights, settings=s, seed=3) for r, s in SMALL.items()}
    twins = learn_from_truth(flights, [each.a for each in prepared], 3)
    assert {r: model.id for r, model in twins.items()} == {r: model.id for r, model in smoothed.items()}
    assert all("true acceleration" in model.provenance["labels"] for model in twins.values())
    true = [each.a + np.array([0.0, 0.0, 0.3]) for each in prepared]
    other = learn_from_truth(flights, true, 3)
    figures = label_figures(prepared, true, {r: (smoothed[r], other[r]) for r in REGRESSORS})
    assert figures["label_rms_m_s2"] == pytest.approx(0.3 / 3**0.5)
    assert figures["samples"] == sum(each.seen.sum() for each in prepared)
    assert set(figures["networks_rms_m_s2"]) == set(REGRESSORS)
    assert min(figures["networks_rms_m_s2"].values()) > 0.0


def test_study_resumes_from_its_pieces_and_makes_a_page(tmp_path: Path) -> None:
    (tmp_path / "pieces").mkdir()
    for world in range(2):
        text = json.dumps({"result": made_up_world(world)})
        (tmp_path / "pieces" / f"world-{world:02d}.json").write_text(text)
    found = study.run(folder=tmp_path, seed=5, vehicle="research", jobs=1, worlds=2)
    assert [row["pairs"] for row in found["answer"]["ratios"]] == [8] * 6
    html = page(found, {}, {"version": "1"})
    assert "<title>Labels of Neural-C: 2 worlds, seed 5 " in html
    with pytest.raises(UsageError, match="another seed"):
        study.run(folder=tmp_path, seed=6, vehicle="research", jobs=1, worlds=2)


@pytest.mark.long
@pytest.mark.full  # learns seven models and flies ten times
def test_study_learns_and_flies_a_world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The piece of a world with small networks and short training, computed in this process."""
    for module in (study, models):
        monkeypatch.setattr(module, "TRAINING_COURSES", 2)
        monkeypatch.setattr(module, "LABEL_SETTINGS", SMALL)
    monkeypatch.setattr(models, "PAPER_SETTINGS", replace(models.PAPER_SETTINGS, hidden=(4,), epochs=3))
    monkeypatch.setattr(models, "BODY_LAYOUT", SMALL["ours"].layout)
    piece = Piece(name="world-00", kind="world", arguments={"world": 0})
    result = study._work(piece, str(tmp_path), seed=9300, vehicle="research", scope=study.QUICK)
    (tmp_path / "pieces").mkdir()
    (tmp_path / "pieces" / "world-00.json").write_text(json.dumps({"result": result}))
    found = study.run(folder=tmp_path, seed=9300, vehicle="research", jobs=1, quick=True)
    controllers = {row["controller"] for row in found["answer"]["rows"]}
    assert controllers == {NOMINAL, NEURAL, SMOOTHED, TRUTH}
    assert found["answer"]["failed"] == []
    world = tmp_path / "worlds" / "world-00"
    marked = {path.name for path in world.glob("*.model.toml") if "true" in path.read_text("utf-8")}
    assert marked == {f"{regressor}-labels-truth.model.toml" for regressor in REGRESSORS}
    assert read_model(world / "ours-labels-truth.model.toml").network is not None
