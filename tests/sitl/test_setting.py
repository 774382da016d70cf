"""Where a simulated vehicle stands after a reboot."""

from __future__ import annotations

import math

import pytest

from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.draw import draw_world
from trimtab.sitl.setting import Place, Setting
from trimtab.sitl.world import load_world

START = Place((0.5, -0.3, 0.0), 1.0)
HALF = math.sqrt(0.5)


@pytest.fixture
def setting() -> Setting:
    vehicle = load_vehicle("research")
    world = draw_world(*load_world("empty"), 0, vehicle)
    return Setting(
        vehicle=vehicle, world=world, is_world_named=True, plant=None, plant_options={}, start=START
    )


def test_upright_vehicle_stays_where_it_stands(setting: Setting) -> None:
    place = setting.place_after_reboot([1.0, 2.0, 0.001, 0.0, 0.0, 0.0, HALF, 0.0, 0.0, HALF])
    assert place.p_ned == (1.0, 2.0, 0.0)
    assert place.yaw == pytest.approx(0.5 * math.pi)
    assert place.q_ned_frd == pytest.approx((HALF, 0.0, 0.0, HALF))


@pytest.mark.parametrize(
    "pose",
    [
        pytest.param([1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0], id="on its back"),
        pytest.param([1.0, 2.0, 0.0, 0.0, 0.0, 0.0, HALF, 0.0, HALF, 0.0], id="on its nose"),
        pytest.param([99.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], id="outside north"),
        pytest.param([1.0, -99.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], id="outside west"),
    ],
)
def test_crashed_vehicle_is_put_back_to_its_start(setting: Setting, pose: list[float]) -> None:
    assert setting.place_after_reboot(pose) == START
