"""The common form of foreign logs, before they are written as flight logs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np

from trimtab.host.base.errors import TrimtabError
from trimtab.host.log import Rebuilt

Unknown = Literal[
    "thrust-curve", "motor-lag", "mounting-tilt", "frame-tilt", "inertia", "torque", "pose-latency"
]
"""Properties that a recording may not determine. Tracing estimates them as nuisance, not as effects."""

WORDS = {
    "pose_us": "poses",
    "p_ned": "position",
    "q_ned_frd": "attitude",
    "input_us": "inputs",
    "motor_command": "motor command",
    "thrust_n": "thrust",
    "torque_n_m": "torque",
    "imu_us": "inertial measurements",
    "gyro": "gyro",
    "specific_force": "specific force",
    "battery_us": "battery voltages",
    "battery_v": "battery voltage",
    "reference_us": "references",
    "p_ref_ned": "reference position",
    "v_ref_ned": "reference velocity",
    "a_ref_ned": "reference acceleration",
}
"""Names of the parts of a recording in messages."""


@dataclass(frozen=True, kw_only=True)
class Cut:
    """A part of a foreign log, us since its first row, that was left out, and the reason."""

    begin_us: int
    end_us: int
    reason: str


Corner = Literal["front-right", "rear-right", "rear-left", "front-left"]

LONGEST_S = 24 * 3600.0
LARGEST = 1e6
"""A greater SI value has a wrong unit or is damaged."""

READABLE = 1e30
"""Greater values in a file, in any unit, are refused, so that no conversion overflows."""

_COMMAND_SLACK = 1e-3


class ImportFormatError(TrimtabError, ValueError):
    """A foreign log does not have the expected format. Each line gives file, field and remedy."""

    exit_code = 5

    def __str__(self) -> str:
        return "\n".join(self.lines)

    @property
    def lines(self) -> tuple[str, ...]:
        """One line for each problem."""
        return self.args


class MissingFile(ImportFormatError):
    """A foreign log does not exist."""

    exit_code = 2


class TooShort(ImportFormatError):
    """A foreign log is valid but too short."""

    exit_code = 2


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """A foreign flight in world NED, body FRD and SI units, with times in us since its first row.

    Raises ImportFormatError, with the name of the file, for impossible values.

    Attributes
    ----------
    pose_us, p_ned, q_ned_frd
        Times, positions, and attitudes with w first.
    input_us, motor_command, thrust_n, torque_n_m
        Times, and motor commands in 0..1, or thrust with torque if it is known.
    motor_corners
        Corner of the motor in each column of `motor_command`; None for the order of the vehicle file.
    imu_us, gyro, specific_force
        Times and measurements.
    battery_us, battery_v
        Times and voltages.
    reference_us, p_ref_ned, v_ref_ned, a_ref_ned
        Times, positions and, if logged, velocities and accelerations.
    mass_kg
        Mass that the vehicle's controller used.
    epoch_us
        Time 0 on the source's own clock; Unix time if the source has that. None if it has no clock.
    unknown
        Properties that the recording does not determine.
    rebuilt
        Part of the attitude that the reader rebuilt; None if the attitude was measured.
    cut
        Parts that the reader left out.
    skipped_rows
        Number of rows that the reader left out, because a value was not finite.
    """

    source: str
    pose_us: Annotated[np.ndarray, "poses"]
    p_ned: Annotated[np.ndarray, "poses 3"]
    q_ned_frd: Annotated[np.ndarray, "poses 4"]
    unknown: tuple[Unknown, ...]
    input_us: Annotated[np.ndarray, "inputs"] | None = None
    motor_command: Annotated[np.ndarray, "inputs 4"] | None = None
    motor_corners: tuple[Corner, Corner, Corner, Corner] | None = None
    thrust_n: Annotated[np.ndarray, "inputs"] | None = None
    torque_n_m: Annotated[np.ndarray, "inputs 3"] | None = None
    imu_us: Annotated[np.ndarray, "samples"] | None = None
    gyro: Annotated[np.ndarray, "samples 3"] | None = None
    specific_force: Annotated[np.ndarray, "samples 3"] | None = None
    battery_us: Annotated[np.ndarray, "voltages"] | None = None
    battery_v: Annotated[np.ndarray, "voltages"] | None = None
    reference_us: Annotated[np.ndarray, "references"] | None = None
    p_ref_ned: Annotated[np.ndarray, "references 3"] | None = None
    v_ref_ned: Annotated[np.ndarray, "references 3"] | None = None
    a_ref_ned: Annotated[np.ndarray, "references 3"] | None = None
    mass_kg: float | None = None
    epoch_us: int | None = None
    rebuilt: Rebuilt | None = None
    cut: tuple[Cut, ...] = ()
    skipped_rows: int = 0

    def __post_init__(self) -> None:
        strange = sorted(set(self.unknown) - set(get_args(Unknown)))
        if strange:
            raise ValueError(f"unknown {strange} is not among {get_args(Unknown)}")
        for times, names in _TRACKS.items():
            self._check_track(times, names)
        if self.mass_kg is not None and not 0.0 < self.mass_kg < np.inf:
            raise ImportFormatError(
                f"{self.source}: mass {self.mass_kg!r} kg is impossible; correct the info file"
            )
        command = self.motor_command
        if command is not None and (command.min() < -_COMMAND_SLACK or command.max() > 1.0 + _COMMAND_SLACK):
            raise ImportFormatError(
                f"{self.source}: motor commands from {command.min():.4g} to {command.max():.4g} of full; "
                "give the values of zero and full command"
            )
        if command is not None and self.thrust_n is not None:
            raise ValueError("either motor commands or thrust, not both")

    def _check_track(self, times: str, names: tuple[str, ...]) -> None:
        t_us = getattr(self, times)
        arrays = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        if t_us is None:
            if arrays:
                raise ValueError(f"{', '.join(arrays)} without {times}")
            return
        if len(t_us) < 2 or (np.diff(t_us) <= 0).any():
            raise ImportFormatError(
                f"{self.source}: fewer than two different {WORDS[times]} at increasing times; "
                "check the columns of time, position and attitude"
            )
        for name, values in arrays.items():
            if len(values) != len(t_us):
                raise ValueError(f"{name} has {len(values)} rows, {times} {len(t_us)}")
            if not np.isfinite(values).all():
                row = int(np.argwhere(~np.isfinite(values.reshape(len(values), -1)))[0][0])
                raise ImportFormatError(
                    f"{self.source}: {WORDS[name]} is not finite at row {row}; remove or correct that row"
                )
            if np.abs(values).max() > LARGEST:
                raise ImportFormatError(
                    f"{self.source}: {WORDS[name]} reaches {np.abs(values).max():.3g}; is its unit right?"
                )


_TRACKS = {
    "pose_us": ("p_ned", "q_ned_frd"),
    "input_us": ("motor_command", "thrust_n", "torque_n_m"),
    "imu_us": ("gyro", "specific_force"),
    "battery_us": ("battery_v",),
    "reference_us": ("p_ref_ned", "v_ref_ned", "a_ref_ned"),
}


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Raise ImportFormatError instead of OSError if the file cannot be read."""
    try:
        yield
    except OSError as error:
        missing = isinstance(error, FileNotFoundError | NotADirectoryError)
        kind = MissingFile if missing else ImportFormatError
        raise kind(f"{path}: cannot be read ({error.strerror or error}); check the path") from None


