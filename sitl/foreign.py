"""Foreign plants: physics from a file outside this package, checked at every step.

`path.py:Class` is built as `Class(vehicle, options, seed)`: the vehicle file, a dict, and a number that
differs between flights. In a world, it is built with `world=` too, a `trimtab.sitl.draw.World`, and must act
out effects, deviations and turbulence of that world, except those of the camera system. It has the methods
`reset(p_ned, q_ned_frd)`, `step(motor_command, dt_us)` with four commands in 0..1 held over a whole number of
milliseconds, and `state()`, which returns p_ned, v_ned, q_ned_frd (w first), rate_frd, specific_force_frd and
battery_v without noise. The floor is at z_ned = 0; the plant must model contact itself.
"""

from __future__ import annotations

import inspect
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from trimtab.host.base import bounds
from trimtab.host.base.errors import TrimtabError
from trimtab.host.base.trust import read_code
from trimtab.host.vehicle import ConfigurationError, Vehicle
from trimtab.host.vehicle.strict_toml import parse_toml
from trimtab.protocol.telemetry import TICK_US
from trimtab.sitl.draw import World

_PARTS = (("p_ned", 3), ("v_ned", 3), ("q_ned_frd", 4), ("rate_frd", 3), ("specific_force_frd", 3))
_UNIT_TOLERANCE = 1e-3
_OWN = Path(__file__).resolve().parent


class ForeignPlantError(TrimtabError, RuntimeError):
    """A foreign plant cannot be loaded, raised an error or returned an impossible state."""

    exit_code = 2


class ForeignPlant:
    """Adapter of a foreign plant to the simulator's interface `trimtab.sitl.plant.PlantPort`.

    Every method raises ForeignPlantError if the plant raises an error or returns an unusable value.
    """

    def __init__(self, name: str, body: Any) -> None:
        self.name = name
        self._body = body
        self.pose = memoryview(bytearray(80)).cast("d")
        self.sensed = memoryview(bytearray(56)).cast("d")

    def reset(self, p_ned: Sequence[float], q_ned_frd: Sequence[float]) -> None:
        """Put the plant at rest at a pose."""
        self._guard("reset", tuple(p_ned), tuple(q_ned_frd))
        self._take()

    def step(self, motor_command: Sequence[float]) -> None:
        """Advance by one millisecond with the commands held."""
        self._guard("step", tuple(motor_command), TICK_US)
        self._take()

    def _guard(self, method: str, *arguments: Any) -> Any:
        try:
            return getattr(self._body, method)(*arguments)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # any error of a foreign plant, even SystemExit, ends the session
            raise ForeignPlantError(
                f"plant {self.name}: {method} raised {type(error).__name__}: {error}"
            ) from error

    def _take(self) -> None:
        state = self._guard("state")
        try:
            *parts, battery_v = state
            sizes = zip(parts, _PARTS, strict=True)
            numbers = [_vector(part, name, size) for part, (name, size) in sizes]
            battery_v = float(battery_v)
        except Exception as error:  # a user's object may raise anything
            expected = ", ".join(name for name, _ in _PARTS)
            raise ForeignPlantError(
                f"plant {self.name}: state must be {expected}, battery_v ({error})"
            ) from None
        for values, (name, _) in zip([*numbers, [battery_v]], [*_PARTS, ("battery_v", 1)], strict=True):
            if not all(map(math.isfinite, values)):
                raise ForeignPlantError(f"plant {self.name}: {name} is {values}, not finite")
        norm = math.sqrt(sum(c * c for c in numbers[2]))
        if abs(norm - 1.0) > _UNIT_TOLERANCE:
            raise ForeignPlantError(f"plant {self.name}: q_ned_frd has length {norm:.6g}, not 1")
        p, v, q, rate, force = numbers
        for i, value in enumerate((*p, *v, *q)):
            self.pose[i] = value
        for i, value in enumerate((*rate, *force, battery_v)):
            self.sensed[i] = value


def load_foreign_plant(
    spec: str,
    vehicle: Vehicle,
    options: Mapping[str, Any],
    seed: int,
    world: World | None = None,
    *,
    trusted: bool = False,
) -> ForeignPlant:
    """Return the plant `path.py:Class`, in a world if one is given.

    trusted: whether its code may run although others can change the file. Raises UntrustedError without that,
    and ForeignPlantError if the plant cannot be built, or takes no world although one is given.
    """
    file, _, class_name = spec.rpartition(":")
    path = Path(file)
    if not file or not class_name:
        raise ForeignPlantError(f"plant {spec}: give it as path.py:Class")
    if not path.is_file():
        raise ForeignPlantError(f"plant {spec}: no such file {file}")
    source = _source(path, trusted)
    module = ModuleType(f"trimtab_plant_{path.stem}")
    module.__file__ = str(path)
    name = f"{path.name}:{class_name}"
    sys.modules[module.__name__] = module  # dataclasses in the file look up their module here
    try:
        # The importing system would read the file again, or bytecode beside it.
        exec(compile(source, str(path), "exec"), vars(module))
        maker = getattr(module, class_name)
        if world is not None and "world" not in inspect.signature(maker).parameters:
            raise ForeignPlantError(
                f"plant {name} takes no world; leave out the world, or give the class an argument `world`"
            )
        body = maker(vehicle, dict(options), seed, **({} if world is None else {"world": world}))
    except (KeyboardInterrupt, ForeignPlantError):
        raise
    except BaseException as error:  # a user's file may raise anything, even SystemExit
        raise ForeignPlantError(f"plant {name}: cannot be built, {type(error).__name__}: {error}") from error
    missing = [method for method in ("reset", "step", "state") if not callable(getattr(body, method, None))]
    if missing:
        raise ForeignPlantError(f"plant {name}: has no {', '.join(missing)}")
    return ForeignPlant(name, body)


def _source(path: Path, trusted: bool) -> bytes:
    """Return the source in a plant's file. Raises ForeignPlantError or UntrustedError."""
    try:
        # The package's own plants are as trusted as this line.
        if path.resolve().is_relative_to(_OWN):
            return path.read_bytes()
        return read_code(path, trusted=trusted)
    except OSError as error:
        raise ForeignPlantError(
            f"plant {path}: cannot be read ({error.strerror or error}); check the file"
        ) from None


def read_plant_options(path: str | Path | None) -> dict[str, Any]:
    """Return the options in a `--plant-options` file; empty without a file. Raises ForeignPlantError."""
    if path is None:
        return {}
    try:
        return parse_toml(bounds.read_text(Path(path), bounds.TOML_BYTES), str(path))
    except ConfigurationError as error:
        raise ForeignPlantError(f"plant options {error}") from None
    except (OSError, ValueError) as error:
        raise ForeignPlantError(f"plant options {path}: {error}") from None


def _vector(part: Any, name: str, size: int) -> list[float]:
    numbers = [float(value) for value in part]
    if len(numbers) != size:
        raise ValueError(f"{name} has {len(numbers)} numbers, not {size}")
    return numbers
