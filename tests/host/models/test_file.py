"""A model survives its file, and a file that is not what it says is refused by name."""

from __future__ import annotations

import dataclasses
from typing import get_args

import numpy as np
import pytest

from tests.parts import part
from trimtab.host.base.errors import UsageError
from trimtab.host.effects import load_effects
from trimtab.host.models.file import ModelFileError, read_model, write_model
from trimtab.host.models.model import Assessment, Covariance, Model, VerdictCode
from trimtab.host.models.network import Layout, Network
from trimtab.host.models.region import Region
from trimtab.host.trace.decision.findings import Verdict
from trimtab.host.vehicle.strict_toml import ConfigurationError

LAYOUT = Layout(hidden=(4, 4))
ASSESSMENT = Assessment(
    verdict="traced", probabilities={"linear-drag": 0.998}, held_out_flights=2, before_m=0.08, after_m=0.01
)


def model(**changes) -> Model:
    values = {
        "vehicle_id": "0123456789ab",
        "vehicle_name": "research",
        "effects": {"linear-drag": {"dx": 0.41, "dy": 0.33, "dz": 0.1}},
        "adjustments": {"mass": {"factor": 1.002}},
        "covariance": Covariance(
            names=("linear-drag.dx", "mass.factor"), matrix=((1e-4, 1e-6), (1e-6, 4e-6))
        ),
        "sources": {"linear-drag": "abcdefabcdef", "mass": "123456123456"},
        "network": Network(layout=LAYOUT, xi=LAYOUT.initial(np.random.default_rng(0))),
        "region": Region(speed_max_m_s=4.0, tilt_max_deg=35.0, thrust_min_n=4.0, thrust_max_n=12.0),
        "data": ("aaaaaaaaaaaa", "bbbbbbbbbbbb"),
        "assessment": ASSESSMENT,
        "provenance": {"command": "trimtab learn a.mcap", "seed": 3, "git": None, "parents": {"log": "ab"}},
    }
    return Model(**{**values, **changes})


def test_model_file_round_trip_is_equal(tmp_path):
    path = write_model(model(), tmp_path / "m.model.toml")
    again = read_model(path, vehicle_id="0123456789ab")
    assert again.id == model().id
    assert again.content() == model().content()
    assert again.provenance == {"command": "trimtab learn a.mcap", "seed": 3, "parents": {"log": "ab"}}
    assert again.assessment == ASSESSMENT
    assert again.network is not None
    np.testing.assert_array_equal(again.network.xi, LAYOUT.initial(np.random.default_rng(0)))
    assert again.sd("linear-drag", "dx") == pytest.approx(0.01)
    assert again.sd("linear-drag", "dy") is None
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["m.model.npz", "m.model.toml"]


def test_model_file_without_an_assessment_keeps_its_id(tmp_path):
    """Files that were written before models had one."""
    plain = model(assessment=None)
    assert "assessment" not in plain.content()
    assert read_model(write_model(plain, tmp_path / "m.model.toml")).assessment is None
    assert plain.id != model().id


def test_verdicts_of_model_files_are_those_of_a_trace_and_learned():
    assert set(get_args(VerdictCode)) == {verdict.value for verdict in Verdict} | {"learned"}


def test_assessment_leaves_out_errors_of_diverging_predictions():
    made = model().assessed("undecided", probabilities={"wind": 0.4}, flights=2, before_m=0.1, after_m=np.inf)
    assert made.assessment == Assessment(
        verdict="undecided", probabilities={"wind": 0.4}, held_out_flights=2, before_m=0.1
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"verdict": "sure"}, "verdict 'sure' is not one of"),
        ({"probabilities": {"wind": 1.2}}, "probability of wind is 1.2"),
        ({"held_out_flights": 0}, "need held-out flights"),
        ({"after_m": float("nan")}, "must be finite"),
    ],
)
def test_assessment_bad_values_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(ASSESSMENT, **changes)


