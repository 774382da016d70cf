"""Vehicle files: shipped ones, canonical text, and what bad ones say."""

from __future__ import annotations

import pickle
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.host.vehicle import (
    ConfigurationError,
    Vehicle,
    list_vehicles,
    load_vehicle,
    parse_vehicle,
    to_parameters,
)
from trimtab.host.vehicle.model import check_name
from trimtab.protocol.parameters import BY_NAME, DEFAULTS

SHIPPED = ("nano", "research")


def problems(text: str) -> list[str]:
    """The lines that reading `text` as bad.toml raises."""
    with pytest.raises(ConfigurationError) as caught:
        parse_vehicle(text, "bad.toml")
    assert caught.value.exit_code == 2
    return list(caught.value.problems)


@pytest.fixture(scope="module")
def research() -> Vehicle:
    return load_vehicle("research")


@pytest.mark.parametrize(
    "name", ["", "-x", "a b", "x" * 41, 'a"b', "a/b", "a\n", "\u0301a", "a\u200b", "a.b"]
)
def test_name_that_no_file_can_have_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="a name has letters") as caught:
        check_name(name)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["mine-2", "é", "e\u0301té_1", "机架", "квадро", "क्वाड", "٥x"])
def test_name_may_have_letters_of_all_alphabets(name: str, research: Vehicle) -> None:
    assert check_name(name) == name
    assert parse_vehicle(research.replace(name=name).to_toml(), "x.toml").name == name


def test_shipped_vehicles_are_listed() -> None:
    assert tuple(list_vehicles()) == SHIPPED


@pytest.mark.parametrize("name", SHIPPED)
def test_canonical_text_reads_back_equal(name: str) -> None:
    vehicle = load_vehicle(name)
    again = parse_vehicle(vehicle.to_toml(), "again")
    assert again == vehicle
    assert again.id == vehicle.id
    assert again.to_toml() == vehicle.to_toml()
    assert hash(again) == hash(vehicle)
    assert pickle.loads(pickle.dumps(vehicle)) == vehicle


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_vehicle_hovers_well_inside_its_headroom(name: str) -> None:
    vehicle = load_vehicle(name)
    share = vehicle.mass_kg * 9.81 / (4.0 * vehicle.thrust_max_n)
    low, high = vehicle.limits.thrust_headroom
    assert 2.0 * low < share < 0.7 * high


def test_research_vehicle_has_the_papers_mass_and_inertia(research: Vehicle) -> None:
    assert research.mass_kg == 0.752
    assert research.inertia_kg_m2 == (0.0025, 0.0021, 0.0043)
    assert [rotor.spin for rotor in research.rotors] == ["ccw", "ccw", "cw", "cw"]
    assert research.tolerance("mass", "factor", 1.0) == 0.003


def test_id_changes_with_content_and_not_with_comments(research: Vehicle) -> None:
    assert len(research.id) == 12
    assert research.id_bytes == bytes.fromhex(research.id)
    commented = "# weighed again\n" + research.to_toml()
    assert parse_vehicle(commented, "c").id == research.id
    assert research.replace(mass_kg=0.753).id != research.id


def test_id_of_a_copy_is_that_of_its_own_content(research: Vehicle) -> None:
    assert research.id != research.model_copy(update={"mass_kg": 0.8}).id
    assert research.model_copy().id == research.id


def test_optional_observer_reaches_the_board_and_leaves_ids_without_it_alone(research: Vehicle) -> None:
    assert research.gains.observer is None
    assert "observer" not in research.to_toml()
    assert to_parameters(research)["OBS_GAIN"] == 0.0
    observed = research.replace(gains=research.gains.model_copy(update={"observer": 5.0}))
    assert observed.id != research.id
    assert to_parameters(observed)["OBS_GAIN"] == 5.0
    assert parse_vehicle(observed.to_toml(), "again") == observed


def test_vehicle_refuses_changes_in_place(research: Vehicle) -> None:
    with pytest.raises(ValueError, match="frozen"):
        research.mass_kg = 1.0
    with pytest.raises(TypeError):
        research.tolerances["wind.wx"] = 1.0  # pyright: ignore[reportIndexIssue]  # read-only


def test_replace_checks_like_a_file(research: Vehicle) -> None:
    with pytest.raises(ConfigurationError, match=r"research: mass_kg: -1\.0 is out of range"):
        research.replace(mass_kg=-1.0)


