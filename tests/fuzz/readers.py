"""Fuzzer of the readers of foreign logs: damaged logs of every format, read as an import reads them.

python tests/fuzz/readers.py [--inputs N] [--seed S] [--formats F,..]     N inputs for each reader

Whatever the bytes, a reader returns what it found or raises one documented error, one line for each problem.
"""

from __future__ import annotations

import argparse
import struct
import sys
import tempfile
import time
import traceback
import warnings
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random
from types import SimpleNamespace

import numpy as np
from scipy.spatial.transform import Rotation

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.foreign import bag, dataflash, ulog
from trimtab.host.imports import ImportFormatError, formats
from trimtab.host.imports.airborne import airborne
from trimtab.host.imports.formats import FormatName, nanobench
from trimtab.host.imports.plausible import consistent_span
from trimtab.host.vehicle import ConfigurationError
from trimtab.sitl.studies.fuzz import mutations

BAGS = {"ros1": "ros1", "ros2-db3": "sqlite3", "ros2-mcap": "mcap"}
"""Readers of bags, with the kind that `tests.foreign.bag` writes."""
READERS = ("ulog", "dataflash", *BAGS, "betaflight", "crazyflie-usd", "nanobench", "csv")
"""What is fuzzed: the formats, and a bag by each of its containers."""
_MAP = """
world = "enu"
body = "flu"
time = "t"
position_m = ["x", "y", "z"]
euler = ["a", "b", "c"]
gyro = ["d", "e", "f"]
thrust_n = "T"
"""
_USD = ("stateEstimate.x", "stateEstimate.y", "stateEstimate.z", "stateEstimate.roll", "stateEstimate.pitch")
_USD += ("stateEstimate.yaw", "motor.m1", "motor.m2", "motor.m3", "motor.m4")
_BETAFLIGHT = (
    b"H Product:Blackbox flight data recorder by Nicholas Sherlock\nH looptime:125\nH P interval:1/2\n"
    b"H Field I name:loopIteration,time,gyroADC[0],gyroADC[1],gyroADC[2],motor[0],motor[1]\n"
    + bytes(range(200))
)


@dataclass(frozen=True, kw_only=True)
class Failure:
    """An input on which a reader broke the rule, and how."""

    reader: str
    index: int
    error: str
    data: bytes


def small_flight(rate_hz: int = 50, duration_s: float = 2.6) -> SimpleNamespace:
    """A short flight in a slow circle with the motors at hover: enough for an import, little to parse."""
    t = np.arange(0.0, duration_s, 1.0 / rate_hz)
    turn = Rotation.from_euler("ZYX", np.column_stack([0.3 * t, 0.02 * np.sin(t), 0.02 * np.cos(t)]))
    still = np.ones(len(t))
    force = turn.inv().apply(np.column_stack([-0.3 * np.cos(t), -0.3 * np.sin(t), -9.8 * still]))
    return SimpleNamespace(
        t=t,
        p=np.column_stack([0.3 * np.cos(t), 0.3 * np.sin(t), -1.2 * still]),
        turn=turn,
        gyro=np.column_stack([0.02 * np.cos(t), 0.02 * np.sin(t), 0.3 * still]),
        force=force,
        motor=np.full((len(t), 4), 0.5),
        volt=np.full(len(t), 16.0),
    )


def whole_log(reader: str, folder: Path) -> bytes:
    """A log of the small flight for a reader."""
    flight = small_flight()
    if reader == "ulog":
        return ulog.ulog_bytes(ulog.topics_of(flight), {"CA_ROTOR_COUNT": 4.0})
    if reader == "dataflash":
        return dataflash.log_bytes(flight, {"FRAME_CLASS": 1.0})
    if reader in BAGS:
        target = folder / ("a.bag" if reader == "ros1" else reader)
        bag.write_bag(_north_west_up(flight), target, BAGS[reader])
        return (target if reader == "ros1" else next(target.glob("*.[dm]*[3p]"))).read_bytes()
    if reader == "betaflight":
        return _BETAFLIGHT
    if reader == "crazyflie-usd":
        return _usd(flight)
    columns = nanobench.COLUMNS if reader == "nanobench" else list("txyzabcdefT")
    t, angles = flight.t[:, None], flight.turn.as_euler("xyz")
    table = np.column_stack([t, flight.p, angles, flight.gyro, 4.0 * np.ones_like(t)])
    if reader == "nanobench":
        turned = _north_west_up(flight)
        values = dict.fromkeys(columns, np.zeros(len(t)))
        named = zip(nanobench.COLUMNS[:8], [flight.t, *turned.p.T, *turned.turn.as_quat().T], strict=True)
        values |= dict(named) | {name: 3e4 + values[name] for name in columns if "motor_m" in name}
        values["imu_acc_z"] = np.ones(len(t))
        table = np.column_stack([values[name] for name in columns])
    rows = [",".join(columns), *(",".join(f"{value:.5g}" for value in row) for row in table.tolist())]
    return "\n".join(rows).encode()