def check_readable(path: Path) -> None:
    """Raise ImportFormatError if the file cannot be opened."""
    with reading(path):
        path.open("rb").close()


def corner_of(forward: float, right: float) -> Corner:
    """Return the corner of a quadrotor in X at which a rotor is, from its place in any unit."""
    if forward > 0.0:
        return "front-right" if right > 0.0 else "front-left"
    return "rear-right" if right > 0.0 else "rear-left"


def since_first_us(
    times: Annotated[np.ndarray, "samples"], unit_us: float, source: str
) -> Annotated[np.ndarray, "samples"]:
    """Return integer microseconds since the first of `times`, which are in units of `unit_us`.

    Raises ImportFormatError if they decrease or span more than a day, which indicates a wrong unit. Equal
    times are allowed; `first_of_equal` drops repetitions.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        elapsed_us = (times - times[0]) * unit_us
    if not (np.abs(elapsed_us) <= LONGEST_S * 1e6).all():
        raise ImportFormatError(f"{source}: lasts longer than a day; check the unit of its times")
    t_us = np.round(elapsed_us).astype(np.int64)
    back = np.flatnonzero(np.diff(t_us) < 0)
    if len(back):
        raise ImportFormatError(
            f"{source}: time decreases after row {back[0]}; cut the log at this row or sort its rows"
        )
    return t_us


def first_of_equal(t_us: Annotated[np.ndarray, "samples"]) -> Annotated[np.ndarray, "samples"]:
    """Return a mask of the first row of each time."""
    return np.r_[True, np.diff(t_us) > 0]


def fresh(*columns: Annotated[np.ndarray, "samples _"]) -> Annotated[np.ndarray, "samples"]:
    """Return a mask of the rows that differ from the previous row in any of the columns.

    A pose identical to the previous one was not measured again. The logger repeated it, and the time of its
    row is too late.
    """
    whole = np.column_stack(columns)
    return np.r_[True, (whole[1:] != whole[:-1]).any(axis=1)]
