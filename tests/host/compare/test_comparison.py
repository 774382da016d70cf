"""What differs between logs, models, plans and folders: figures, intervals, pairs and refusals."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from trimtab.host.base.errors import TrimtabError, UsageError
from trimtab.host.base.output import json_text
from trimtab.host.compare.comparison import Comparison, compare
from trimtab.host.compare.comparison_words import lines, notes
from trimtab.host.compare.logs import FlightFigures, compare_logs
from trimtab.host.log import ChangedSetting, LogError, Setting, read_flight
from trimtab.host.log.tracking import tracking_error
from trimtab.host.models.file import write_model
from trimtab.host.models.model import Assessment, Covariance, Model
from trimtab.host.models.network import Layout, Network
from trimtab.host.plan import plan, write_plan
from trimtab.host.route import Gate, Route
from trimtab.host.route.shapes import Box
from trimtab.host.vehicle import load_vehicle
from trimtab.host.workspace import open_workspace

DATA = Path(__file__).parents[2] / "data"
VEHICLE = load_vehicle("research")
ROUTE = Route(
    name="hop",
    waypoints_m=((0.0, 0.0, -1.2), (1.0, 0.5, -1.5), (2.0, 0.0, -1.2)),
    total_time_s=5.0,
    gates=(Gate(waypoint=1, width_m=0.8, height_m=0.6, heading_deg=0.0),),
    keep_out=(Box(kind="box", min_m=(0.5, -2.0, -2.0), max_m=(1.0, -1.0, -0.5)),),
)
LAYOUT = Layout(hidden=(3,))


def compared(a: Path, b: Path) -> Comparison:
    result = compare(a, b, open_workspace(a.parent))
    json.loads(json_text(result.to_dict()))
    assert lines(result)[:2] == [f"A: {a}", f"B: {b}"]
    return result


def flown(
    log: str,
    reference: str | None,
    rmse_m: float,
    *,
    faded_s: float | None = None,
    settings: dict[str, Setting] | None = None,
) -> FlightFigures:
    figures = {"error_mean_m": rmse_m, "error_rmse_m": rmse_m, "error_max_m": 2.0 * rmse_m}
    if faded_s is not None:
        figures["feedforward_faded_s"] = faded_s
    return FlightFigures(
        log=log,
        id=log,
        reference=reference,
        vehicle=VEHICLE,
        settings=settings,
        figures=figures,
        notes=(),
    )


# Logs


def test_settings_on_board_that_differ_are_listed() -> None:
    a = [flown("a1", "r", 0.1, settings={"MASS": 0.75, "RATE_P_X": 30.0})]
    b = [flown("b1", "r", 0.1, settings={"MASS": 0.75, "RATE_P_X": 25.0}), flown("b2", "r", 0.1)]
    found = compare_logs(a, b)
    assert found.settings == (ChangedSetting(name="RATE_P_X", before=(30.0,), after=(25.0,)),)
    assert found.to_dict()["settings"] == [{"name": "RATE_P_X", "a": [30.0], "b": [25.0]}]
    result = Comparison(a="a", b="b", logs=found, models=(), plans=(), unpaired=(), notes=())
    assert lines(result)[-1] == "settings on board that differ: RATE_P_X 30 in A, 25 in B"
    unknown = compare_logs(a, b[1:])
    assert unknown.settings is None
    assert unknown.to_dict()["settings"] is None


def test_flights_are_paired_by_reference_and_repeats_are_averaged() -> None:
    a = [flown("a1", "r", 0.10), flown("a2", "r", 0.12), flown("a3", "s", 0.20), flown("a4", "t", 0.30)]
    b = [flown("b1", "s", 0.15), flown("b2", "r", 0.08), flown("b3", "u", 0.5)]
    found = compare_logs(a, b)
    assert [(pair.reference, pair.a_logs, pair.b_logs) for pair in found.pairs] == [
        ("r", ("a1", "a2"), ("b2",)),
        ("s", ("a3",), ("b1",)),
    ]
    assert (found.over, found.a_only, found.b_only) == ("references", ("a4",), ("b3",))
    rmse = next(figure for figure in found.figures if figure.figure == "error_rmse_m")
    assert (rmse.a, rmse.b) == pytest.approx((0.155, 0.115))
    expected = stats.ttest_1samp([-0.03, -0.05], 0.0).confidence_interval(0.95)
    assert rmse.difference is not None
    assert rmse.difference.count == 2
    assert rmse.difference.mean == pytest.approx(-0.04)
    assert (rmse.difference.low, rmse.difference.high) == pytest.approx((expected.low, expected.high))


def test_repeats_of_one_reference_are_compared_without_pairs() -> None:
    a, b = [0.10, 0.11, 0.12], [0.07, 0.08]
    found = compare_logs(
        [flown(f"a{k}", "r", error) for k, error in enumerate(a)],
        [flown(f"b{k}", "r", error) for k, error in enumerate(b)],
    )
    expected = stats.ttest_ind(b, a, equal_var=False).confidence_interval(0.95)
    difference = found.figures[1].difference
    assert found.over == "flights"
    assert difference is not None
    assert (difference.low, difference.high) == pytest.approx((expected.low, expected.high))


def test_one_pair_is_too_few_to_say() -> None:
    found = Comparison(
        a="a",
        b="b",
        logs=compare_logs([flown("a", "r", 0.1)], [flown("b", "r", 0.2)]),
        models=(),
        plans=(),
        unpaired=(),
        notes=(),
    )
    assert found.logs is not None
    difference = found.logs.figures[0].difference
    assert difference is not None
    assert (difference.mean, difference.low) == (pytest.approx(0.1), None)
    assert sum("too few to say" in line for line in lines(found)) == len(found.logs.figures) == 3


def test_without_a_common_reference_there_are_means_and_no_difference() -> None:
    found = compare_logs([flown("a", "r", 0.1), flown("b", None, 0.3)], [flown("c", "s", 0.2)])
    assert found.over is None
    assert [(figure.a, figure.b, figure.difference) for figure in found.figures][:1] == [(0.2, 0.2, None)]
    assert (found.a_only, found.b_only) == (("a", "b"), ("c",))
    result = Comparison(a="a", b="b", logs=found, models=(), plans=(), unpaired=(), notes=())
    assert "no reference in common, so no difference: the means below" in "\n".join(lines(result))
    nothing = replace(result, logs=compare_logs([flown("a", None, 0.1)], []))
    assert "no reference in common, so no difference" in lines(nothing)


def test_figure_that_one_flight_lacks_is_of_the_other_pairs() -> None:
    a = [flown("a1", "r", 0.1, faded_s=0.5), flown("a2", "s", 0.1)]
    b = [flown("b1", "r", 0.1, faded_s=0.2), flown("b2", "s", 0.1, faded_s=9.0)]
    faded = compare_logs(a, b).figures[-1]
    assert faded.figure == "feedforward_faded_s"
    assert (faded.a, faded.b) == (0.5, 0.2)
    assert faded.difference is not None
    assert faded.difference.count == 1


def test_logs_give_the_figures_of_the_log_package() -> None:
    found = compared(DATA / "a1.mcap", DATA / "a2.mcap").logs
    assert found is not None
    (pair,) = found.pairs
    errors = [tracking_error(read_flight(DATA / name)) for name in ("a1.mcap", "a2.mcap")]
    for key in ("mean_m", "rmse_m", "max_m"):
        assert pair.figures[f"error_{key}"] == tuple(getattr(error, key) for error in errors)


def test_folder_leaves_out_what_it_cannot_read_and_says_so(tmp_path: Path) -> None:
    for name in ("a1.mcap", "b1.mcap"):
        shutil.copy(DATA / name, tmp_path / name)
    (tmp_path / "bad.mcap").write_bytes((DATA / "a2.mcap").read_bytes()[:70_000])
    found = compared(tmp_path, DATA / "a1.mcap")
    assert found.logs is not None
    assert found.logs.a_only == (str(tmp_path / "b1.mcap"),)
    assert any("bad.mcap" in note and "left out" in note for note in notes(found))
    assert any("this flight is in both" in note for note in notes(found))
    with pytest.raises(LogError, match=r"bad\.mcap"):
        compare(tmp_path / "bad.mcap", tmp_path / "a1.mcap", open_workspace(tmp_path))
    (tmp_path / "a1.mcap").unlink()
    (tmp_path / "b1.mcap").unlink()
    with pytest.raises(LogError, match="none of its logs can be read"):
        compare(tmp_path, DATA / "a1.mcap", open_workspace(tmp_path))


# Models


def model(dx: float, sd: float | None, **more) -> Model:
    covariance = None
    if sd is not None:
        covariance = Covariance(names=("linear-drag.dx",), matrix=((sd**2,),))
    values = {
        "vehicle_id": VEHICLE.id,
        "vehicle_name": VEHICLE.name,
        "effects": {"linear-drag": {"dx": dx}},
        "covariance": covariance,
        "assessment": Assessment(verdict="traced", held_out_flights=1, before_m=0.1, after_m=0.004),
    }
    return Model(**{**values, **more})


def models(folder: Path, a: Model, b: Model) -> Comparison:
    for name, content in (("a", a), ("b", b)):
        write_model(content, folder / f"{name}.model.toml", force=True)
    return compared(folder / "a.model.toml", folder / "b.model.toml")


def test_parameter_differs_by_its_combined_standard_deviation(tmp_path: Path) -> None:
    (found,) = models(tmp_path, model(0.40, 0.03), model(0.45, 0.04)).models
    (drag,) = found.parameters
    assert drag.difference == pytest.approx(0.05)
    assert drag.sds == pytest.approx(1.0)
    assert drag.far is False
    assert drag.unit == "1/s"
    result = models(tmp_path, model(0.40, 0.03), model(0.45, 0.04))
    shown = (
        "  linear-drag.dx: 0.4 +- 0.06 and 0.45 +- 0.08 1/s, difference +0.05, +1.0 sd"  # two sd, as trace
    )
    assert shown in lines(result)
    (found,) = models(tmp_path, model(0.40, 0.03), model(0.60, 0.04)).models
    assert found.parameters[0].sds == pytest.approx(4.0)
    assert found.parameters[0].far is True


@pytest.mark.parametrize(("first", "second"), [(None, 0.1), (0.1, None), (0.0, 0.0)])
def test_parameter_without_uncertainty_is_not_judged(
    tmp_path: Path, first: float | None, second: float | None
) -> None:
    result = models(tmp_path, model(0.40, first), model(0.60, second))
    drag = result.models[0].parameters[0]
    assert (drag.sds, drag.far) == (None, None)
    assert any("+0.2; a file states no uncertainty" in line for line in lines(result))


def test_effect_of_one_model_and_adjustment_of_the_other_is_compared(tmp_path: Path) -> None:
    named = model(0.4, None, effects={"linear-drag": {"dx": 0.4}, "mass": {"factor": 1.1}})
    adjusted = model(0.4, None, adjustments={"mass": {"factor": 1.02}, "wind": {"wx": 0.1}}, data=("a" * 12,))
    result = models(tmp_path, named, replace(adjusted, effects={"inertia": {"x": 1.2}}))
    (found,) = result.models
    assert [(p.effect, p.a_named, p.b_named) for p in found.parameters] == [("mass", True, False)]
    assert (found.a_only, found.b_only) == (("linear-drag", "mass"), ("inertia",))
    assert found.shared_logs == 0
    assert "  named only in B: inertia" in lines(result)


def test_networks_are_the_same_only_byte_by_byte(tmp_path: Path) -> None:
    xi = LAYOUT.initial(np.random.default_rng(0))
    with_network = model(0.4, 0.1, network=Network(layout=LAYOUT, xi=xi))
    other = model(0.4, 0.1, network=Network(layout=LAYOUT, xi=np.nextafter(xi, 1.0)))
    without = model(0.4, 0.1)
    for a, b, expected in (
        (with_network, with_network, "same"),
        (with_network, other, "different"),
        (with_network, without, "only-a"),
        (without, with_network, "only-b"),
        (without, without, "none"),
    ):
        assert models(tmp_path, a, b).models[0].networks == expected


def test_common_logs_are_counted_and_told(tmp_path: Path) -> None:
    a, b = model(0.4, 0.1, data=("a" * 12, "b" * 12)), model(0.4, 0.1, data=("b" * 12,))
    result = models(tmp_path, a, b)
    assert result.models[0].shared_logs == 1
    assert any("the values are not independent" in line for line in lines(result))


def test_models_of_two_vehicles_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        UsageError, match=r"b\.model\.toml: of vehicle other .* compare models of one vehicle"
    ):
        models(tmp_path, model(0.4, 0.1), model(0.4, 0.1, vehicle_id="0" * 12, vehicle_name="other"))


# Plans


@pytest.fixture(scope="module")
def plans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plans")
    for name, time_s in (("slow", 5.0), ("fast", 4.0)):
        planned = plan(ROUTE.model_copy(update={"total_time_s": time_s}), VEHICLE)
        write_plan(planned, folder / f"{name}.ref", provenance={"parents": {}})
    return folder


def test_plans_have_their_figures_and_differences(plans: Path) -> None:
    result = compared(plans / "slow.ref", plans / "fast.ref")
    (found,) = result.plans
    record = json.loads((plans / "slow.ref.json").read_text())["plan"]
    assert found.a.duration_s == pytest.approx(5.0)
    assert found.differences["duration_s"] == pytest.approx(-1.0)
    assert found.a.path_length_m == pytest.approx(record["path_length_m"], rel=1e-3)
    clearance = min(record["margins"]["keep_out_m"], record["margins"]["gates_m"])
    assert found.a.clearance_m == pytest.approx(clearance, abs=1e-6)
    for name in ("speed_max_m_s", "tilt_max_deg", "thrust_share_max"):
        difference = found.differences[name]
        assert difference is not None
        assert difference > 0.0
    headroom = VEHICLE.limits.tilt_max_deg - record["margins"]["tilt_deg"]
    assert found.a.tilt_max_deg == pytest.approx(headroom, abs=0.1)
    assert found.a.predicted_error_max_m is None  # a plan without a model predicts nothing
    assert not found.same
    assert any(line.startswith("  duration: 5.00 s and 4.00 s") for line in lines(result))


def test_plan_with_a_model_states_its_predicted_error(plans: Path, tmp_path: Path) -> None:
    for name in ("slow.ref", "slow.ref.json"):
        shutil.copy(plans / name, tmp_path / name)
    record = json.loads((tmp_path / "slow.ref.json").read_text())
    record["provenance"]["parents"]["model"] = "1" * 12
    record["plan"]["predicted_error_max_m"] = 0.025
    (tmp_path / "slow.ref.json").write_text(json.dumps(record))
    found = compared(plans / "slow.ref", tmp_path / "slow.ref").plans[0]
    assert (found.a.predicted_error_max_m, found.b.predicted_error_max_m) == (None, 0.025)
    assert found.differences["predicted_error_max_m"] is None
    assert found.same


@pytest.mark.parametrize("damage", ["{", '{"reference": "another"}', "[]", None])
def test_plan_without_a_usable_record_has_no_clearance(
    plans: Path, tmp_path: Path, damage: str | None
) -> None:
    shutil.copy(plans / "slow.ref", tmp_path / "slow.ref")
    if damage is not None:
        (tmp_path / "slow.ref.json").write_text(damage)
    found = compared(tmp_path / "slow.ref", plans / "slow.ref").plans[0]
    assert (found.a.clearance_m, found.a.predicted_error_max_m) == (None, None)
    assert found.b.clearance_m is not None


def test_plan_of_an_unknown_vehicle_has_no_tilt_and_no_thrust(plans: Path, tmp_path: Path) -> None:
    content = bytearray((plans / "slow.ref").read_bytes())
    content[8:14] = bytes(6)  # the vehicle's id
    (tmp_path / "other.ref").write_bytes(bytes(content))
    result = compared(tmp_path / "other.ref", plans / "slow.ref")
    found = result.plans[0].a
    assert (found.vehicle, found.tilt_max_deg, found.thrust_share_max) == (None, None, None)
    assert "  vehicle: not known and research" in lines(result)


# Folders and refusals


def test_folders_pair_models_and_plans_by_name(plans: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    for folder, drag in ((first, 0.4), (second, 0.5)):
        folder.mkdir()
        write_model(model(drag, 0.1), folder / "trace.model.toml")
        shutil.copy(plans / "slow.ref", folder / "hop.ref")
        shutil.copy(DATA / "a1.mcap", folder / "a1.mcap")
    shutil.copy(plans / "fast.ref", second / "sprint.ref")
    write_model(model(0.4, 0.1), second / "other.model.toml")
    result = compared(first, second)
    assert [each.parameters[0].difference for each in result.models] == [pytest.approx(0.1)]
    assert [each.same for each in result.plans] == [True]
    assert result.logs is not None
    assert len(result.logs.pairs) == 1
    assert result.unpaired == (str(second / "other.model.toml"), str(second / "sprint.ref"))
    assert f"no counterpart: {second / 'sprint.ref'}" in lines(result)


def test_what_cannot_be_compared_is_refused_in_one_line(plans: Path, tmp_path: Path) -> None:
    write_model(model(0.4, 0.1), tmp_path / "m.model.toml")
    (tmp_path / "empty").mkdir()
    (tmp_path / "x.txt").write_text("x")
    (tmp_path / "bad.ref").write_bytes(b"no reference")
    (tmp_path / "bad.model.toml").write_text("kind = 'trimtab-model'\n")
    space = open_workspace(tmp_path)
    for a, b, words in (
        ("m.model.toml", DATA / "a1.mcap", "has models, .* has logs; .*`trimtab predict`"),
        ("m.model.toml", DATA, "has models, .* has logs"),
        ("m.model.toml", "missing", "missing: no such file or folder"),
        ("m.model.toml", "empty", "empty: holds no log, model or plan"),
        ("x.txt", "m.model.toml", r"x\.txt: cannot be compared"),
        ("bad.ref", plans / "slow.ref", r"bad\.ref: not a reference"),
        ("bad.model.toml", "m.model.toml", r"bad\.model\.toml"),
    ):
        with pytest.raises(TrimtabError, match=words) as refusal:
            compare(tmp_path / a, tmp_path / b, space)
        assert refusal.value.exit_code == 2
    with pytest.raises(LogError, match=r"no\.mcap"):
        compare(tmp_path / "no.mcap", DATA / "a1.mcap", space)
