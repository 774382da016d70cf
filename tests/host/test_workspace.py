"""A workspace's own files come before the shipped ones; the page's example works."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import pytest

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.base.errors import UsageError
from trimtab.host.cli import main
from trimtab.host.effects import Context, load_effects
from trimtab.host.models.file import write_model
from trimtab.host.models.model import Model
from trimtab.host.vehicle import ConfigurationError, list_vehicles, load_vehicle
from trimtab.host.workspace import open_workspace

DOCS = Path(__file__).parents[2] / "docs"
CONTEXT = Context(
    p_ned=(0.0, 0.0, -2.0),
    v_ned=(0.0, 0.0, 0.0),
    v_air_frd=(0.0, 0.0, 0.0),
    R=(1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0),
    rate_frd=(0.0, 0.0, 0.0),
    thrust=(1.8, 1.8, 1.8, 1.8),
    collective_n=7.2,
    mass_kg=0.75,
    voltage_ratio=1.0,
    t_s=0.0,
    rotor_positions=((0.1, 0.1, 0.0),) * 4,
    spin_signs=(1.0, 1.0, -1.0, -1.0),
    inertia_kg_m2=(0.0025, 0.0021, 0.0043),
    hover_n=1.8,
)
"""Upside down 2 m over the floor: body down is world up."""


def test_workspace_finds_own_and_shipped_files(tmp_path: Path) -> None:
    (tmp_path / "vehicles").mkdir()
    (tmp_path / "effects").mkdir()
    (tmp_path / "vehicles" / "mine.toml").write_text(load_vehicle("nano").replace(name="mine").to_toml())
    (tmp_path / "effects" / "slow_leak.py").write_text("")
    (tmp_path / "effects" / "_shared.py").write_text("")
    workspace = open_workspace(tmp_path)
    assert workspace.vehicle("mine").name == "mine"
    assert workspace.vehicle("research").name == "research"
    assert workspace.route("random:2").name == "random-2"
    assert workspace.effect_files() == {"slow-leak": tmp_path / "effects" / "slow_leak.py"}


def test_vehicle_with_a_misspelt_tolerance_is_refused_with_the_nearest_name(tmp_path: Path) -> None:
    nano = load_vehicle("nano")
    (tmp_path / "vehicles").mkdir()
    file = tmp_path / "vehicles" / "mine.toml"
    tolerances = {"mas.factor": 0.01, "winds": 0.1, "zz.q": 0.1, "motor-lag": 0.001}
    file.write_text(nano.replace(tolerances=tolerances).to_toml())
    with pytest.raises(ConfigurationError) as caught:
        open_workspace(tmp_path).vehicle("mine")
    assert caught.value.problems == (
        f"{file}: tolerances.mas.factor: no effect has this parameter; did you mean mass.factor?",
        f"{file}: tolerances.winds: no effect has this parameter; did you mean wind?",
        f"{file}: tolerances.zz.q: no effect has this parameter; remove it or give its --workspace",
    )


def test_shipped_vehicles_have_tolerances_of_effects_only() -> None:
    effects = load_effects()
    known = {f"{name}.{key}" for name, effect in effects.items() for key in effect.keys} | set(effects)
    for name in list_vehicles():
        assert set(load_vehicle(name).tolerances) <= known


def test_vehicle_may_state_the_tolerance_of_an_effect_of_its_workspace(workspace: Path) -> None:
    file = workspace / "vehicles" / "mine.toml"
    mine = load_vehicle(file)
    (effect,) = set(load_effects(workspace)) - set(load_effects())
    tolerances = {**mine.tolerances, effect: 0.1}
    file.write_text(mine.replace(tolerances=tolerances).to_toml())
    assert open_workspace(workspace).vehicle("mine").tolerances[effect] == 0.1
    with pytest.raises(ConfigurationError, match=f"tolerances.{effect}: no effect"):
        open_workspace(workspace / "routes").vehicle(file)


def test_workspace_is_the_current_folder_unless_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert open_workspace().root == tmp_path


def test_missing_workspace_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such folder"):
        open_workspace(tmp_path / "gone")


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of docs/guide/workspace.md: its effect, the route page's route, a vehicle."""
    page = (DOCS / "guide" / "workspace.md").read_text(encoding="utf-8")
    (effect,) = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    (route,) = re.findall(
        r"```toml\n(.*?)```", (DOCS / "reference" / "route-file.md").read_text(), flags=re.DOTALL
    )
    mine = load_vehicle("research").replace(name="mine", mass_kg=0.76).to_toml()
    files = {"effects/elastic_tether.py": effect, "routes/window.toml": route, "vehicles/mine.toml": mine}
    for name, text in files.items():
        assert name in page
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_workspace_pages_effect_loads_and_acts_as_its_equation_says(workspace: Path) -> None:
    effect = load_effects(workspace)["elastic-tether"]
    assert effect.specific_force_frd is not None
    # 2 m from an anchor below it, of which 0.5 m are slack.
    assert effect.specific_force_frd(FLOAT, (0.1, 0.5, 0.0, 0.0), CONTEXT) == pytest.approx(
        (0.0, 0.0, -0.15), abs=1e-3
    )
    assert effect.specific_force_frd(FLOAT, (0.1, 3.0, 0.0, 0.0), CONTEXT) == pytest.approx(
        (0.0, 0.0, 0.0), abs=1e-3
    )
    assert effect.specific_force_frd(FLOAT, effect.neutral, CONTEXT) == pytest.approx((0.0, 0.0, 0.0))