def test_tolerance_prefers_parameter_over_effect_over_default(research: Vehicle) -> None:
    vehicle = research.replace(tolerances={"wind": 0.2, "wind.wx": 0.3})
    assert vehicle.tolerance("wind", "wx", 1.0) == 0.3
    assert vehicle.tolerance("wind", "wy", 1.0) == 0.2
    assert vehicle.tolerance("mass", "factor", 1.0) == 1.0


def test_bad_file_tells_every_problem_at_once(research: Vehicle) -> None:
    text = (
        research.to_toml()
        .replace("mass_kg = 0.752", "mas_kg = 0.752")
        .replace('spin = "cw"', 'spin = "left"', 1)
        .replace("thrust_curve = [0.0, 1.0]", "thrust_curve = [0.1, 1.0]")
        .replace("full_v = 16.8", 'full_v = "16.8"')
        .replace("speed_max_m_s = 10.0", "speed_max_m_s = -3")
        .replace("geofence_m = [[-10.0, 10.0]", "geofence_m = [[10.0, -10.0]")
        .replace('"wind.wx" = 0.1', '"Wind wx" = 0.1')
        .replace("rate_filter_hz = 40.0", "")
    )
    lines = problems(text)
    starts = [line.split(":")[1].strip() for line in lines]
    assert sorted(starts) == sorted(
        [
            "mass_kg",
            "mas_kg",
            "rotors[2].spin",
            "thrust_curve",
            "battery.full_v",
            "limits.speed_max_m_s",
            "limits.geofence_m[0]",
            "gains.rate_filter_hz",
            "tolerances.Wind wx",
        ]
    )
    assert all(line.startswith("bad.toml: ") and "\n" not in line for line in lines)
    assert "bad.toml: mas_kg: unknown key; did you mean mass_kg?" in lines
    assert "bad.toml: rotors[2].spin: 'left' is not possible; choose 'cw' or 'ccw'" in lines


@pytest.mark.parametrize(
    ("down", "remedy"), [("[0.0, 6.0]", "write [-6, 0]"), ("[0.5, 6.0]", "write [-6, -0.5]")]
)
def test_geofence_below_the_floor_is_a_problem_of_the_vehicle(
    research: Vehicle, down: str, remedy: str
) -> None:
    (line,) = problems(research.to_toml().replace("[-6.0, 0.3]", down))
    assert line.startswith("bad.toml: limits.geofence_m: down from")
    assert "lies below the floor; up is negative" in line
    assert remedy in line


def test_wrong_keys_hide_neither_the_boards_bounds_nor_what_lies_between_keys(research: Vehicle) -> None:
    text = (
        research.to_toml()
        .replace("inertia_kg_m2 = [0.0025", "inertia_kg_m2 = [-0.0025")
        .replace("mass_kg = 0.752", "mass_kg = 4.0")
        .replace("thrust_curve = [0.0, 1.0]", "thrust_curve = [0.5, 1.0]")
        .replace("velocity_d = [6.0", "velocity_d = [600.0")
        .replace("rate_filter_hz = 40.0", "rate_filter_hz = 4000")
        .replace("capacity_ah = 1.5", "capacity_ah = 0")
        .replace("empty_v = 13.2", "empty_v = 17")
    )
    lines = problems(text)
    starts = [line.removeprefix("bad.toml: ").split(":")[0] for line in lines]
    assert sorted(starts) == sorted(
        [
            "inertia_kg_m2[0]",
            "thrust_curve",
            "battery.capacity_ah",
            "battery.empty_v",
            "gains.velocity_d[0]",
            "gains.rate_filter_hz",
            "cannot hover",
        ]
    )
    assert any("VEL_D_N: 600 is outside" in line for line in lines)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("inertia_kg_m2 = [0.0025, 0.0021, 0.0043]", "inertia_kg_m2 = [0.001, 0.001, 0.0043]", "rigid body"),
        ("0.0021, 0.0043]", "0.0021]", "inertia_kg_m2[2]: missing"),
        ("mass_kg = 0.752", "mass_kg = nan", "mass_kg: nan is not a finite number"),
        ("mass_kg = 0.752", "mass_kg = true", "mass_kg: True is not a number"),
        ("mass_kg = 0.752", "mass_kg = 5.0", "cannot hover"),
        ("mass_kg = 0.752", "mass_kg = 0.001", "mass_kg: the firmware does not accept it"),
        ("empty_v = 13.2", "empty_v = 17.0", "battery.empty_v: 17 is not below full_v 16.8"),
        ("cells = 4", "cells = 4.5", "battery.cells: 4.5 is not a whole number"),
        ('spin = "cw"', 'spin = "ccw"', "rotors: these rotors cannot turn"),
        ("thrust_headroom = [0.08, 0.65]", "thrust_headroom = [0.08, 1.65]", "limits.thrust_headroom"),
        ('name = "research"', 'name = "../up"', "name: '../up': a name has letters"),
        ("[battery]", "[battery", "not valid TOML"),
    ],
)  # fmt: skip
def test_bad_value_is_named_with_its_key(research: Vehicle, old: str, new: str, said: str) -> None:
    text = research.to_toml()
    assert old in text
    lines = problems(text.replace(old, new))
    assert len(lines) == 1
    assert said in lines[0]


