"""What becomes of forms in the answer: they are no values of an effect, but stay in its model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.host.trace.builders import VEHICLE, build_diagnosis, build_fit, build_flight
from tests.narrowing import not_none
from trimtab.host.effects import load_effects
from trimtab.host.models.file import read_model, write_model
from trimtab.host.models.model import Model
from trimtab.host.trace.assembly import far_adjustments, model_of, named_effects
from trimtab.host.trace.parameters import space
from trimtab.host.trace.selection import Diagnosis

EFFECTS = {name: load_effects()[name] for name in ("linear-drag", "mass", "rotor-loss", "thrust-gain")}
SPACE = space(VEHICLE, EFFECTS)
VALUES = {
    "linear-drag.dx": 0.5,
    "linear-drag.rotor_share": 0.4,
    "linear-drag.height_m": -0.01,
    "rotor-loss.loss_2": 0.2,
    "rotor-loss.torque_ratio": 1.5,
    "thrust-gain.gain": 0.995,
    "thrust-gain.rotor_share": 0.9,
}
THETA_SCALED = np.array(
    [(VALUES.get(f"{c.owner}.{c.key}", c.neutral) - c.neutral) / c.scale for c in SPACE.columns]
)
SELECTED = ("linear-drag", "rotor-loss.loss_2")
FORM_OF_THE_GAIN = "thrust-gain.rotor_share"


def diagnosis() -> Diagnosis:
    covariance = np.diag(np.square(0.01 * np.arange(1.0, 1.0 + len(THETA_SCALED))))
    fit = build_fit(SELECTED, theta_scaled=THETA_SCALED.tolist(), covariance=covariance)
    # Two poses 0.1 s apart are the shortest segment that has a speed.
    fit = replace(fit, data=replace(fit.data, dt_s=0.1, disturbance_frd=np.zeros((1, 2, 6))))
    return build_diagnosis(SELECTED, selected=fit, inclusion_probability=dict.fromkeys(SELECTED, 1.0))


def made(*, added: bool = True) -> Model:
    found = diagnosis()
    named = named_effects(SPACE, found, {name: {} for name in SELECTED}, dict.fromkeys(SELECTED, 1.0))
    return model_of(SPACE, found, THETA_SCALED, [build_flight()], named, added, None)


def test_named_effect_reports_no_form() -> None:
    named = named_effects(SPACE, diagnosis(), {name: {} for name in SELECTED}, dict.fromkeys(SELECTED, 1.0))
    assert {each.name: list(each.parameters) for each in named} == {
        "linear-drag": ["dx", "dy", "dz"],
        "rotor-loss": ["loss_2"],
    }


def test_model_holds_the_forms_of_named_effects_alone() -> None:
    model = made()
    assert model.effects["linear-drag"] == pytest.approx(
        {"dx": 0.5, "dy": 0.0, "dz": 0.0, "rotor_share": 0.4, "height_m": -0.01}
    )
    assert model.effects["rotor-loss"]["torque_ratio"] == pytest.approx(1.5)
    assert model.adjustments == {"mass": {"factor": 1.0}, "thrust-gain": {"gain": pytest.approx(0.995)}}


def test_covariance_of_a_model_is_that_of_what_it_holds() -> None:
    covariance = not_none(made().covariance)
    names = [f"{column.owner}.{column.key}" for column in SPACE.columns]
    assert list(covariance.names) == [name for name in names if name != FORM_OF_THE_GAIN]
    for i, name in enumerate(covariance.names):
        column = names.index(name)
        expected = 0.01 * (1 + column) * SPACE.columns[column].scale
        assert np.sqrt(covariance.matrix[i][i]) == pytest.approx(expected)


def test_model_with_forms_reads_back_and_fills_the_others_with_neutral_values(tmp_path: Path) -> None:
    model = made()
    again = read_model(write_model(model, tmp_path / "m.model.toml"), vehicle_id=VEHICLE.id)
    assert again.id == model.id
    assert again.effects == model.effects
    assert again.sd("linear-drag", "height_m") == pytest.approx(model.sd("linear-drag", "height_m"))
    parts = {effect.name: theta for effect, theta in again.parts(EFFECTS)}
    assert parts["linear-drag"] == pytest.approx((0.5, 0.0, 0.0, 0.4, -0.01))
    assert parts["rotor-loss"] == pytest.approx((0.0, 0.2, 0.0, 0.0, 0.0, 1.5))
    assert parts["thrust-gain"] == pytest.approx((0.995, 0.0))


def test_model_of_no_added_effects_holds_no_form() -> None:
    model = made(added=False)
    assert (model.effects, model.adjustments, model.covariance) == ({}, {}, None)


def test_form_is_no_adjustment_far_from_neutral() -> None:
    assert far_adjustments(SPACE, made()) == ()
