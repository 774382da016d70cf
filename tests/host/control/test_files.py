"""Controller files: all shipped ones load, and a bad key is one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from trimtab.host.control.files import list_controllers, load_controller, parse_controller
from trimtab.host.control.settings import DfbcSettings, MpcSettings
from trimtab.host.route import load_route
from trimtab.host.vehicle import ConfigurationError, load_vehicle, to_parameters
from trimtab.host.workspace import open_workspace

SHIPPED = ["dfbc", "dfbc-do", "dfbc-neural", "dfbc-neural-do", "mpc", "mpc-l1", "mpc-neural", "mpc-neural-c"]
VEHICLE = load_vehicle("research")
MPC = list_controllers()["mpc"].read_text()
DFBC = 'kind = "dfbc"\nobserver_bandwidth_1_s = 0.0\nfeedforward = false\n'


def test_shipped_files_are_the_controllers_of_the_paper() -> None:
    assert list(list_controllers()) == SHIPPED


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_file_is_of_its_kind_and_tuned_on_routes_that_exist(name: str) -> None:
    settings = load_controller(name)
    assert settings.kind == name.partition("-")[0]
    if settings.tuned is not None:
        vehicle = load_vehicle(settings.tuned.vehicle)
        for course in settings.tuned.courses:
            load_route(course, None, vehicle)


@pytest.mark.parametrize("name", SHIPPED[5:])
def test_variants_of_the_mpc_differ_in_what_they_add_only(name: str) -> None:
    base, variant = load_controller("mpc"), load_controller(name)
    assert isinstance(base, MpcSettings)
    assert isinstance(variant, MpcSettings)
    same = {"residual": base.residual, "adaptation": base.adaptation}
    assert variant.model_copy(update=same) == base


def test_horizon_and_step_are_those_of_the_paper() -> None:
    settings = load_controller("mpc")
    assert isinstance(settings, MpcSettings)
    assert (settings.horizon_s, settings.step_s, settings.stages) == (0.5, 0.025, 20)
    assert (settings.step_us, settings.computing_time_us) == (25_000, 10_000)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (MPC + "extra = 1\n", "x.toml: tuned.extra: unknown key; remove it"),
        (MPC.replace('"mpc"', '"pid"'), "x.toml: kind: 'pid' is not possible; choose 'dfbc' or 'mpc'"),
        (MPC.replace('kind = "mpc"', ""), "x.toml: kind: missing; choose 'dfbc' or 'mpc'"),
        (MPC.replace("tilt = ", "tilt = -"), None),
        (MPC.replace("step_s = 0.025", "step_s = 0.0253"), None),
        (MPC.replace("horizon_s = 0.5", "horizon_s = 0.51"), None),
        (MPC.replace("iterations_max = 20", "iterations_max = 2.5"), None),
        (DFBC + "horizon_s = 0.5\n", "x.toml: horizon_s: unknown key; remove it"),
        (
            DFBC.replace("false", '"no"'),
            "x.toml: feedforward: 'no' is not true or false; write true or false",
        ),
        (DFBC + "[gain_factors]\nposition_p = [1.0, 2.0]\n", None),
        ("kind = ", None),
    ],
)
def test_bad_file_is_refused_with_one_line(text: str, line: str | None) -> None:
    with pytest.raises(ConfigurationError) as raised:
        parse_controller(text, "x.toml")
    assert len(raised.value.problems) == 1
    assert raised.value.problems[0].startswith("x.toml: ")
    assert line in (None, raised.value.problems[0])


def test_dfbc_settings_become_firmware_parameters() -> None:
    text = DFBC.replace("s = 0.0", "s = 2.5") + "[gain_factors]\nposition_p = 1.5\n"
    settings = parse_controller(text, "x.toml")
    assert isinstance(settings, DfbcSettings)
    changed, before = settings.parameters(VEHICLE), to_parameters(VEHICLE)
    expected = {"OBS_GAIN": 2.5} | {f"POS_P_{axis}": 1.5 * before[f"POS_P_{axis}"] for axis in "NED"}
    assert changed == {**before, **expected}


def test_dfbc_settings_that_the_firmware_refuses_raise() -> None:
    settings = parse_controller(DFBC.replace("s = 0.0", "s = 100.0"), "x.toml")
    assert isinstance(settings, DfbcSettings)
    with pytest.raises(ConfigurationError):
        settings.parameters(VEHICLE)


def test_workspace_file_hides_the_shipped_one(tmp_path: Path) -> None:
    (tmp_path / "controllers").mkdir()
    (tmp_path / "controllers" / "mpc.toml").write_text(DFBC)
    assert open_workspace(tmp_path).controller("mpc").kind == "dfbc"
    assert open_workspace(tmp_path).controller("mpc-l1").kind == "mpc"


def test_unknown_controller_is_refused_with_the_known_names() -> None:
    with pytest.raises(ConfigurationError, match="mpc-neural-c"):
        load_controller("pid")