def _north_west_up(flight: SimpleNamespace) -> SimpleNamespace:
    """The flight with the axes of ROS, from NED and FRD."""
    flip, half = np.array([1.0, -1.0, -1.0]), Rotation.from_rotvec([np.pi, 0.0, 0.0])
    turned = {name: getattr(flight, name) * flip for name in ("p", "gyro", "force")}
    return SimpleNamespace(**{**vars(flight), **turned, "turn": half * flight.turn * half})


def _usd(flight: SimpleNamespace) -> bytes:
    head = struct.pack("<BHHH", 0xBC, 2, 1, 1) + b"fixedFrequency\0" + struct.pack("<H", len(_USD))
    head += b"".join(f"{name}(f)".encode() + b"\0" for name in _USD)
    angles = np.degrees(flight.turn.as_euler("xyz"))
    values = np.column_stack([-flight.p, angles, 3e4 * np.ones((len(flight.t), 4))])
    rows = zip((1e6 * flight.t).astype(int).tolist(), values.tolist(), strict=True)
    body = head + b"".join(struct.pack(f"<HQ{len(row)}f", 1, t, *row) for t, row in rows)
    return with_sum(body)


def with_sum(body: bytes) -> bytes:
    """The content of a uSD log with its checksum."""
    return body + struct.pack("<I", zlib.crc32(body))


def damaged(reader: str, rng: Random, content: bytes) -> bytes:
    """The log with a few mutations; a uSD log mostly with a checksum that is right again."""
    if reader == "crazyflie-usd" and rng.random() < 0.9:
        return with_sum(mutations.mutated_file(rng, content[:-4]))
    if reader in ("csv", "nanobench") and rng.random() < 0.5:
        return mutations.mutated_text(rng, content)
    return mutations.mutated_file(rng, content)


def target_of(reader: str, folder: Path) -> Path:
    """The path under which a reader gets its input; that of a ROS 2 bag has its own metadata beside it."""
    names = {"ros1": "a.bag", "ros2-db3": "a.db3", "ros2-mcap": "a.mcap"}
    return folder / names.get(reader, "log")


def give(reader: str, data: bytes, folder: Path) -> bool:
    """Recognise, list and read a log as an import does. Return whether it was read.

    Raises what a reader must not raise.
    """
    path = target_of(reader, folder)
    path.write_bytes(data)
    columns = None
    if reader == "csv":
        columns = folder / "map.toml"
        columns.write_text(_MAP)
    name: FormatName = "rosbag" if reader in BAGS else reader  # type: ignore[assignment]
    acts: tuple[Callable[[], object], ...] = (
        lambda: formats.recognise(path),
        lambda: formats.module(name).contents(path),
        lambda: _read(name, path, columns),
    )
    done = False
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for act in acts:
            done = False
            try:
                act()
            except (ImportFormatError, ConfigurationError) as error:
                if "\r" in str(error) or not all(str(error).split("\n")):
                    raise AssertionError(f"not one line for each problem: {str(error)!r}") from error
            else:
                done = True
    return done


def _read(name: FormatName, path: Path, columns: Path | None) -> None:
    found = formats.read(name, path, columns)
    consistent_span(found, airborne(found))


def run(reader: str, inputs: int, seed: int) -> tuple[int, list[Failure]]:
    """Give a reader this number of inputs; return how many it read, and its failures."""
    failures, valid = [], 0
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as name:
        folder = Path(name)
        content = whole_log(reader, folder)
        for index, data in zip(range(inputs), _inputs(reader, seed, content), strict=False):
            try:
                valid += give(reader, data, folder)
            except Exception as error:
                text = "".join(traceback.format_exception(error))
                failures.append(Failure(reader=reader, index=index, error=text, data=data))
    return valid, failures


def _inputs(reader: str, seed: int, content: bytes) -> Iterator[bytes]:
    rng = Random(f"{reader} {seed}")
    yield content
    while True:
        yield damaged(reader, rng, content)


def main(words: list[str] | None = None) -> int:
    """Fuzz the readers and return 1 if any broke the rule. The inputs of failures are written as files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=100_000, help="for each reader")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--formats", default=",".join(READERS))
    arguments = parser.parse_args(words)
    broken = 0
    for reader in arguments.formats.split(","):
        begin = time.monotonic()
        valid, failures = run(reader, arguments.inputs, arguments.seed)
        took = time.monotonic() - begin
        print(
            f"{reader}: {arguments.inputs} inputs, {valid} read, {len(failures)} failures, {took:.0f} s",
            flush=True,
        )
        for failure in {each.error: each for each in failures}.values():
            path = Path(f"fuzz-{failure.reader}-{arguments.seed}-{failure.index}.bin")
            path.write_bytes(failure.data)
            print(f"{path}:\n{failure.error}", file=sys.stderr)
        broken += len(failures)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