def test_missing_vehicle_names_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"nimbus: no such vehicle \(known: nano, research"):
        load_vehicle("nimbus")
    with pytest.raises(ConfigurationError, match="no such vehicle file"):
        load_vehicle(tmp_path / "gone.toml")


def test_binary_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "v.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigurationError, match="not UTF-8"):
        load_vehicle(path)


def test_workspace_vehicle_hides_shipped_one(tmp_path: Path, research: Vehicle) -> None:
    folder = tmp_path / "vehicles"
    folder.mkdir()
    (folder / "research.toml").write_text(research.replace(mass_kg=0.8).to_toml())
    assert load_vehicle("research", tmp_path).mass_kg == 0.8
    assert load_vehicle("nano", tmp_path).name == "nano"
    assert load_vehicle("research").mass_kg == 0.752


def test_parameters_cover_the_table_and_follow_the_vehicle(research: Vehicle) -> None:
    parameters = to_parameters(research)
    assert list(parameters) == list(DEFAULTS)
    heavier = to_parameters(research.replace(mass_kg=0.9))
    assert {name for name in parameters if parameters[name] != heavier[name]} == {"MASS"}
    for name, value in to_parameters(load_vehicle("nano")).items():
        assert BY_NAME[name].check(value) == value


def test_every_gain_and_limit_reaches_the_board(research: Vehicle) -> None:
    # Scaling any number of [gains] or [limits] must change some parameter: the mapping forgets none.
    base = to_parameters(research)
    for table in ("gains", "limits"):
        fields = tomllib.loads(research.to_toml())[table]
        for key, value in fields.items():
            if isinstance(value, float):
                changed = value * 0.9
            elif isinstance(value[0], list):
                changed = [[low * 0.9, high * 0.9] for low, high in value]
            else:
                changed = [item * 0.9 for item in value]
            vehicle = research.replace(**{table: {**fields, key: changed}})
            assert to_parameters(vehicle) != base, f"{table}.{key}"


@given(
    mass=st.floats(0.1, 1.5, allow_nan=False),
    inertia=st.floats(1e-3, 1e-2),
    arm=st.floats(0.02, 0.5),
    sigma=st.floats(1e-6, 1.0),
)
def test_any_valid_vehicle_survives_its_text(mass: float, inertia: float, arm: float, sigma: float) -> None:
    base = load_vehicle("research")
    rotors = [
        {"position_m": [x * arm, y * arm, 0.0], "spin": spin}
        for x, y, spin in ((1, 1, "ccw"), (-1, -1, "ccw"), (1, -1, "cw"), (-1, 1, "cw"))
    ]
    vehicle = base.replace(
        mass_kg=mass, inertia_kg_m2=[inertia] * 3, rotors=rotors, tolerances={"wind.wx": sigma}
    )
    assert parse_vehicle(vehicle.to_toml(), "again") == vehicle


@pytest.mark.parametrize("text", ["mass_kg = " + "[" * 5_000, "mass_kg = " + "9" * 5_000])
def test_toml_beyond_what_its_reader_bears_is_one_line(text: str) -> None:
    (line,) = problems(text)
    assert line.startswith("bad.toml: not valid TOML: ")
    assert "\n" not in line
