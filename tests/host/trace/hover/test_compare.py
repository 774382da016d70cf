"""Comparisons of hovers at motor level: what changed, what else it may be, nothing where nothing changed.

The vehicle is flown by the simulator. Its logs keep poses and sampled motor commands, and no gyro.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from tests.host.trace import test_thin
from tests.host.trace.test_thin import sampled
from trimtab.host import cli
from trimtab.host.effects import load_effects
from trimtab.host.imports.formats import read
from trimtab.host.imports.write import write
from trimtab.host.log import Flight, read_flight, write_imported
from trimtab.host.models.file import read_model
from trimtab.host.trace.decision.findings import LogsRefused
from trimtab.host.trace.hover.compare import at_first_start, compares_hovers
from trimtab.host.trace.result import Trace
from trimtab.host.trace.run import run
from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.studies.files import read_json

CRAZYPAD = Path(__file__).parents[5] / "shared" / "data" / "crazypad"
UNEVEN = {"torque-bias": {"x": 2.0, "y": 0.0, "z": -1.0}}
"""What the vehicle file lacks before and after: no change of it."""


def lost(rotor: int, share: float) -> dict[str, dict[str, float]]:
    return {"rotor-loss": {f"loss_{k}": share if k == rotor else 0.0 for k in (1, 2, 3, 4)}}


def hovered(folder: Path, effects: dict[str, dict[str, float]], seed: int) -> Flight:
    world = "".join(
        f"[effects.{name}]\n" + "".join(f"{key} = {value}\n" for key, value in values.items())
        for name, values in effects.items()
    )
    return sampled(test_thin.hovered(folder, world, seed, tolerances=False), gyro=False)


@pytest.fixture(scope="module")
def before(tmp_path_factory: pytest.TempPathFactory) -> list[Flight]:
    folder = tmp_path_factory.mktemp("before")
    return [hovered(folder, UNEVEN, seed) for seed in (1, 2, 3)]


def compared(before: list[Flight], after: list[Flight], held_out: Sequence[Flight] = ()) -> Trace:
    assert compares_hovers([*before, *after])
    result = run(after, held_out, load_effects(), baseline=before)
    assert result.baseline is not None
    assert result.baseline.logs == tuple(flight.path.name for flight in before)
    return result


def explanations(result: Trace) -> set[str]:
    return {name for effect in result.effects for name in (effect.name, *effect.aliases)}


def test_nothing_is_named_where_nothing_changed(tmp_path: Path, before: list[Flight]) -> None:
    result = compared(before, [hovered(tmp_path, UNEVEN, 11)])
    assert result.verdict == "nothing-missing"
    assert not result.effects


def test_a_shifted_centre_of_mass_is_traced_with_its_size(tmp_path: Path, before: list[Flight]) -> None:
    shifted = {"com-offset": {"x": 0.006, "y": -0.003}}
    result = compared(before, [hovered(tmp_path, UNEVEN | shifted, 11)])
    assert result.verdict == "traced"
    (effect,) = result.effects
    assert effect.name == "com-offset"
    for key, true in shifted["com-offset"].items():
        assert abs(effect.parameters[key].value - true) < 2.0 * effect.parameters[key].sd < 0.001
    assert result.model.effects.keys() == {"com-offset"}


@pytest.mark.parametrize("rotor", [2, 3])
def test_a_weak_rotor_is_found_with_its_size_and_the_attached_mass_that_looks_like_it(
    tmp_path: Path, before: list[Flight], rotor: int
) -> None:
    result = compared(before, [hovered(tmp_path, UNEVEN | lost(rotor, 0.12), 11)])
    assert result.verdict == "undecided"
    (effect,) = result.effects
    loss = effect.parameters[f"loss_{rotor}"]
    assert abs(loss.value - 0.12) < 2.0 * loss.sd < 0.04
    assert explanations(result) == {"rotor-loss", "com-offset", "mass"}
    assert [*effect.aliases] == ["com-offset", "mass"]  # most probable first, then by name
    assert effect.probability <= 0.5


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"mass": {"factor": 1.12}}, {"mass"}),
        ({"slung-payload": {"ratio": 0.1, "length_m": 0.6, "damping": 0.05}}, {"slung-payload"}),
        ({"mass": {"factor": 1.08}, "com-offset": {"x": 0.006, "y": 0.006}}, {"mass", "com-offset"}),
    ],
)
def test_a_load_is_among_the_explanations_and_nothing_is_certain(
    tmp_path: Path, before: list[Flight], change: dict[str, dict[str, float]], names: set[str]
) -> None:
    result = compared(before, [hovered(tmp_path, UNEVEN | change, 11)])
    assert result.verdict == "undecided"
    assert names <= explanations(result)
    assert all(effect.probability <= 0.5 for effect in result.effects)


def test_thrust_that_differs_from_log_to_log_before_hides_a_mass_after(
    tmp_path: Path, before: list[Flight]
) -> None:
    after = hovered(tmp_path, UNEVEN | {"mass": {"factor": 1.08}}, 11)
    assert explanations(compared(before, [after])) >= {"mass"}

    def weaker(flight: Flight, factor: float) -> Flight:
        inputs = flight.recorded_inputs
        assert inputs is not None
        assert inputs.motor is not None
        return replace(flight, recorded_inputs=replace(inputs, motor=factor * inputs.motor))

    scattered = [weaker(flight, factor) for flight, factor in zip(before, (0.94, 1.0, 1.06), strict=True)]
    assert compared(scattered, [after]).verdict == "nothing-missing"


def test_the_same_logs_give_the_same_numbers(tmp_path: Path, before: list[Flight]) -> None:
    after = [hovered(tmp_path, UNEVEN | lost(1, 0.2), 11)]
    one, two = (compared(before, after).to_dict() for _ in range(2))
    assert one == two


def test_command_writes_report_model_and_answer(
    tmp_path: Path, before: list[Flight], monkeypatch: pytest.MonkeyPatch
) -> None:
    def imported(flight: Flight, name: str) -> str:
        assert flight.mocap is not None
        path = tmp_path / f"{name}.mcap"
        write_imported(
            path,
            vehicle=flight.vehicle,
            mocap=flight.mocap,
            inputs=flight.recorded_inputs,
            tracking_us=flight.tracking,
            session={"from": name},
        )
        return str(path)

    monkeypatch.chdir(tmp_path)
    logs = [imported(flight, f"before{k}") for k, flight in enumerate(before)]
    changed = {"com-offset": {"x": 0.006, "y": -0.003}}
    after = imported(hovered(tmp_path, UNEVEN | changed, 11), "after")
    assert cli.main(["trace", after, "--baseline", *logs, "-o", "out"]) == 0
    answer = read_json(tmp_path / "out" / "trace.json")
    assert answer["baseline"]["logs"] == [Path(log).name for log in logs]
    assert [effect["name"] for effect in answer["effects"]] == ["com-offset"]
    model = read_model(tmp_path / "out" / "trace.model.toml")
    assert model.effects.keys() == {"com-offset"}
    assert model.region is not None
    assert 0.0 < model.region.thrust_min_n < model.region.thrust_max_n
    assert "Since the baseline flights this changed" in (tmp_path / "out" / "trace.html").read_text()


def test_no_flight_is_predicted(tmp_path: Path, before: list[Flight]) -> None:
    with pytest.raises(LogsRefused, match=r"1\.mcap: .* leave out --hold-out"):
        compared(before[1:], [hovered(tmp_path, UNEVEN, 11)], [replace(before[0], reference_id=None)])


def test_a_log_that_hardly_flies_is_refused(before: list[Flight]) -> None:
    first = before[0]
    assert first.tracking is not None
    short = replace(first, tracking=(first.tracking[0], first.tracking[0] + 3_000_000))
    with pytest.raises(LogsRefused, match=r"1\.mcap: .* in the air .* fly longer"):
        compared(before[1:], [short])


def test_logs_with_a_gyro_are_not_compared_by_hover(before: list[Flight]) -> None:
    first = before[0]
    assert first.recorded_imu is None
    assert not compares_hovers([*before[1:], replace(first, recorded_inputs=None)])


@pytest.mark.full
@pytest.mark.parametrize(
    ("folder", "logs", "cause"),
    [
        ("add_weight_W3_near_M3", ("E9_log00", "E9_log02"), {"mass", "com-offset"}),
        ("cut_propeller_M3_3mm", ("E9_log00", "E9_log01"), {"rotor-loss"}),
        ("normal_flight", ("E9_log00", "E9_log01", "E9_log02"), set()),
    ],
)
def test_labelled_flights_of_others(
    tmp_path: Path, require: Callable[[str], None], folder: str, logs: tuple[str, ...], cause: set[str]
) -> None:
    """Tape on a propeller, and a weight on a string that lies on the floor, stay below what is named."""
    require("flights")
    vehicle = load_vehicle("nano")

    def brought(folder: str, name: str) -> Flight:
        path = tmp_path / f"{folder}-{name}.mcap"
        write(read("crazyflie-usd", CRAZYPAD / folder / name), vehicle, path, format="crazyflie-usd")
        return read_flight(path)

    normal = {name: brought("normal_flight", name) for name in ("E9_log00", "E9_log01", "E9_log02")}
    for name in logs:
        after = brought(folder, name) if cause else normal[name]
        result = compared([flight for other, flight in normal.items() if cause or other != name], [after])
        assert result.verdict == ("undecided" if cause else "nothing-missing")
        assert cause <= explanations(result)
        if cause:
            assert [*result.effects[0].parameters] == ["loss_3"]


def test_payload_of_a_hover_hangs_free_and_other_effects_stay_as_they_are() -> None:
    effects = load_effects()
    payload = at_first_start(effects["slung-payload"])
    ratio, length, damping, *form = payload.parameters
    assert (ratio.neutral, length.neutral, damping.neutral) == (0.0, 0.25, 0.05)
    assert [p.neutral for p in form] == [p.neutral for p in effects["slung-payload"].parameters[3:]]
    for name in ("dead-zone", "ground-effect"):  # starts without states, and neither
        assert at_first_start(effects[name]) is effects[name]
