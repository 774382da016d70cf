"""Faults planted in imports of flights, simulated and real: none comes in silently, and each is named."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from tests.one_table import COLUMNS as SIMULATED_MAP
from tests.one_table import one_table
from trimtab.host.imports import ImportFormatError
from trimtab.host.imports.fitting import check_fit
from trimtab.host.imports.formats import read
from trimtab.host.imports.write import write
from trimtab.host.log import read_flight
from trimtab.host.log.export import csv_tables
from trimtab.host.vehicle import Vehicle, load_vehicle

DATA = Path(__file__).parents[2] / "data"
RECORDED = Path(__file__).parents[4] / "shared" / "data" / "nanobench"
NANOBENCH_MAP = """
world = "nwu"
body = "flu"
time = "t"
position_m = ["px", "py", "pz"]
quaternion = ["qx", "qy", "qz", "qw"]
quaternion_order = "xyzw"
motor_command = ["motor_motor_m1", "motor_motor_m2", "motor_motor_m3", "motor_motor_m4"]
motor_command_full = 65535
gyro = ["imu_gyro_x", "imu_gyro_y", "imu_gyro_z"]
specific_force = ["imu_acc_x", "imu_acc_y", "imu_acc_z"]
specific_force_unit = "g"
unknown = ["motor-lag", "mounting-tilt", "frame-tilt", "inertia", "torque", "pose-latency"]
"""
SIMULATED = ("a1", "b1", "c1")
REAL = ("B3_figure8_fast_rep1", "B7_oval_fast_rep2", "B8_star_slow_rep1")


@dataclass(frozen=True, kw_only=True)
class Import:
    """A table, its map, and the vehicle that it is said to be of."""

    table: Path
    columns: str
    vehicle: Vehicle

    def mapped(self, pattern: str, text: str) -> Import:
        """The import with another map; the pattern has to be there."""
        columns, count = re.subn(pattern, text, self.columns)
        assert count > 0, pattern
        return replace(self, columns=columns)

    def scaled(self, pattern: str, factor: float) -> Import:
        """The import with other numbers in the columns whose names match."""
        target = self.table.with_name("scaled.csv")
        with self.table.open() as source, target.open("w", newline="") as file:
            rows, writer = csv.reader(source), csv.writer(file)
            names = next(rows)
            chosen = [k for k, name in enumerate(names) if re.search(pattern, name)]
            assert chosen
            writer.writerow(names)
            for row in rows:
                writer.writerow(
                    [repr(float(cell) * factor) if k in chosen else cell for k, cell in enumerate(row)]
                )
        return replace(self, table=target)


def reordered(found: Import, order: tuple[int, ...]) -> Import:
    listed = re.search(r"motor_command = \[(.*)\]", found.columns)
    assert listed is not None
    names = listed[1].split(", ")
    return found.mapped(r"motor_command = \[.*\]", f"motor_command = [{', '.join(names[k] for k in order)}]")


def respun(found: Import) -> Import:
    rotors = tuple(
        rotor.model_copy(update={"spin": "cw" if rotor.spin == "ccw" else "ccw"})
        for rotor in found.vehicle.rotors
    )
    return replace(found, vehicle=found.vehicle.replace(rotors=rotors))


def in_other_order(found: Import) -> Import:
    if "quaternion_order" in found.columns:
        return found.mapped(r'quaternion_order = "xyzw"', 'quaternion_order = "wxyz"')
    return found.mapped(r"(?m)^quaternion = .*$", r'\g<0>\nquaternion_order = "xyzw"')


FAULTS: dict[str, tuple[Callable[[Import], Import], str]] = {
    "motors 1 and 2 swapped": (lambda i: reordered(i, (1, 0, 2, 3)), "motor columns are in another order"),
    "motors counted the other way": (
        lambda i: reordered(i, (3, 2, 1, 0)),
        "motor columns are in another order",
    ),
    "spins reversed": (respun, "rotors spin"),
    "full command wrong by 1.6": (
        lambda i: i.scaled("motor", 1.0 / 1.6),
        r"thrust is|thrust-slope is|values of zero and full command",
    ),
    "world axes": (
        lambda i: (
            i.mapped('world = "(ned|nwu)"', 'world = "enu"')
            if '"ned"' in i.columns
            else i.mapped('world = "nwu"', 'world = "ned"')
        ),
        "upside down|check world axes",
    ),
    "body axes": (
        lambda i: (
            i.mapped('body = "frd"', 'body = "flu"')
            if '"frd"' in i.columns
            else i.mapped('body = "flu"', 'body = "frd"')
        ),
        "upside down|body axes",
    ),
    "quaternion order": (in_other_order, "upside down|check the attitude|does not match"),
    "gyro in degrees": (lambda i: i.scaled("gyro", 57.29578), "gyro's . axis does not match"),
    "positions in mm": (lambda i: i.scaled(r"^p[xyz]$|^p_ned", 1e3), "acceleration|is its unit right"),
    "mass 20 % too large": (
        lambda i: replace(i, vehicle=i.vehicle.replace(mass_kg=1.2 * i.vehicle.mass_kg)),
        "thrust is",
    ),
}


def told(found: Import, folder: Path) -> str:
    """What a user reads on import: the refusal, or the figures that do not fit."""
    (folder / "map.toml").write_text(found.columns)
    path = folder / "found.mcap"
    try:
        write(read("csv", found.table, folder / "map.toml"), found.vehicle, path, format="csv")
        return "\n".join(check_fit(read_flight(path), found.table.name))
    except ImportFormatError as error:
        return str(error)


@pytest.fixture
def imports(tmp_path: Path, require: Callable[[str], None]) -> Callable[[str], Import]:
    def make(name: str) -> Import:
        if name in SIMULATED:
            flight = DATA / f"{name}.mcap"
            (tmp_path / name).mkdir()
            for table, (_, text) in csv_tables(flight).items():
                (tmp_path / name / table).write_text(text)
            one_table(tmp_path / name, tmp_path / f"{name}.csv")
            return Import(
                table=tmp_path / f"{name}.csv", columns=SIMULATED_MAP, vehicle=read_flight(flight).vehicle
            )
        require("flights")
        return Import(table=RECORDED / f"{name}.csv", columns=NANOBENCH_MAP, vehicle=load_vehicle("nano"))

    return make


@pytest.mark.full
@pytest.mark.parametrize("name", [*SIMULATED, *REAL])
def test_planted_faults_are_named_and_the_sound_import_is_not(
    imports: Callable[[str], Import], tmp_path: Path, name: str
) -> None:
    sound = imports(name)
    table = tmp_path / sound.table.name
    if not table.exists():
        table.write_bytes(sound.table.read_bytes())
    sound = replace(sound, table=table)
    assert re.search("order|spin", told(sound, tmp_path)) is None
    answers = dict(_answers(sound, tmp_path))
    print()  # shown with -s
    for fault, (answer, named) in answers.items():
        print(f"{name} | {fault} | {'named' if named else 'missed'} | {answer.splitlines()[:1]}")
    missed = [fault for fault, (_, named) in answers.items() if not named]
    assert not missed


def _answers(sound: Import, folder: Path) -> Iterator[tuple[str, tuple[str, bool]]]:
    for fault, (plant, expected) in FAULTS.items():
        answer = told(plant(sound), folder)
        yield fault, (answer, re.search(expected, answer) is not None)