def test_workspace_pages_effect_takes_the_form_of_the_page(workspace: Path) -> None:
    page = (DOCS / "guide" / "workspace.md").read_text(encoding="utf-8")
    (hardening,) = re.findall(r'^`(form\("hardening".*\))`$', page, flags=re.MULTILINE)
    assert "multiply the force by `1.0 + hardening * taut`" in page
    file = workspace / "effects" / "elastic_tether.py"
    source = file.read_text(encoding="utf-8")
    for old, new in (
        ("Effect, number", "Effect, form, number"),
        ("north, east = theta", "north, east, hardening = theta"),
        ("[-stiffness * taut", "[-stiffness * (1.0 + hardening * taut) * taut"),
        ("    ),\n    closing", f"        {hardening},\n    ),\n    closing"),
    ):
        assert source.count(old) == 1
        source = source.replace(old, new)
    file.write_text(source, encoding="utf-8")
    effect = load_effects(workspace)["elastic-tether"]
    assert [parameter.key for parameter in effect.parameters if parameter.form] == ["hardening"]
    assert effect.specific_force_frd is not None
    plain, hard = (
        effect.specific_force_frd(FLOAT, (0.1, 0.5, 0.0, 0.0, value), CONTEXT) for value in (0.0, 0.2)
    )
    # Stretched by 1.5 m, the line pulls with 1.3 of its force.
    assert hard == pytest.approx([1.3 * value for value in plain], rel=1e-3)
    assert effect.specific_force_frd(FLOAT, (0.0, 0.5, 0.0, 0.0, 0.3), CONTEXT) == pytest.approx((0.0,) * 3)


def test_workspace_pages_files_are_planned_with(workspace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    vehicle = load_vehicle("mine", workspace)
    effect = load_effects(workspace)["elastic-tether"]
    model = Model(
        vehicle_id=vehicle.id,
        vehicle_name="mine",
        effects={effect.name: {"stiffness": 0.5, "slack_m": 0.5, "north_m": 0.0, "east_m": 0.0}},
        sources={effect.name: effect.source_id},
    )
    write_model(model, workspace / "m.model.toml")
    told = []
    for more in (["-o", "snap.ref", "--kind", "min-snap", "--clearance", "0"], []):
        assert main(["plan", "window", "--vehicle", "mine", "--model", "m.model.toml", "--json", *more]) == 0
        told.append(json.loads(capsys.readouterr().out.splitlines()[-1]))
    snap, residual = told
    assert (residual["kind"], residual["reference"]) == ("min-residual", "window.ref")
    # The waypoints are 1.2 to 3.6 m from the anchor; between them the plan stays nearer, as the page says.
    assert 0.5 * (1.2 - 0.5) < snap["residual_rms_m_s2"] < 0.5 * (3.7 - 0.5)
    assert residual["residual_rms_m_s2"] < 0.8 * snap["residual_rms_m_s2"]


@pytest.fixture
def strange(tmp_path: Path) -> Path:
    """A workspace with an effect whose code prints, of another user."""
    if os.geteuid() != 0:
        pytest.skip("gives files to another user, which needs root")
    source = (Path(load_effects.__code__.co_filename).parent / "torque_bias.py").read_text(encoding="utf-8")
    path = tmp_path / "lab" / "effects" / "own_bias.py"
    path.parent.mkdir(parents=True)
    path.write_text(source.replace('name="torque-bias"', 'name="own-bias"') + "print('it ran')\n")
    for each in (path, *path.parents[:2]):
        os.chown(each, 65534, -1)
    return tmp_path / "lab"


@pytest.mark.parametrize("words", [["trace", "none.mcap"], ["learn", "none.mcap"], ["doctor"]])
def test_workspace_of_another_user_is_refused_without_trust(
    words: list[str], strange: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = main([*words, "--workspace", str(strange)])
    printed = capsys.readouterr()
    assert "it ran" not in printed.out
    line = next(text for text in (printed.out + printed.err).splitlines() if "own_bias" in text)
    assert "belongs to nobody" in line
    assert "--trust" in line
    if words == ["doctor"]:
        assert code == 1
    else:
        assert (code, printed.err.count("\n")) == (2, 1)


def test_workspace_of_another_user_runs_with_trust(strange: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--workspace", str(strange), "--trust"]) == 0
    printed = capsys.readouterr()
    assert "it ran" in printed.out
    assert printed.err == f"trimtab: runs the code in {strange / 'effects' / 'own_bias.py'}\n"
    assert "own-bias" in open_workspace(strange, trusted=True).effects()
