"""What is tuned: parameters of controller files, the values to try, and the flights that score a point.

All values are factors on a start, which is fixed here. A repetition of the search therefore tries the same
points whatever the controller files hold.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

from trimtab.host.control.files import load_controller
from trimtab.host.control.settings import ControllerSettings
from trimtab.host.vehicle.strict_toml import validate

WORLD, WORLD_SEEDS = "paper-drag", (7001, 7002, 7003)
COURSES, PACES = ("pretzel", "random:11", "sprint"), (0.8, 1.0)
"""Routes, and the paces at which their times are flown."""
_NEAR = (0.7, 0.85, 1.0, 1.15, 1.3)
_OCTAVES = (0.25, 0.5, 1.0, 2.0, 4.0)
_BANDWIDTHS = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0)


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A setting of the controllers `files`: a key of `table`, or of the file itself if that is empty.

    factors: values to try, ascending, over the start. start: value at factor 1.
    """

    name: str
    files: tuple[str, ...]
    table: str
    key: str
    factors: tuple[float, ...]
    start: tuple[float, ...]

    def value(self, factor: float) -> tuple[float, ...]:
        """Return the setting's value at a factor, to six digits."""
        return tuple(float(f"{factor * each:.6g}") for each in self.start)


@dataclass(frozen=True, kw_only=True)
class Search:
    """Controllers that share parameters, which are searched in this order."""

    name: str
    files: tuple[str, ...]
    parameters: tuple[Parameter, ...]

    def of(self, controller: str) -> tuple[Parameter, ...]:
        """Return the parameters that a controller has."""
        return tuple(each for each in self.parameters if controller in each.files)


@dataclass(frozen=True, kw_only=True)
class Leg:
    """One flight of a point: route, pace and seed of the world."""

    course: str
    pace: float
    world_seed: int


def legs() -> tuple[Leg, ...]:
    """Return the flights of a point: every course at every pace, and every world twice."""
    return tuple(
        Leg(course=course, pace=pace, world_seed=WORLD_SEEDS[(i + k) % len(WORLD_SEEDS)])
        for (i, course), (k, pace) in product(enumerate(COURSES), enumerate(PACES))
    )


_DFBC, _MPC = ("dfbc", "dfbc-do"), ("mpc", "mpc-l1")
_OBSERVER = Parameter(
    name="observer",
    files=("dfbc-do",),
    table="",
    key="observer_bandwidth_1_s",
    factors=_BANDWIDTHS,
    start=(3.0,),
)


def _gain(name: str, key: str) -> Parameter:
    return Parameter(name=name, files=_DFBC, table="gain_factors", key=key, factors=_NEAR, start=(1.0,))


def _weight(name: str, key: str, start: tuple[float, float, float]) -> Parameter:
    return Parameter(name=name, files=_MPC, table="weights", key=key, factors=_OCTAVES, start=start)


FULL = (
    Search(
        name="dfbc",
        files=_DFBC,
        parameters=(_gain("position", "position_p"), _gain("velocity", "velocity_d"), _OBSERVER),
    ),
    Search(
        name="mpc",
        files=_MPC,
        parameters=(
            _weight("position", "position_1_m2", (400.0, 400.0, 600.0)),
            _weight("velocity", "velocity_s2_m2", (5.0, 5.0, 5.0)),
            _weight("attitude", "attitude_1_rad2", (5.0, 5.0, 20.0)),
            _weight("rate-command", "rate_command_s2_rad2", (0.3, 0.3, 0.3)),
            Parameter(
                name="l1",
                files=("mpc-l1",),
                table="adaptation",
                key="bandwidth_1_s",
                factors=_BANDWIDTHS,
                start=(8.0,),
            ),
        ),
    ),
)
QUICK = (
    Search(
        name="dfbc",
        files=("dfbc-do",),
        parameters=(
            Parameter(
                name="observer",
                files=("dfbc-do",),
                table="",
                key="observer_bandwidth_1_s",
                factors=(1.0, 1.5),
                start=(3.0,),
            ),
        ),
    ),
)
"""One controller, two values."""


def settings_at(
    controller: str, parameters: tuple[Parameter, ...], factors: Mapping[str, float]
) -> ControllerSettings:
    """Return the settings of a controller file with its parameters at these factors."""
    settings = load_controller(controller)
    data = settings.model_dump(mode="json", exclude={"tuned"}, exclude_none=True)
    for each in parameters:
        value = each.value(factors[each.name])
        table = data[each.table] if each.table else data
        table[each.key] = value[0] if len(value) == 1 else list(value)
    return validate(data, controller, type(settings))
