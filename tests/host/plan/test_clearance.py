"""Clearance: obstacles grow and gates shrink by the error that is predicted, or by what is stated."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.parts import part
from trimtab.host.base.errors import UsageError
from trimtab.host.codegen import NUMPY
from trimtab.host.plan import PlanRefused, ResidualModel, plan, write_plan
from trimtab.host.plan.clearance import ALLOWANCE_M, predicted_error_max_m, predicted_error_ned
from trimtab.host.plan.files import read_course
from trimtab.host.plan.profile import profile
from trimtab.host.plan.table import from_reference
from trimtab.host.route import Box, Cylinder, Gate, Route, Sphere
from trimtab.host.route.clearance import flown_clearance, room, with_clearance
from trimtab.host.route.shapes import Shape, grown
from trimtab.host.vehicle import load_vehicle

VEHICLE = load_vehicle("research")
POST = Cylinder(kind="cylinder", centre_m=(-1.5, 0.0), radius_m=0.3, down_m=(-3.0, 0.0))
WINDOW = Gate(waypoint=1, width_m=0.9, height_m=0.8, heading_deg=0.0)
SLALOM = Route(
    name="slalom",
    total_time_s=6.0,
    waypoints_m=((-3.0, 0.0, -1.2), (0.0, 0.6, -1.5), (3.0, 0.0, -1.2)),
    gates=(WINDOW,),
    keep_out=(POST, POST.model_copy(update={"centre_m": (1.5, 0.4)})),
)


DRAG = ResidualModel(parts=(part("linear-drag", 0.5, 0.6, 0.2),))


@pytest.mark.parametrize(
    "shape",
    [
        POST,
        Box(kind="box", min_m=(0.0, 0.0, -2.0), max_m=(1.0, 0.5, -1.0)),
        Sphere(kind="sphere", centre_m=(1.0, 2.0, -1.0), radius_m=0.4),
    ],
)
def test_grown_shape_holds_every_point_within_the_distance_and_no_face_is_further(shape: Shape) -> None:
    p = np.random.default_rng(3).uniform(-4.0, 4.0, (3, 4000))
    near = np.asarray(shape.signed_distance(NUMPY, list(p)))
    far = np.asarray(grown(shape, 0.25).signed_distance(NUMPY, list(p)))
    assert (far <= near - 0.25 + 2e-6).all()
    np.testing.assert_allclose(far[near > 0.25].min(), 0.0, atol=0.1)


def test_gate_shrinks_by_the_clearance_on_every_side_and_never_closes() -> None:
    assert with_clearance(SLALOM, 0.1).gates == (
        WINDOW.model_copy(update={"width_m": pytest.approx(0.7), "height_m": pytest.approx(0.6)}),
    )
    (smallest,) = with_clearance(SLALOM, 1.5).gates or (WINDOW,)
    assert (smallest.width_m, smallest.height_m) == (pytest.approx(0.09), pytest.approx(0.08))


def test_shape_grows_only_up_to_a_waypoint_that_must_be_met() -> None:
    beside = SLALOM.model_copy(update={"gates": None})
    grown_to = with_clearance(beside, 2.0).keep_out[1]
    assert grown_to.signed_distance(NUMPY, list(np.array(SLALOM.waypoints_m[1]))) == pytest.approx(1e-3)
    room_m, where = room(beside)
    assert room_m == pytest.approx(1.5 - 0.3 - 1e-3, abs=1e-6)
    assert where == "waypoints_m[0] beside keep_out[0] (cylinder)"


def test_predicted_error_is_that_of_the_integrated_position_loop() -> None:
    made = plan(SLALOM, VEHICLE, kind="min-control")
    along = profile(VEHICLE, DRAG, from_reference(made.reference), made.reference.yaw_nodes())
    assert along.residual is not None
    residual = along.residual
    k_p, k_v = VEHICLE.gains.position_p[0], VEHICLE.gains.velocity_d[0]

    def loop(t: float, e: np.ndarray) -> list[float]:
        return [e[1], np.interp(t, along.t_s, residual[0]) - k_p * e[0] - k_v * e[1]]

    exact = solve_ivp(loop, (0.0, along.t_s[-1]), [0.0, 0.0], t_eval=along.t_s, rtol=1e-8, atol=1e-10)
    found = predicted_error_ned(VEHICLE, DRAG, made.reference)
    np.testing.assert_allclose(found[:, 0], exact.y[0], atol=3e-3)
    assert np.abs(found[:, 0]).max() > 0.02
    assert predicted_error_max_m(VEHICLE, ResidualModel(), made.reference) == 0.0


def test_plan_keeps_the_error_that_its_model_predicts_and_the_allowance() -> None:
    made = plan(SLALOM, VEHICLE, kind="min-residual", model=DRAG)
    assert made.clearance_m is not None
    assert made.clearance_m >= ALLOWANCE_M + made.predicted_error_max_m > ALLOWANCE_M + 0.02
    assert min(made.margins["keep_out_m"], made.margins["gates_m"]) >= made.clearance_m - 1e-6


def test_stated_clearance_is_kept_as_it_is() -> None:
    made = plan(SLALOM, VEHICLE, kind="min-residual", model=DRAG, clearance_m=0.3)
    assert made.clearance_m == 0.3
    assert min(made.margins["keep_out_m"], made.margins["gates_m"]) >= 0.3 - 1e-6
    none = plan(SLALOM, VEHICLE, kind="min-residual", model=DRAG, clearance_m=0.0)
    assert min(none.margins["keep_out_m"], none.margins["gates_m"]) < 0.3


@pytest.mark.parametrize("clearance_m", [-0.1, 2.1, float("nan"), 0.37])
def test_clearance_out_of_range_or_without_room_is_one_line(clearance_m: float) -> None:
    with pytest.raises(UsageError, match=r"clearance") as caught:
        plan(SLALOM, VEHICLE, kind="min-control", clearance_m=clearance_m)
    assert "\n" not in str(caught.value)


def test_refusal_names_the_clearance() -> None:
    with pytest.raises(PlanRefused, match=r"inside keep_out\[1\] \(cylinder\) and its clearance of 0.1 m"):
        plan(SLALOM, VEHICLE, kind="min-snap")


def test_course_is_read_back_beside_its_reference_only(tmp_path: Path) -> None:
    made = plan(SLALOM, VEHICLE, kind="min-control")
    path = write_plan(made, tmp_path / "a.ref")
    assert read_course(path, made.reference.id) == (SLALOM, made.waypoint_times_s)
    assert read_course(path, "0" * 12) is None
    record = json.loads((tmp_path / "a.ref.json").read_text())
    for damage in ({"route": {"name": 3}}, {"plan": {"waypoint_times_s": [0.0]}}, {"plan": []}):
        (tmp_path / "a.ref.json").write_text(json.dumps({**record, **damage}))
        assert read_course(path, made.reference.id) is None
    (tmp_path / "a.ref.json").write_bytes(b"\xff{")
    assert read_course(path, made.reference.id) is None


def test_flown_clearance_is_the_nearest_passing_of_each_obstacle() -> None:
    t_s = np.arange(0.0, 6.0, 0.01)
    p = np.column_stack(
        [np.interp(t_s, [0.0, 6.0], [-3.0, 3.0]), np.full(len(t_s), 0.7), np.full(len(t_s), -1.5)]
    )
    gate, first, second = flown_clearance(SLALOM, (0.0, 3.2, 6.0), t_s, p)
    assert (gate.obstacle, first.obstacle, second.obstacle) == ("gates[0]", "keep_out[0]", "keep_out[1]")
    assert gate.distance_m == pytest.approx(0.35, abs=1e-3)
    assert gate.t_s == pytest.approx(3.0, abs=2e-3)
    assert first.distance_m == pytest.approx(0.4, abs=1e-3)
    assert second.distance_m == pytest.approx(0.0, abs=1e-3)
    short = flown_clearance(SLALOM, (0.0, 3.2, 6.0), t_s[:200], p[:200])
    assert [each.obstacle for each in short] == ["keep_out[0]", "keep_out[1]"]
