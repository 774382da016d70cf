"""`trimtab fly --controller`: shipped controllers fly, and what does not go together is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.sessions.test_json_page import check
from trimtab.host import cli
from trimtab.host.control.files import load_controller
from trimtab.host.control.settings import MpcSettings
from trimtab.host.link.controllers import settings_id
from trimtab.host.log import read_flight
from trimtab.protocol.blobs import Reference

Trimtab = Callable[..., dict[str, Any]]


@pytest.fixture(autouse=True)
def _reference(reference: Reference, tmp_path: Path) -> None:
    (tmp_path / "eight.ref").write_bytes(reference.to_bytes())


def test_fly_mpc_tracks_and_its_log_names_it(trimtab: Trimtab) -> None:
    answer = trimtab("fly", "eight.ref", "--controller", "mpc", "-o", "mpc.mcap")
    check("fly", answer)
    assert answer["whole"]
    assert answer["tracking_rmse_m"] < 0.02
    settings = load_controller("mpc")
    assert isinstance(settings, MpcSettings)
    told = answer["control"]
    assert (told["controller"], told["settings_id"], told["model_id"]) == ("mpc", settings_id(settings), None)
    assert told["solved"] == told["steps"] == told["sent"]
    assert told["computing_ms"] == 1e3 * settings.computing_time_s
    assert trimtab("log", "info", "mpc.mcap")["control"] == {k: v for k, v in told.items() if k != "stopped"}


def test_fly_law_with_other_parameters_sets_them_on_board(trimtab: Trimtab, tmp_path: Path) -> None:
    answer = trimtab("fly", "eight.ref", "--controller", "dfbc-do", "-o", "do.mcap")
    assert answer["whole"]
    assert answer["control"] is None
    flight = read_flight(tmp_path / "do.mcap")
    assert flight.firmware_parameters is not None
    settings = load_controller("dfbc-do")
    assert not isinstance(settings, MpcSettings)
    assert flight.firmware_parameters["OBS_GAIN"] == settings.observer_bandwidth_1_s > 0.0
    assert flight.observer is not None


def test_fly_mpc_with_a_model_of_the_drag_tracks_better(
    trimtab: Trimtab, drag_model: str, world_file: Callable[[str], str]
) -> None:
    world = world_file("[effects.linear-drag]\ndx = 0.4\ndy = 0.35\ndz = 0.2\n")
    words = ("fly", "eight.ref", "--world", world)
    nominal = trimtab(*words, "--controller", "mpc", "-o", "a.mcap")
    informed = trimtab(*words, "--controller", "mpc-neural", "--model", drag_model, "-o", "b.mcap")
    assert informed["control"]["model_id"] is not None
    assert informed["tracking_rmse_m"] < 0.5 * nominal["tracking_rmse_m"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--controller", "mpc-neural"), "needs a model; give --model MODEL"),
        (("--controller", "mpc", "--model", "drag.model.toml"), "uses no model; leave out --model"),
        (("--controller", "dfbc-neural"), "needs a feed-forward; give --feedforward FILE"),
        (("--model", "drag.model.toml"), "--model needs --controller"),
        (("--controller", "nobody"), "no such controller"),
    ],
)
@pytest.mark.usefixtures("drag_model")
def test_fly_refuses_what_does_not_go_together(
    words: tuple[str, ...],
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["fly", "eight.ref", *words]) == 2
    assert says in capsys.readouterr().err
    assert not list(tmp_path.glob("*.mcap*"))


def test_settings_id_depends_on_the_settings_and_not_on_what_they_were_tuned_on() -> None:
    settings = load_controller("mpc")
    assert isinstance(settings, MpcSettings)
    assert settings_id(settings.model_copy(update={"tuned": None})) == settings_id(settings)
    assert settings_id(settings.model_copy(update={"iterations_max": 3})) != settings_id(settings)
