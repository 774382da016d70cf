"""Facts about one effect are only in its file, and an effect of a workspace may state all that a shipped one
does.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import pytest
from generators.effects import page

from trimtab.host.apps.demo.compare import latency_of
from trimtab.host.effects import Effect, EffectError, ExactAlias, Parameter, load_effects, number
from trimtab.host.effects.effect import Family, Signal
from trimtab.host.effects.parameter import NumberOptions
from trimtab.host.effects.unknowns import POSE_LATENCY, THRUST, UNKNOWN
from trimtab.host.log import Battery, Mocap, RecordedImu, read_flight, write_imported
from trimtab.host.log.one_flight import Flight
from trimtab.host.models.model import Model
from trimtab.host.trace import words
from trimtab.host.trace.data.signals import departure, has_signals
from trimtab.host.trace.decision.exact_aliases import ObservedAlias, exact_aliases
from trimtab.host.trace.flight_fit.fit import loop_discrepancy
from trimtab.host.trace.next_flight.manoeuvres import Manoeuvre
from trimtab.host.trace.next_flight.separation import propose
from trimtab.host.trace.parameters import Column, ParameterSpace, space
from trimtab.host.trace.run import run
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.trace.selection import Diagnosis
from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.studies.scoring.metrics import FAMILIES
from trimtab.sitl.studies.scoring.names import collapsed

ROOT = Path(__file__).parents[3]
DATA = ROOT / "tests" / "data"
VEHICLE = load_vehicle("research")
SHIPPED = load_effects()

GENERAL = (
    *(ROOT / "host" / "trace").rglob("*.py"),
    *(ROOT / "host").rglob("compare.py"),
    *(ROOT / "sitl" / "studies" / "scoring").rglob("*.py"),
)
"""Sources that must not depend on any particular effect."""

OWN = {
    "thrust_share": """
from trimtab.host.effects import Closing, Effect, ExactAlias, number

EFFECT = Effect(
    name="thrust-share",
    equation="T_i = share T_i,nominal",
    source="a test",
    parameters=(number("share", "1", 1.0, 0.08, 0.01, 0.4, 2.0, "thrust over nominal thrust"),),
    closing=Closing(model="thrust times a constant", planner="nothing", law=None),
    family="aerodynamic",
    aliases=("ballast", "pose-age"),
    exact_aliases=(
        ExactAlias(effect="ballast", ratio="push over weight", remedy="put the vehicle on a scale"),
    ),
    replaced_by=("thrust",),
    thrust_factor=lambda ops, theta, ctx: theta[0],
)
""",
    "ballast": """
from trimtab.host.effects import Closing, Effect, number

EFFECT = Effect(
    name="ballast",
    equation="m = factor m_nominal",
    source="a test",
    parameters=(
        number("factor", "1", 1.0, 0.08, 0.01, 0.4, 2.5, "mass over nominal mass", measured_below=0.004),
    ),
    closing=Closing(model="mass times a constant", planner="nothing", law=None),
    aliases=("thrust-share",),
    adjustment=True,
    mass_factor=lambda ops, theta: theta[0],
)
""",
    "pose_age": """
from trimtab.host.effects import Closing, Effect, number

