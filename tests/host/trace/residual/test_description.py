"""Description of known disturbances along flown paths: the right group is identified, and none for noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trimtab.host.log import read_flight
from trimtab.host.report.figures import dependence
from trimtab.host.trace import words
from trimtab.host.trace.data.cutting import segments_of
from trimtab.host.trace.data.segments import Segments
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.residual.description import Description, describe
from trimtab.host.trace.residual.features import Bins, bins_of
from trimtab.host.vehicle import load_vehicle

DATA = Path(__file__).parents[3] / "data"
VEHICLE = load_vehicle("research")
REFERENCES = ("a", "a", "b", "b", "c")
Push = Callable[[Bins], np.ndarray]


@pytest.fixture(scope="module")
def data() -> Segments:
    names = ("a1", "a2", "b1", "b2", "c1")
    return segments_of(
        [FlightData.of(read_flight(DATA / f"{name}.mcap")) for name in names],
        rate_driven=False,
    )[0]


def noise(shape: tuple[int, ...]) -> np.ndarray:
    """Return force and torque like those of turbulence: correlated between bins."""
    rng = np.random.default_rng(5)
    w = rng.normal(size=shape)
    for k in range(1, shape[1]):
        w[:, k] = 0.75 * w[:, k - 1] + 0.66 * w[:, k]
    return w * np.array([0.05, 0.05, 0.05, 0.6, 0.6, 0.6])


def described(data: Segments, force: Push | None = None, torque: Push | None = None) -> Description:
    """Return the description of noise plus a force in NED and a torque in body axes."""
    shape = (len(data.flight), data.bins, 6)
    w = noise(shape)
    bins = bins_of(w, data, REFERENCES, VEHICLE)
    if force is not None:
        w[:, :, :3] += np.einsum("nij,ni->nj", bins.R, force(bins)).reshape(*shape[:2], 3)
    if torque is not None:
        w[:, :, 3:] += torque(bins).reshape(*shape[:2], 3)
    return describe(w, data, REFERENCES, VEHICLE)


def tether(bins: Bins) -> np.ndarray:
    reach = np.array([0.4, -0.3, 0.0]) - bins.p
    distance = np.linalg.norm(reach, axis=1, keepdims=True)
    return 0.6 * np.maximum(distance - 0.8, 0.0) * reach / distance


def test_noise_depends_on_no_group(data: Segments) -> None:
    description = described(data)
    assert description.held_out == "reference"
    assert description.force.group is None
    assert description.torque is not None
    assert description.torque.group is None
    assert description.form is None
    assert "none of" in words.description(description)[0]
    assert {s.group for s in description.force.skills} == {
        "constant", "position", "time", "body velocity", "attitude", "body rate", "thrust",
    }  # fmt: skip


def test_a_tether_is_a_force_of_position_towards_its_anchor(data: Segments) -> None:
    description = described(data, tether)
    assert description.force.group == "position"
    assert description.force.skill_of("position").low > 0.0
    form = description.form
    assert form is not None
    assert form.name == "point"
    anchor = [form.parameters[key] for key in ("north_m", "east_m", "down_m")]
    np.testing.assert_allclose(anchor, [0.4, -0.3, 0.0], atol=0.15)
    assert form.parameters["per_s2"] == pytest.approx(0.6, rel=0.1)
    assert form.parameters["slack_m"] == pytest.approx(0.8, abs=0.15)
    assert form.skill > 0.9
    assert "pulls towards" in words.description(description)[1]
    bins = bins_of(noise((len(data.flight), data.bins, 6)), data, REFERENCES, VEHICLE)
    np.testing.assert_allclose(description.pushes, tether(replace(bins, p=description.cells)), atol=0.1)


def test_a_force_at_a_place_is_located_there(data: Segments) -> None:
    place, push = np.array([0.0, 0.5, -1.2]), np.array([0.0, 1.5, 0.0])

    def fan(bins: Bins) -> np.ndarray:
        return np.exp(-0.5 * (np.linalg.norm(bins.p - place, axis=1, keepdims=True) / 0.4) ** 2) * push

    description = described(data, fan)
    assert description.force.group == "position"
    assert description.form is not None
    assert description.form.name == "place"
    assert description.form.parameters["push_east"] == pytest.approx(1.5, rel=0.2)
    assert description.form.parameters["width_m"] == pytest.approx(0.4, rel=0.2)


def test_an_attracting_wall_is_a_force_along_its_normal(data: Segments) -> None:
    east = np.array([0.0, 1.0, 0.0])
    description = described(data, lambda bins: np.exp(bins.p[:, 1:2] / 0.7) * east)
    assert description.form is not None
    assert description.form.name == "along"
    assert description.form.parameters["azimuth_deg"] == pytest.approx(90.0, abs=8.0)
    assert description.form.parameters["length_m"] == pytest.approx(0.7, rel=0.2)


def test_a_jet_is_a_force_along_its_axis(data: Segments) -> None:
    def jet(bins: Bins) -> np.ndarray:
        return 1.5 * np.exp(-0.5 * ((bins.p[:, 1:2] - 0.2) / 0.3) ** 2) * np.array([1.0, 0.0, 0.0])

    description = described(data, jet)
    assert description.form is not None
    assert description.form.name == "jet"
    assert description.form.parameters["push_m_s2"] == pytest.approx(1.5, rel=0.15)
    assert description.form.parameters["width_m"] == pytest.approx(0.3, rel=0.15)
    assert np.cos(np.deg2rad(description.form.parameters["azimuth_deg"])) > 0.98


def test_response_of_the_control_law_is_not_called_a_cause(data: Segments) -> None:
    description = described(
        data, torque=lambda bins: 40.0 * (bins.rotors[:, :1] - bins.rotors[:, 1:2]) * [1.0, 0.0, 0.0]
    )
    assert description.torque is not None
    assert description.torque.group == "thrust"
    assert "need not be the cause" in words.dependence(description.torque)[1]


def test_a_force_in_proportion_to_body_velocity_shows_its_slope(data: Segments) -> None:
    def drag(bins: Bins) -> np.ndarray:
        return np.einsum("nij,nj->ni", bins.R, bins.v_frd * [-0.4, 0.0, 0.0])

    description = described(data, drag).force
    assert description.group == "body velocity"
    assert [(s.axis, s.quantity) for s in description.slopes] == [("x", "velocity x")]
    assert description.slopes[0].value == pytest.approx(-0.4, rel=0.1)


def test_torque_that_depends_on_velocity_is_distinguished_from_force(data: Segments) -> None:
    description = described(data, torque=lambda bins: 3.0 * bins.v_frd[:, [1, 0, 2]] * [-1.0, 1.0, 0.0])
    assert description.force.group is None
    assert description.torque is not None
    assert description.torque.group == "body velocity"
    assert {(s.axis, s.quantity) for s in description.torque.slopes} == {
        ("x", "velocity y"),
        ("y", "velocity x"),
    }


def test_a_constant_torque_is_called_constant(data: Segments) -> None:
    description = described(data, torque=lambda bins: np.tile([0.0, 2.0, 0.0], (len(bins.w), 1))).torque
    assert description is not None
    assert description.group == "constant"
    assert description.mean[1] == pytest.approx(2.0, abs=0.2)
    assert description.slopes == ()


def test_one_reference_is_judged_on_time_blocks(data: Segments) -> None:
    first = data.take(data.flight < 2)
    w = noise((len(first.flight), first.bins, 6))
    description = describe(w, first, ("a", "a"), VEHICLE)
    assert description.held_out == "blocks"
    assert "one reference" in words.description(description)[-1]
    assert description.force.group is None


def test_description_of_rate_driven_segments_has_no_torque(data: Segments) -> None:
    driven = replace(data, rate_driven=True)
    w = noise((len(data.flight), data.bins, 6))
    description = describe(w, driven, REFERENCES, VEHICLE)
    assert description.torque is None
    assert description.to_json()["torque"] is None


def test_the_picture_shows_field_and_slopes(data: Segments) -> None:
    description = described(data, tether, lambda bins: 3.0 * bins.v_frd)
    shown = dependence(description)
    assert "pulls towards" in shown.alt
    assert shown.svg.startswith("<?xml")
    assert dependence(described(data)).alt.count("none of") == 2
