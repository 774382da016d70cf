"""The registry finds effects by name and reports errors of effect files."""

from __future__ import annotations

from pathlib import Path

import pytest

from trimtab.host.effects import SLOTS, EffectError, load_effects

SHIPPED = {
    "linear-drag": ("dx", "dy", "dz"),
    "quadratic-drag": ("c",),
    "wind": ("wx", "wy"),
    "thrust-gain": ("gain",),
    "mass": ("factor",),
    "battery-sag": ("exponent",),
    "motor-lag": ("extra_s",),
    "com-offset": ("x", "y", "spread"),
    "mocap-latency": ("latency_s",),
    "actuation-delay": ("delay_s",),
    "frame-tilt": ("tilt_x", "tilt_y"),
    "ground-effect": ("k",),
    "gyroscopic": ("h",),
    "inertia": ("x", "y", "z"),
    "rotor-loss": ("loss_1", "loss_2", "loss_3", "loss_4"),
    "slung-payload": ("ratio", "length_m", "damping"),
    "thrust-inflow": ("k",),
    "dead-zone": ("width", "centre"),
    "uneven-lag": ("ratio",),
    "torque-bias": ("x", "y", "z"),
    "translational-lift": ("k",),
}
FORMS = {
    "battery-sag": ("load_share",),
    "ground-effect": ("fade",),
    "gyroscopic": ("spin_up",),
    "linear-drag": ("rotor_share", "height_m"),
    "quadratic-drag": ("side", "top"),
    "rotor-loss": ("rotor_share", "torque_ratio"),
    "slung-payload": ("tension_share",),
    "thrust-gain": ("rotor_share",),
    "thrust-inflow": ("saturation", "damping"),
    "torque-bias": ("thrust_share",),
    "translational-lift": ("rotor_share", "saturation"),
    "uneven-lag": ("fast_share",),
}
"""Keys of the form of the effect, which follow the others."""

WORKSPACE_EFFECT = """
from trimtab.host.effects import Closing, Effect, Parameter

EFFECT = Effect(
    name="{name}",
    title="t", equation="e", source="s", aliases=(),
    parameters=(Parameter(key="k", unit="1", neutral=0.0, typical=1.0, tolerance=0.1, lower=-5.0, upper=5.0,
                          description="d"),),
    closing=Closing(model="m", planner="p", law=None),
    torque_frd=lambda ops, theta, ctx: (theta[0], 0.0, 0.0),
)
"""


def write(workspace: Path, file: str, text: str) -> None:
    (workspace / "effects").mkdir(exist_ok=True)
    (workspace / "effects" / file).write_text(text, encoding="utf-8")


def test_load_effects_shipped_returns_all_effects_with_their_keys():
    effects = load_effects()
    assert {name: effect.keys for name, effect in effects.items()} == {
        name: (*keys, *FORMS.get(name, ())) for name, keys in SHIPPED.items()
    }
    assert list(effects) == sorted(effects)
    assert all(len(effect.source_id) == 12 for effect in effects.values())


def test_load_effects_aliases_are_mutual_where_shipped():
    effects = load_effects()
    for effect in effects.values():
        for alias in effect.aliases:
            if alias in effects:
                assert effect.name in effects[alias].aliases, (effect.name, alias)


def test_load_effects_workspace_adds_an_effect(tmp_path):
    write(tmp_path, "roll_push.py", WORKSPACE_EFFECT.format(name="roll-push"))
    effects = load_effects(tmp_path)
    assert effects["roll-push"].keys == ("k",)
    assert len(effects) == len(SHIPPED) + 1


def test_load_effects_workspace_changed_file_changes_source_id(tmp_path):
    write(tmp_path, "roll_push.py", WORKSPACE_EFFECT.format(name="roll-push"))
    before = load_effects(tmp_path)["roll-push"].source_id
    write(tmp_path, "roll_push.py", WORKSPACE_EFFECT.format(name="roll-push") + "# changed\n")
    assert load_effects(tmp_path)["roll-push"].source_id != before


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("broken.py", "EFFECT = (", r"effects/broken\.py: SyntaxError"),
        ("nothing.py", "x = 1\n", r"effects/nothing\.py: does not define EFFECT"),
        ("other.py", WORKSPACE_EFFECT.format(name="roll-push"), r"rename the file to roll_push\.py"),
        ("wind.py", WORKSPACE_EFFECT.format(name="wind"), r"wind is a shipped effect"),
        (
            "bad_name.py",
            WORKSPACE_EFFECT.format(name="Bad"),
            r"effects/bad_name\.py: ValueError: effect name",
        ),
    ],
)
def test_load_effects_bad_workspace_file_is_named(tmp_path, file, text, message):
    write(tmp_path, file, text)
    with pytest.raises(EffectError, match=message) as error:
        load_effects(tmp_path)
    assert error.value.exit_code == 2


@pytest.mark.parametrize(
    ("slots", "message"),
    [
        (
            "added_inertia_kg_m2=lambda ops, theta, mass: (theta[0], 0.0, 0.0)",
            "added_inertia_kg_m2 returns 3 numbers; it must return 4",
        ),
        (
            "mass_factor=lambda ops, theta: (1.0, theta[0])",
            r"mass_factor fails at neutral values with TypeError: .*",
        ),
        (
            "wind_ned=lambda ops, theta: theta[0]",
            r"wind_ned fails at neutral values with TypeError: .*",
        ),
        (
            "gravity_ned=lambda ops, theta: (0.0, 0.0, float('nan') if theta[0] else 0.0)",
            r"gravity_ned returns \[0.0, 0.0, nan\] at typical values; bound what it computes",
        ),
        (
            "rotor_factors=lambda ops, theta: (1.0,) * 4",
            r"rotor_factors fails at neutral values with TypeError: .*",
        ),
        (
            "memory=2, memory_start=lambda ops, theta, ctx: (0.0, 0.0), "
            "memory_rates=lambda ops, theta, ctx: ctx.memory[:1]",
            "memory_rates returns 1 numbers; it must return 2",
        ),
    ],
)
def test_load_effects_refuses_a_file_whose_slots_return_wrong_numbers(
    tmp_path: Path, slots: str, message: str
) -> None:
    text = WORKSPACE_EFFECT.format(name="roll-push").replace(
        "    torque_frd=", f"    {slots},\n    torque_frd="
    )
    write(tmp_path, "roll_push.py", text)
    with pytest.raises(EffectError, match=rf"^effects/roll_push\.py: {message}$"):
        load_effects(tmp_path)


def test_effects_fill_at_least_one_slot_and_state_their_source():
    for effect in load_effects().values():
        assert any(getattr(effect, slot) is not None for slot in SLOTS)
        assert effect.source
        assert effect.equation
        assert effect.closing.model
        assert effect.closing.planner