def test_model_file_same_model_same_bytes(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    one = write_model(model(), tmp_path / "a" / "m.model.toml")
    two = write_model(model(), tmp_path / "b" / "m.model.toml")
    assert one.read_bytes() == two.read_bytes()
    assert one.with_suffix(".npz").read_bytes() == two.with_suffix(".npz").read_bytes()


def test_model_id_provenance_does_not_count_but_values_do():
    assert model(provenance={}).id == model().id
    assert model(adjustments={"mass": {"factor": 1.003}}).id != model().id
    assert model(network=None).id != model().id


def test_model_parts_use_selects_and_fills_with_neutral():
    effects = load_effects()
    sparse = dataclasses.replace(model(), effects={"linear-drag": {"dx": 0.41}}, covariance=None)
    names = {use: [effect.name for effect, _ in sparse.parts(effects, use)] for use in ("both", "none")}
    assert names == {"both": ["linear-drag", "mass"], "none": []}
    assert sparse.parts(effects, "effects")[0][1] == part("linear-drag", 0.41)[1]
    assert sparse.parts(effects, "adjustments")[0][1] == (1.002,)


def test_model_parts_unknown_effect_or_key_is_named():
    effects = load_effects()
    with pytest.raises(ValueError, match="names ghost, which is no known effect"):
        model(effects={"ghost": {"k": 1.0}}, covariance=None).parts(effects)
    with pytest.raises(ValueError, match="linear-drag has no parameter d4"):
        model(effects={"linear-drag": {"d4": 1.0}}, covariance=None).parts(effects)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"adjustments": {"linear-drag": {"dx": 0.0}}}, "either named or an adjustment"),
        ({"effects": {"linear-drag": {"dx": float("nan")}}}, "must be finite"),
        ({"covariance": Covariance(names=("wind.wx",), matrix=((1.0,),))}, r"names no parameter.*wind\.wx"),
    ],
)
def test_model_inconsistent_content_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        model(**changes)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (((1.0, 0.5), (0.2, 1.0)), "not symmetric"),
        (((-1.0, 0.0), (0.0, 1.0)), "variance of a"),
        (((1.0, 0.0),), "needs 2 x 2"),
    ],
)
def test_covariance_bad_matrix_is_refused(matrix, message):
    with pytest.raises(ValueError, match=message):
        Covariance(names=("a", "b"), matrix=matrix)


def test_model_file_existing_is_kept_without_force(tmp_path):
    path = write_model(model(), tmp_path / "m.model.toml")
    with pytest.raises(UsageError, match="exists; choose another name or add --force") as error:
        write_model(model(data=()), path)
    assert error.value.exit_code == 2
    write_model(model(data=()), path, force=True)
    assert read_model(path).data == ()


def test_model_file_of_another_vehicle_is_refused(tmp_path):
    path = write_model(model(), tmp_path / "m.model.toml")
    with pytest.raises(ModelFileError, match=r"is of vehicle research \(0123456789ab\)"):
        read_model(path, vehicle_id="ffffffffffff")


def test_model_file_edited_value_is_noticed(tmp_path):
    path = write_model(model(), tmp_path / "m.model.toml")
    path.write_text(path.read_text().replace("dx = 0.41", "dx = 0.5"))
    with pytest.raises(ModelFileError, match="it was edited; remove the id line"):
        read_model(path)
    path.write_text("\n".join(line for line in path.read_text().splitlines() if not line.startswith("id =")))
    assert read_model(path).effects["linear-drag"]["dx"] == 0.5


def test_model_file_other_weights_are_noticed(tmp_path):
    path = write_model(model(), tmp_path / "m.model.toml")
    np.savez(tmp_path / "m.model.npz", xi=np.zeros(LAYOUT.size))
    with pytest.raises(ModelFileError, match=r"not the weights m\.model\.toml was written with"):
        read_model(path)
    for xi in (np.zeros(7), np.full(LAYOUT.size, np.nan)):
        np.savez(tmp_path / "m.model.npz", xi=xi)
        with pytest.raises(ModelFileError, match=r"m\.model\.npz: xi: .* put the weights of .* back"):
            read_model(path)
    (tmp_path / "m.model.npz").unlink()
    with pytest.raises(ModelFileError, match=r"m\.model\.npz: missing, put the weights .* back beside it"):
        read_model(path)
    (tmp_path / "m.model.npz").write_bytes(b"")
    with pytest.raises(
        ModelFileError, match=r"the weights of m\.model\.toml cannot be read .*; learn it anew"
    ):
        read_model(path)


def test_model_file_unknown_key_and_bad_value_are_both_told(tmp_path):
    path = write_model(model(), tmp_path / "m.model.toml")
    path.write_text(path.read_text().replace("version = 1", "version = 2\nvercion = 1"))
    with pytest.raises(ConfigurationError) as error:
        read_model(path)
    assert len(error.value.problems) == 2


def test_model_file_missing_or_misnamed_is_said(tmp_path):
    with pytest.raises(
        ModelFileError, match=r"none\.model\.toml: cannot be read .*; give a \.model\.toml file"
    ):
        read_model(tmp_path / "none.model.toml")
    with pytest.raises(ModelFileError, match=r"ends in \.model\.toml"):
        write_model(model(), tmp_path / "m.toml")
