"""What of a model goes on board, and what does not."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trimtab.host.base.errors import UsageError
from trimtab.host.effects import load_effects
from trimtab.host.models.correction import check_name, correction, write_correction
from trimtab.host.models.model import Model
from trimtab.host.models.network import Layout, Network
from trimtab.host.models.region import Region
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import BLOCK_FIELDS, FeedForward
from trimtab.protocol.parameters import float32

EFFECTS = load_effects()
REGION = Region(speed_max_m_s=3.0, tilt_max_deg=30.0, thrust_min_n=5.0, thrust_max_n=10.0)


def model(vehicle: Vehicle, adjustments: Any = None, **effects: Any) -> Model:
    named = {name.replace("_", "-"): values for name, values in effects.items()}
    return Model(
        vehicle_id=vehicle.id,
        vehicle_name=vehicle.name,
        effects=named,
        adjustments=adjustments or {},
        region=REGION,
    )


def entry(feedforward: FeedForward | None, name: str) -> tuple[float, ...]:
    assert feedforward is not None
    assert feedforward.block is not None
    start = 0
    for field, size in BLOCK_FIELDS:
        if field == name:
            return feedforward.block[start : start + size]
        start += size
    raise KeyError(name)


def test_correction_of_closed_forms_fills_the_block_and_says_how(vehicle: Vehicle) -> None:
    traced = model(
        vehicle,
        thrust_gain={"gain": 0.9},
        linear_drag={"dx": 0.4, "dy": 0.3, "dz": 0.2},
        wind={"wx": 1.0, "wy": -2.0},
        battery_sag={"exponent": 1.8},
        com_offset={"x": 0.004, "y": 0.0},
    )
    made = correction(traced, vehicle, EFFECTS)
    feedforward = made.feedforward
    assert feedforward is not None
    assert (feedforward.vehicle_id, feedforward.model_id) == (vehicle.id, traced.id)
    assert entry(feedforward, "gain") == (float32(0.9),)
    assert entry(feedforward, "linear_drag") == tuple(map(float32, (0.4, 0.3, 0.2)))
    assert entry(feedforward, "wind_ned") == (1.0, -2.0, 0.0)
    assert entry(feedforward, "voltage_exponent") == (float32(1.8),)
    assert sorted(made.corrected) == ["battery-sag", "linear-drag", "thrust-gain", "wind"]
    assert made.uncorrected == {"com-offset": EFFECTS["com-offset"].closing.no_law}
    assert made.excess is None


def test_region_is_that_of_the_reference_with_the_corrected_thrust(vehicle: Vehicle) -> None:
    made = correction(model(vehicle, thrust_gain={"gain": 0.9}), vehicle, EFFECTS)
    assert made.feedforward is not None
    per_newton = 0.9 / vehicle.mass_kg
    assert made.feedforward.region == pytest.approx(
        (3.0, math.radians(30.0), 5.0 * per_newton, 10.0 * per_newton), rel=1e-6
    )


def test_region_with_sag_spans_the_thrusts_from_an_empty_to_a_full_battery(vehicle: Vehicle) -> None:
    made = correction(model(vehicle, battery_sag={"exponent": 2.0}), vehicle, EFFECTS)
    assert made.feedforward is not None
    assert made.feedforward.region is not None
    battery = vehicle.battery
    low = 5.0 / vehicle.mass_kg * (battery.empty_v / battery.full_v) ** 2
    assert made.feedforward.region.thrust_min_m_s2 == pytest.approx(low, rel=1e-6)
    assert made.feedforward.region.thrust_max_m_s2 == pytest.approx(10.0 / vehicle.mass_kg, rel=1e-6)


def test_wind_is_corrected_only_with_a_drag(vehicle: Vehicle) -> None:
    windy = {"wind": {"wx": 2.0, "wy": 0.0}}
    alone = correction(model(vehicle, **windy), vehicle, EFFECTS)
    assert alone.feedforward is None
    assert list(alone.uncorrected) == ["wind"]
    gained = correction(model(vehicle, **windy, thrust_gain={"gain": 0.9}), vehicle, EFFECTS)
    assert entry(gained.feedforward, "wind_ned") == (0.0, 0.0, 0.0)
    assert (list(gained.corrected), list(gained.uncorrected)) == (["thrust-gain"], ["wind"])
    for drag in ({"linear_drag": {"dx": 0.1}}, {"quadratic_drag": {"c": 0.1}}, {"thrust_inflow": {"k": 0.5}}):
        moving = correction(model(vehicle, **windy, **drag), vehicle, EFFECTS)
        assert entry(moving.feedforward, "wind_ned") == (2.0, 0.0, 0.0)
        assert "wind" in moving.corrected


def test_adjustments_are_corrected_and_never_listed_as_uncorrected(vehicle: Vehicle) -> None:
    adjusted = model(vehicle, adjustments={"mass": {"factor": 1.002}, "actuation-delay": {"delay_s": 0.001}})
    made = correction(adjusted, vehicle, EFFECTS)
    assert entry(made.feedforward, "gain") == (float32(1.0 / 1.002),)
    assert made.uncorrected == {}


@pytest.mark.parametrize("frame", ["world", "body"])
def test_network_goes_on_board_in_its_frame(vehicle: Vehicle, frame: Any) -> None:
    layout = Layout(hidden=(4, 3), frame=frame)
    network = Network(layout=layout, xi=layout.initial(np.random.default_rng(1)))
    learned = Model(vehicle_id=vehicle.id, vehicle_name=vehicle.name, network=network, region=REGION)
    made = correction(learned, vehicle, EFFECTS)
    assert made.feedforward is not None
    assert (made.feedforward.layers, made.feedforward.frame) == ((4, 3), frame)
    assert made.feedforward.weights == pytest.approx(tuple(network.xi), rel=1e-6)
    assert list(made.corrected) == ["network"]


def test_nothing_to_correct_gives_no_feedforward(vehicle: Vehicle) -> None:
    lagging = model(vehicle, motor_lag={"extra_s": 0.02}, com_offset={"x": 0.004, "y": 0.0})
    made = correction(lagging, vehicle, EFFECTS)
    assert made.feedforward is None
    assert sorted(made.uncorrected) == ["com-offset", "motor-lag"]


def test_values_out_of_range_are_stated(vehicle: Vehicle) -> None:
    made = correction(model(vehicle, thrust_gain={"gain": 0.2}), vehicle, EFFECTS)
    assert made.excess is not None
    assert made.excess.quantity == "gain"
    assert made.excess.bound == 0.3


def test_every_effect_states_how_or_why_not() -> None:
    for effect in EFFECTS.values():
        assert (effect.closing.law is None) != (effect.closing.no_law is None), effect.name


def test_file_and_its_provenance_are_written_together(vehicle: Vehicle, tmp_path: Path) -> None:
    made = correction(model(vehicle, thrust_gain={"gain": 0.9}), vehicle, EFFECTS)
    assert made.feedforward is not None
    path = tmp_path / "x.ff"
    write_correction(made.feedforward, path, contents=made, provenance={"seed": 1})
    assert FeedForward.from_bytes(path.read_bytes()) == made.feedforward
    record = json.loads((tmp_path / "x.ff.json").read_text())
    assert record["feedforward"] == made.feedforward.id
    assert record["provenance"] == {"seed": 1}
    assert list(record["corrected"]) == ["thrust-gain"]
    for name, message in (("x.ff", "exists"), ("x.toml", "name ends in .ff")):
        with pytest.raises(UsageError, match=message):
            check_name(tmp_path / name)