EFFECT = Effect(
    name="pose-age",
    equation="pose(t) = true pose(t - age_s)",
    source="a test",
    parameters=(
        number("age_s", "s", 0.0, 0.015, 0.0005, 0.0, 0.08, "age of a pose", discrepancy=0.3,
               loop_discrepancy=0.07, free_sigma=0.03, free_lower=-0.05, free_upper=0.06),
    ),
    closing=Closing(model="poses are late", planner="nothing", law=None),
    aliases=("thrust-share", "motor-lag"),
    separated_by={"motor-lag": "film a lamp and its switch"},
    needs_signals={"gyro": 0.2},
    replaced_by=("thrust",),
    freed_by=("pose-latency",),
    mocap_latency_s=lambda ops, theta: theta[0],
)
""",
}


@pytest.fixture(scope="module")
def effects(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Effect]:
    """Return the shipped effects and those of a workspace with the files OWN."""
    folder = tmp_path_factory.mktemp("workspace") / "effects"
    folder.mkdir()
    for stem, text in OWN.items():
        (folder / f"{stem}.py").write_text(text, encoding="utf-8")
    return load_effects(folder.parent)


def named_in(source: str) -> Iterator[tuple[int, str]]:
    """Yield (line, text) of every string, except docstrings, that names an effect or its parameter."""
    tree = ast.parse(source)
    docstrings = {node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in docstrings:
            name, _, key = node.value.partition(".")
            if name in SHIPPED and (not key or key in SHIPPED[name].keys):
                yield node.lineno, node.value


def test_general_sources_name_no_effect() -> None:
    assert {"parameters.py", "fit.py", "run.py", "separation.py", "compare.py", "names.py"} <= {
        path.name for path in GENERAL
    }
    named = [
        f"{path.relative_to(ROOT)}:{line} {text}"
        for path in GENERAL
        for line, text in named_in(path.read_text("utf-8"))
    ]
    assert named == []


def test_templates_of_reports_name_no_effect() -> None:
    quoted = re.compile(rf"[\"']({'|'.join(map(re.escape, SHIPPED))})[\"'.]")
    templates = sorted((ROOT / "host" / "report").glob("*.j2"))
    assert templates
    assert [path.name for path in templates if quoted.search(path.read_text("utf-8"))] == []


@pytest.mark.parametrize(
    ("source", "names"),
    [
        ('NAMES = ("wind", "x")', ["wind"]),
        ('"""wind"""\nx = 1\n"""mass"""', []),
        ('table["mass.factor"]', ["mass.factor"]),
        ('f"{x}mass{y}"', ["mass"]),
        ('say("the mass", "mass.of", "thrust")', []),
    ],
)
def test_effect_names_in_a_source_are_found(source: str, names: list[str]) -> None:
    assert [text for _, text in named_in(source)] == names


def column(parameter_space: ParameterSpace, owner: str) -> Column:
    return parameter_space.columns[parameter_space.owners[owner][0]]


def test_workspace_effect_without_optional_facts_has_the_defaults(effects: dict[str, Effect]) -> None:
    parameter_space = space(VEHICLE, effects)
    usual, shipped = column(parameter_space, "thrust-share"), column(parameter_space, "thrust-gain")
    assert (usual.discrepancy, usual.loop_discrepancy) == (shipped.discrepancy, shipped.loop_discrepancy)
    assert usual.discrepancy == 0.05
    assert usual.loop_discrepancy == 0.01
    assert {"thrust-share", "pose-age"} <= set(parameter_space.candidates)


def test_workspace_effect_discrepancies_widen_the_spike(effects: dict[str, Effect]) -> None:
    parameter_space = space(VEHICLE, effects)
    (index,) = parameter_space.owners["pose-age"]
    assert parameter_space.prior.spike[index] == pytest.approx(np.hypot(0.0005 / 0.015, 0.3))
    assert loop_discrepancy(parameter_space)[index] == 0.07
    (shipped,) = parameter_space.owners["motor-lag"]
    assert loop_discrepancy(parameter_space)[shipped] == 0.05


def test_workspace_adjustment_is_in_every_model_and_no_candidate(effects: dict[str, Effect]) -> None:
    for unknown in ((), *((word,) for word in UNKNOWN)):
        parameter_space = space(VEHICLE, effects, unknown)
        for name in ("ballast", "mass"):
            assert name in parameter_space.groups
            assert name not in parameter_space.candidates


def test_workspace_effect_is_replaced_and_freed_by_unknowns(effects: dict[str, Effect]) -> None:
    replaced = space(VEHICLE, effects, [THRUST])
    assert not {"thrust-share", "pose-age", "thrust-gain"} & set(replaced.owners)
    for unknown in ([POSE_LATENCY], [THRUST, POSE_LATENCY]):
        free = space(VEHICLE, effects, unknown)
        assert {"pose-age", "mocap-latency"} <= set(free.freed)
        assert not {"pose-age", "mocap-latency"} & set(free.candidates)
        own, shipped = column(free, "pose-age"), column(free, "mocap-latency")
        assert (own.tolerance, own.lower, own.upper) == (0.03, -0.05, 0.06)
        assert (shipped.tolerance, shipped.lower, shipped.upper) == (0.02, -0.08, 0.08)
    assert column(space(VEHICLE, effects), "pose-age").lower == 0.0


def test_freed_effect_without_free_values_has_typical_size_and_its_bounds(
    effects: dict[str, Effect],
) -> None:
    plain = replace(effects["thrust-share"], replaced_by=(), freed_by=("thrust-curve",))
    freed = column(space(VEHICLE, {**effects, plain.name: plain}, ["thrust-curve"]), plain.name)
    assert (freed.tolerance, freed.lower, freed.upper) == (0.08, 0.4, 2.0)


def log(path: Path, *, gyro: float | None = None, sag: float = 0.0) -> Flight:
    """Return a log at rest, with a peak of the gyro and a drop of the battery voltage by a share."""
    t_us = np.arange(0, 6_000_000, 10_000)
    p, q = np.zeros((len(t_us), 3)), np.tile([1.0, 0.0, 0.0, 0.0], (len(t_us), 1))
    rate = np.zeros((len(t_us), 3))
    rate[300, 1] = -(gyro or 0.0)
    write_imported(
        path,
        vehicle=VEHICLE,
        mocap=Mocap(t_us=t_us, t_arrival_us=t_us, p=p, q=q),
        imu=None if gyro is None else RecordedImu(t_us=t_us, gyro=rate, specific_force=None),
        battery=Battery(t_us=t_us, battery_v=VEHICLE.battery.full_v * np.linspace(1.0, 1.0 - sag, len(t_us))),
        session={"from": path.stem},
    )
    return read_flight(path)


def test_effect_is_left_out_if_its_signals_are_at_rest(tmp_path: Path, effects: dict[str, Effect]) -> None:
    bare = log(tmp_path / "bare.mcap")
    still = log(tmp_path / "still.mcap", gyro=0.1, sag=0.05)
    turning = log(tmp_path / "turning.mcap", gyro=0.4)
    own, shipped = effects["pose-age"], effects["battery-sag"]
    assert [has_signals(own, flights) for flights in ([bare], [bare, still], [bare, turning])] == [
        False,
        False,
        True,
    ]
    assert [has_signals(shipped, flights) for flights in ([bare, turning], [still])] == [False, True]
    noisy = replace(shipped, needs_signals={}, noise_dependent=True)
    assert has_signals(replace(noisy, noise_dependent=False), [bare])
    assert not has_signals(noisy, [bare, still, turning])  # none holds control telemetry
    # Without recorded inputs the thrust is unknown, which would replace the effect.
    known = {name: effects[name] for name in ("linear-drag", "mass")}
    known["pose-age"] = replace(own, replaced_by=())
    assert "pose-age" not in run([bare], [], known).space.effects
    assert "pose-age" in run([turning], [], known).space.effects


def test_every_signal_of_a_real_flight_deviates_from_rest() -> None:
    flight = read_flight(DATA / "a1.mcap")
    assert flight.control is not None
    assert departure(flight, "gyro") == np.abs(flight.control.gyro_mean).max()
    assert {signal: departure(flight, signal) > 0.0 for signal in get_args(Signal)} == {
        "voltage_ratio": True,
        "gyro": True,
    }


def fitted(parameter_space: ParameterSpace, over: str, under: str) -> tuple[np.ndarray, np.ndarray]:
    """Return theta_scaled and covariance with the first at 0.9 +- 0.02 and the second at 1.2 +- 0.03."""
    i, k = parameter_space.owners[over][0], parameter_space.owners[under][0]
    z, covariance = np.zeros(len(parameter_space.columns)), np.eye(len(parameter_space.columns))
    z[i], z[k] = -0.1 / parameter_space.scale[i], 0.2 / parameter_space.scale[k]
    covariance[i, i], covariance[k, k] = (
        (0.02 / parameter_space.scale[i]) ** 2,
        (0.03 / parameter_space.scale[k]) ** 2,
    )
    covariance[i, k] = covariance[k, i] = 0.0004 / parameter_space.scale[i] / parameter_space.scale[k]
    return z, covariance


def sentences_of(observed: dict[str, ObservedAlias]) -> dict[str, str]:
    """Return the sentences on exact aliases, by the name of the other effect."""
    return {name: words.exact_alias(each) for name, each in observed.items()}


@pytest.mark.parametrize(
    ("name", "other", "shows", "remedy"),
    [
        ("thrust-share", "ballast", "push over weight", "put the vehicle on a scale"),
        ("thrust-gain", "mass", "thrust over mass", "weigh the vehicle to distinguish mass from thrust"),
    ],
)
def test_exact_alias_with_a_ratio_is_worded_by_ratio_and_remedy(
    effects: dict[str, Effect], name: str, other: str, shows: str, remedy: str
) -> None:
    unweighed = {**VEHICLE.tolerances, "mass.factor": 0.01}
    parameter_space = space(VEHICLE.replace(tolerances=unweighed), effects)
    z, covariance = fitted(parameter_space, name, other)
    # Relative variances add, less twice the relative covariance: 0.75 (0.02^2/0.9^2 + ...)^0.5.
    sd = 0.75 * ((0.02 / 0.9) ** 2 + (0.03 / 1.2) ** 2 - 2.0 * 0.0004 / (0.9 * 1.2)) ** 0.5
    message = f"flights show only {shows}: 0.7500 +- {2 * sd:.4f} times the nominal ratio; {remedy}"
    assert sentences_of(exact_aliases(parameter_space, z, covariance, name)) == {other: message}
    assert sentences_of(exact_aliases(parameter_space, z, covariance, other)) == {name: message}
    assert exact_aliases(parameter_space, z, covariance, "wind") == {}


@pytest.mark.parametrize(("key", "line"), [("ballast.factor", 0.004), ("mass.factor", 0.005)])
def test_exact_alias_that_was_measured_is_left_out(effects: dict[str, Effect], key: str, line: float) -> None:
    name = {"ballast.factor": "thrust-share", "mass.factor": "thrust-gain"}[key]
    for tolerance, count in ((0.99 * line, 0), (line, 1)):
        vehicle = VEHICLE.replace(tolerances={**VEHICLE.tolerances, key: tolerance})
        parameter_space = space(vehicle, effects)
        z, eye = np.zeros(len(parameter_space.columns)), np.eye(len(parameter_space.columns))
        assert len(exact_aliases(parameter_space, z, eye, name)) == count


def test_exact_alias_without_a_ratio_is_worded_by_its_remedy(effects: dict[str, Effect]) -> None:
    alias = ExactAlias(effect="ballast", remedy="put the vehicle on a scale")
    plain = replace(effects["thrust-share"], exact_aliases=(alias,))
    parameter_space = space(VEHICLE, {**effects, plain.name: plain})
    z, eye = np.zeros(len(parameter_space.columns)), np.eye(len(parameter_space.columns))
    assert sentences_of(exact_aliases(parameter_space, z, eye, plain.name)) == {
        "ballast": "no flight can distinguish thrust-share from ballast; put the vehicle on a scale"
    }


def test_trace_names_a_workspace_effect_with_its_exact_alias(effects: dict[str, Effect]) -> None:
    """The shipped flights hold a thrust gain."""
    known = {name: effects[name] for name in ("thrust-share", "ballast", "linear-drag")}
    result = run([read_flight(DATA / "a1.mcap")], [], known)
    (named,) = result.effects
    assert named.name == "thrust-share"
    assert set(named.exact_aliases) == set(named.aliases) == {"ballast"}
    (line,) = (line for line in words.result_lines(result) if "push over weight" in line)
    assert line.endswith("; put the vehicle on a scale")
    assert not any("or ballast" in line for line in words.result_lines(result))
    assert "ballast" in result.model.adjustments


def test_separating_measurement_may_be_stated_by_either_effect(
    effects: dict[str, Effect],
) -> None:
    data = read_flight(DATA / "a1.mcap")
    known = {name: effects[name] for name in ("motor-lag", "pose-age", "wind", "frame-tilt", "linear-drag")}
    result = run([data], [], known)
    assert isinstance(result.diagnosis, Diagnosis)
    selected = result.diagnosis.selected
    form = SegmentModel(data.vehicle, result.space, dt_s=0.02, in_newton=False, rate_driven=False)
    t_s = np.arange(0.0, 6.0, 0.02)
    flat = np.zeros((14, len(t_s)))
    flat[2] = -1.5
    hover = Manoeuvre(route="hover", total_time_s=6.0, slowed=False, flat=flat)
    proposals = {
        pair: propose(form, selected, *pair, [hover])
        for pair in (("motor-lag", "pose-age"), ("frame-tilt", "wind"), ("linear-drag", "wind"))
    }
    assert {pair: flight and flight.known_measurement for pair, flight in proposals.items()} == {
        ("motor-lag", "pose-age"): "film a lamp and its switch",
        ("frame-tilt", "wind"): "fly again without wind, or level the camera system",
        ("linear-drag", "wind"): None,
    }


def test_pose_latency_counts_from_any_effect(effects: dict[str, Effect]) -> None:
    tables = {"pose-age": {"age_s": 0.011}, "thrust-share": {"share": 0.9}}
    model = Model(vehicle_id="v", vehicle_name="n", effects=tables)
    trace: Any = SimpleNamespace(model=model, space=SimpleNamespace(effects=effects))
    assert latency_of(trace) == 0.011


def test_studies_count_exact_aliases_of_a_workspace_as_one(effects: dict[str, Effect]) -> None:
    assert collapsed(["thrust-share"], ["ballast"], effects) == {"push-over-weight"}
    relative = replace(effects["pose-age"], observed_relative_to="thrust-share")
    known = {**effects, relative.name: relative}
    assert collapsed(["thrust-share", "pose-age"], ["ballast"], known) == {"push-over-weight"}
    assert collapsed(["thrust-share", "pose-age"], ["ballast"], effects) == {"push-over-weight", "pose-age"}
    assert set(FAMILIES) == set(get_args(Family))


def test_effects_page_lists_the_facts_of_workspace_effects(effects: dict[str, Effect]) -> None:
    text = page(effects)
    for line in (
        '- Exactly like ballast unless the vehicle file gives `"ballast.factor"` below 0.004: only push over '
        "weight shows; put the vehicle on a scale.",
        "- If no flight separates it from motor-lag: film a lamp and its switch.",
        "- Left out if `gyro` departs from rest by 0.2 or less in every flight.",
        "- Replaced by an unknown `thrust`.",
        "- Free with an unknown `pose-latency`: `age_s` with sigma 0.03, -0.05 to 0.06.",
        "- An adjustment: never named by itself.",
    ):
        assert line in text.splitlines()


def test_number_with_positional_arguments_is_the_same_parameter() -> None:
    assert number("k", "1", 0.0, 1.0, 0.1, -5.0, 5.0, "d") == Parameter(
        key="k", unit="1", neutral=0.0, typical=1.0, tolerance=0.1, lower=-5.0, upper=5.0, description="d"
    )


@pytest.mark.parametrize(
    "facts",
    [
        {"discrepancy": -0.1},
        {"discrepancy": np.nan},
        {"loop_discrepancy": np.inf},
        {"free_sigma": 0.0},
        {"measured_below": -1.0},
        {"free_lower": 0.5},
        {"free_upper": -0.5},
        {"free_lower": -np.inf},
    ],
)
def test_parameter_with_an_invalid_field_raises_with_its_name(facts: NumberOptions) -> None:
    (field,) = facts
    with pytest.raises(ValueError, match=rf"parameter k: .*{field}"):
        number("k", "1", 0.0, 1.0, 0.1, -5.0, 5.0, "d", **facts)


@pytest.mark.parametrize(
    ("name", "facts", "message"),
    [
        ("thrust-share", {"family": "magic"}, "family 'magic'"),
        ("thrust-share", {"replaced_by": ("weather",)}, "replaced_by .*weather"),
        ("thrust-share", {"freed_by": "torque"}, "freed_by must be a tuple"),
        ("thrust-share", {"freed_by": ("thrust",)}, "'thrust'. in both replaced_by and freed_by"),
        ("thrust-share", {"aliases": ()}, "exact_aliases ballast"),
        ("pose-age", {"freed_by": ()}, "age_s.*freed_by"),
        ("pose-age", {"separated_by": {"wind": "wait"}}, "separated_by wind"),
        ("pose-age", {"observed_relative_to": "pose-age"}, "observed_relative_to"),
        ("pose-age", {"needs_signals": {"sonar": 1.0}}, "needs_signals 'sonar'"),
        ("pose-age", {"needs_signals": {"gyro": -1.0}}, "needs_signals gyro"),
        (
            "pose-age",
            {"exact_aliases": (ExactAlias(effect="motor-lag", remedy="r", ratio="a over b"),)},
            "exact_aliases motor-lag has a ratio",
        ),
    ],
)
def test_effect_with_an_invalid_field_raises_with_its_name(
    effects: dict[str, Effect], name: str, facts: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=f"effect {name}: .*{message}"):
        replace(effects[name], **facts)


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("thrust_share", '"ballast"', '"anchor"', "thrust-share: exact_aliases anchor, which is not defined"),
        (
            "thrust_share",
            '"ballast"',
            '"wind"',
            "thrust-share: exact_aliases wind has a ratio, but wx of wind is 0 at neutral",
        ),
        (
            "ballast",
            "adjustment=True",
            'observed_relative_to="anchor"',
            "ballast: observed_relative_to anchor, which is not defined",
        ),
    ],
)
def test_effect_that_refers_to_an_unknown_effect_raises(
    tmp_path: Path, file: str, old: str, new: str, message: str
) -> None:
    (tmp_path / "effects").mkdir()
    (tmp_path / "effects" / f"{file}.py").write_text(OWN[file].replace(old, new), encoding="utf-8")
    with pytest.raises(EffectError, match=message):
        load_effects(tmp_path)
