"""`trimtab study controller-tuning`: search over stored points, tables, Markdown, page and resumption."""

from __future__ import annotations

import json

import pytest

from trimtab.host.apps.paper.tuning import study
from trimtab.host.apps.paper.tuning.table import FULL
from trimtab.host.base.errors import FlightFailed, UsageError
from trimtab.host.report import controller_tuning
from trimtab.host.vehicle import load_vehicle


@pytest.fixture
def flown(monkeypatch):
    """Points that nobody flies: the best are velocity 1.15, observer 2, attitude 2, l1 3."""
    tried = []

    def fly(pieces, work, *, folder, config, jobs, on_progress):
        results = {}
        for piece in pieces:
            tried.append(piece.name)
            factors = piece.arguments["factors"]
            best = {"velocity": 1.15, "observer": 2.0, "attitude": 2.0, "l1": 3.0}
            error = 0.05 * (1.0 + sum(abs(f - best.get(name, 1.0)) for name, f in factors.items()))
            error *= 1.02 if piece.arguments["repetition"] else 1.0
            results[piece.name] = {"result": {**piece.arguments, "errors_m": [error, error], "failed": []}}
        return results

    monkeypatch.setattr(study, "run_pieces", fly)
    return tried


def tuned(folder, **options):
    folder.mkdir(exist_ok=True)
    return study.run(folder=folder, seed=1, vehicle="research", jobs=1, **options)


def test_study_finds_the_best_point_and_scores_shared_parameters_on_both_controllers(tmp_path, flown):
    outcome = tuned(tmp_path)
    searches = outcome["answer"]["searches"]
    factors = {
        name: {key: row["factor"] for key, row in each["parameters"].items()}
        for name, each in searches.items()
    }
    assert factors == {
        "dfbc": {"position": 1.0, "velocity": 1.15, "observer": 2.0},
        "mpc": {"position": 1.0, "velocity": 1.0, "attitude": 2.0, "rate-command": 1.0, "l1": 3.0},
    }
    assert searches["dfbc"]["parameters"]["observer"]["value"] == [6.0]
    assert searches["mpc"]["parameters"]["attitude"]["files"] == ["mpc", "mpc-l1"]
    assert len(flown) == len(set(flown)) == len(outcome["scores"])
    assert "dfbc_position-0.85_velocity-1_0" in flown
    assert "dfbc-do_position-0.85_velocity-1_observer-1_0" in flown


def test_study_writes_every_point_as_markdown_and_a_page(tmp_path, flown):
    outcome = tuned(tmp_path)
    text = (tmp_path / study.MARKDOWN_NAME).read_text()
    assert text.count("\n| dfbc-do | position") == sum(name.startswith("dfbc-do") for name in flown)
    page = controller_tuning.page(outcome, controller_tuning.pictures(outcome), {"seed": 1})
    assert "observer_bandwidth_1_s" in page
    assert [point["controller"] for point in outcome["answer"]["points"]][:2] == ["dfbc", "dfbc"]


def test_start_that_does_not_fly_ends_the_study(tmp_path, monkeypatch):
    def fail(pieces, *_, **__):
        return {piece.name: {"result": {**piece.arguments, "errors_m": [None]}} for piece in pieces}

    monkeypatch.setattr(study, "run_pieces", fail)
    with pytest.raises(FlightFailed):
        tuned(tmp_path)


def test_quick_study_resumes_from_its_pieces_and_refuses_another_seed(tmp_path):
    (tmp_path / "pieces").mkdir()
    for factor, repetition, error in ((1.0, 0, 0.04), (1.0, 1, 0.041), (1.5, 0, 0.03)):
        arguments = {"controller": "dfbc-do", "factors": {"observer": factor}, "repetition": repetition}
        result = {**arguments, "errors_m": [error], "failed": []}
        path = tmp_path / "pieces" / f"dfbc-do_observer-{factor:g}_{repetition}.json"
        path.write_text(json.dumps({"result": result}))
    outcome = tuned(tmp_path, quick=True)
    assert outcome["answer"]["searches"]["dfbc"]["parameters"]["observer"]["factor"] == 1.5
    assert outcome["answer"]["vehicle"] == load_vehicle("research").name
    with pytest.raises(UsageError):
        study.run(folder=tmp_path, seed=2, vehicle="research", jobs=1, quick=True)


def test_names_of_points_differ_in_every_factor():
    for search in FULL:
        start = {each.name: 1.0 for each in search.parameters}
        for controller in search.files:
            pieces = [
                study.piece_of(search, controller, {**start, each.name: factor})
                for each in search.of(controller)
                for factor in each.factors
                if factor != 1.0
            ]
            assert len({piece.name for piece in pieces}) == len(pieces)
