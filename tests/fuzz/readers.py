"""Fuzzer of the readers of foreign logs: small valid logs of each format, damaged.

Whatever the bytes, a reader returns what the file holds or raises one ImportFormatError, or
ConfigurationError for a map. It raises nothing else, warns of nothing, prints nothing, ends soon and needs
little memory. Each input depends on reader, seed and index alone.

python -m tests.fuzz.readers --inputs N --seed S     N inputs to each reader; crashes are saved as hex
"""

from __future__ import annotations

import argparse
import math
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from io import StringIO
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import numpy as np

from tests.foreign import bag, dataflash, tables, ulog, usd
from tests.foreign.flight import MadeUp, in_axes, made_up
from trimtab.host.base.progress import Progress
from trimtab.host.base.text import escaped
from trimtab.host.imports import ImportFormatError, formats
from trimtab.host.imports.airborne import airborne
from trimtab.host.imports.contents import Contents
from trimtab.host.imports.formats import FormatName
from trimtab.host.imports.plausible import consistent_parts
from trimtab.host.vehicle import ConfigurationError
from trimtab.sitl.studies.fuzz.mutations import mutated_file, mutated_text

CPU_S = 20.0
"""CPU time after which a reader hangs."""

MEMORY_MIB = 256
"""Memory by which the process may grow over a run."""

CONTENTS_EVERY = 4
"""One in so many inputs is also asked for its contents, which most readers parse the same way."""

CRASHES_MAX = 20
"""A reader with this many crashes ends early."""

COLUMN_MAP = b"""world = "enu"
body = "flu"
time = "t"
position_m = ["x", "y", "z"]
euler = ["roll", "pitch", "yaw"]
gyro = ["gx", "gy", "gz"]
specific_force = ["fx", "fy", "fz"]
motor_command = ["m1", "m2", "m3", "m4"]
motor_command_zero = 0.0
battery_v = "volt"
reference_position_m = ["x", "y", "z"]
unknown = ["torque"]
"""
TOPIC_MAP = b"""pose = "/cf0/pose"
imu = "/cf0/imu"
world = "nwu"
motor_command_full = 1.0
"""
_CELLS = (
    *("", "0", "-1", "1", "nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "1e29", "2e5", "0x10", "1_0"),
    *('"', '"a\nb"', "off", "\x00", "\ufeff", "١", "9" * 400),
)


class Broken(Exception):
    """A rule is violated. The text says which."""


class Hanging(BaseException):
    """A reader takes too long. No reader catches it."""


class Input(NamedTuple):
    """The bytes of a log, and of the map to read it with if there is one."""

    log: bytes
    map: bytes | None = None


@dataclass(frozen=True, kw_only=True)
class Reader:
    """A reader: its format, the file that it gets, its valid logs, and how an input is made from one."""

    format: FormatName
    file: str
    seeds: Callable[[], tuple[bytes, ...]]
    make: Callable[[Random, bytes], Input]
    library: str | None = None


@dataclass(frozen=True, kw_only=True)
class Crash:
    """An input that violated a rule."""

    reader: str
    index: int
    error: str
    trace: str
    data: Input


@dataclass(frozen=True, kw_only=True)
class Report:
    """Inputs, flights read among them, files whose contents were told, and crashes."""

    inputs: int = 0
    read: int = 0
    told: int = 0
    crashes: tuple[Crash, ...] = ()


# Seeds: a part in the air at 12.5 Hz, which the checks compare, and the whole flight with its ground at
# 2.5 Hz.


def _flights() -> tuple[MadeUp, MadeUp]:
    return made_up().cut(slice(400, 640, 8)), made_up().cut(slice(0, None, 40))


def _ulogs() -> tuple[bytes, ...]:
    part, whole = _flights()
    plain, topics = ulog.topics_of(part), ulog.topics_of(whole)
    for flight, held in ((part, plain), (whole, topics)):
        fields, t_us, _ = held["battery_status"]
        t_us = ulog.START_US + np.round(1e6 * flight.t[::4]).astype(int)
        held["battery_status"] = (fields, t_us, flight.volt[::4, None])
    fields, t_us, commands = topics.pop("actuator_motors")
    outputs = [field.replace("control", "output") for field in fields]
    topics["actuator_outputs"] = (outputs, t_us, 1100.0 + 800.0 * commands)
    q = whole.turn.as_quat(scalar_first=True)
    mocap = [*ulog.array("position", 3), *ulog.array("q", 4)]
    topics["vehicle_mocap_odometry"] = (mocap, t_us, _side_by_side(whole.p, q))
    pulses = {"PWM_MIN": 1100.0, "PWM_MAX": 1900.0, "CA_ROTOR0_PX": 1.0}
    return ulog.ulog_bytes(plain, {}), ulog.ulog_bytes(topics, pulses)


def _dataflashes() -> tuple[bytes, ...]:
    part, whole = _flights()
    pulses = {"MOT_PWM_MIN": 1100.0, "MOT_PWM_MAX": 1900.0}
    return (
        dataflash.log_bytes(part, {"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0}),
        dataflash.log_bytes(whole, pulses),
    )


def _bags(kind: str) -> tuple[bytes, ...]:
    _remember_definitions()
    part, whole = (in_axes(flight, "nwu", "flu") for flight in _flights())
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for name, flight, compressed in (("part", part, False), ("whole", whole, kind != "sqlite3")):
            path = Path(folder) / name
            bag.write_bag(flight, path, kind, compressed=compressed)
            file = path if kind == "ros1" else next(p for p in path.iterdir() if p.suffix != ".yaml")
            found.append(file.read_bytes())
    return tuple(found)


@lru_cache
def _remember_definitions() -> None:
    """Let rosbags parse and compile equal definitions of messages once, which it does for every bag."""
    anyreader: Any = import_module("rosbags.highlevel.anyreader")

    @lru_cache(1000)
    def compiled(code: str) -> Any:
        return compile(code, "definitions", "exec")

    def execute(code: str, names: dict[str, Any]) -> None:
        exec(compiled(code), names)

    anyreader.get_types_from_msg = lru_cache(1000)(anyreader.get_types_from_msg)
    for name in ("rosbags.serde.utils", "rosbags.typesys.store"):
        vars(import_module(name))["exec"] = execute


def _usds() -> tuple[bytes, ...]:
    part, whole = _flights()
    f = in_axes(part, "nwu", "flu")
    q = f.turn.as_quat(scalar_first=True)
    pose = tuple((f"stateEstimate.{name}", "f") for name in ("x", "y", "z", "qw", "qx", "qy", "qz"))
    fast = tuple((name, "f") for name in ("gyro.x", "gyro.y", "gyro.z", "acc.x", "acc.y", "acc.z"))
    motors = tuple((f"motor.m{k}", "H") for k in (1, 2, 3, 4))
    records: list[tuple[int, int, Any]] = []
    for k, t in enumerate((1e6 * f.t).round().astype(int).tolist()):
        pwm = (65535 * f.motor[k]).round().astype(int).tolist()
        records += [(3, t, [*(57.3 * f.gyro[k]), *(f.force[k] / 9.81), *pwm]), (2, t, [*f.p[k], *q[k]])]
    other = usd.usd_bytes([(2, "pose", pose), (3, "fast", (*fast, *motors))], records, version=2)
    return other, usd.usd_flight(part, version=1), usd.usd_flight(whole, version=2)


def _tables(columns: Callable[[MadeUp], tables.Columns]) -> tuple[bytes, ...]:
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for flight in _flights():
            found.append(tables.write_csv(Path(folder) / "a.csv", columns(flight)).read_bytes())
    return tuple(found)


def _csv_columns(flight: MadeUp) -> dict[str, Any]:
    f = in_axes(flight, "enu", "flu")
    named = {
        ("x", "y", "z"): f.p,
        ("yaw", "pitch", "roll"): f.turn.as_euler("ZYX"),
        ("gx", "gy", "gz"): f.gyro,
        ("fx", "fy", "fz"): f.force,
        ("m1", "m2", "m3", "m4"): f.motor,
    }
    columns = {name: values[:, i] for names, values in named.items() for i, name in enumerate(names)}
    return {"t": f.t, **columns, "volt": f.volt}


def _blackbox() -> tuple[bytes, ...]:
    return (
        b"H Product:Blackbox flight data recorder by Nicholas Sherlock\n"
        b"H Field I name:loopIteration,time,gyroADC[0],motor[0]\n"
        b"H looptime:125\nH P interval:1/4\n" + b"I\x00\x01" * 50,
    )


def _side_by_side(*columns: Any) -> Any:
    return np.column_stack(columns)


# Inputs.


def _bytes(rng: Random, seed: bytes) -> Input:
    return Input(mutated_file(rng, seed))


def _summed(rng: Random, seed: bytes) -> Input:
    """A uSD log whose checksum is right in most inputs, so that the damage reaches the decoder."""
    if rng.random() < 0.1:
        return _bytes(rng, seed)
    return Input(usd.with_sum(mutated_file(rng, seed[:-4])))


def _cells(rng: Random, seed: bytes) -> Input:
    """A table with other cells, rows and, in some inputs, bytes."""
    if rng.random() < 0.2:
        return _bytes(rng, seed)
    lines = seed.decode().splitlines()
    for _ in range(rng.choice((1, 1, 2, 5))):
        act, at = rng.randrange(6), rng.randrange(len(lines))
        cells = lines[at].split(",")
        if act <= 2:
            cells[rng.randrange(len(cells))] = rng.choice(_CELLS)
        elif act == 3:
            k = rng.randrange(len(cells))
            cells[k:k] = rng.choice(([], ["0"])) if rng.random() < 0.5 else cells[k : k + 2]
        elif act == 4:
            lines.insert(rng.randrange(len(lines)), lines[at])
        elif len(lines) > 1:
            del lines[at : at + min(rng.choice((1, 1, 4, 10_000)), len(lines) - 1)]
            continue
        lines[at] = ",".join(cells)
    return Input(rng.choice(("\n", "\n", "\r\n", "\r")).join(lines).encode())


def _mapped(valid: bytes, make: Callable[[Random, bytes], Input]) -> Callable[[Random, bytes], Input]:
    """Inputs with a map, one in eight of which is damaged."""

    def make_both(rng: Random, seed: bytes) -> Input:
        if rng.random() < 0.125:
            return Input(seed, mutated_text(rng, valid))
        return Input(make(rng, seed).log, valid)

    return make_both


def _maybe_mapped(valid: bytes) -> Callable[[Random, bytes], Input]:
    """Inputs of which one in eight has a map."""
    with_map = _mapped(valid, _bytes)
    return lambda rng, seed: with_map(rng, seed) if rng.random() < 0.125 else _bytes(rng, seed)


def _bag_reader(kind: str, file: str) -> Reader:
    return Reader(
        format="rosbag",
        file=file,
        seeds=lambda: _bags(kind),
        make=_maybe_mapped(TOPIC_MAP),
        library="rosbags",
    )


READERS: dict[str, Reader] = {
    "ulog": Reader(format="ulog", file="a.ulg", seeds=_ulogs, make=_bytes, library="pyulog"),
    "dataflash": Reader(format="dataflash", file="a.bin", seeds=_dataflashes, make=_bytes),
    "bag": _bag_reader("ros1", "a.bag"),
    "db3": _bag_reader("sqlite3", "a.db3"),
    "mcap": _bag_reader("mcap", "a.mcap"),
    "betaflight": Reader(format="betaflight", file="a.bbl", seeds=_blackbox, make=_bytes),
    "crazyflie-usd": Reader(format="crazyflie-usd", file="log07", seeds=_usds, make=_summed),
    "nanobench": Reader(
        format="nanobench", file="a.csv", seeds=lambda: _tables(tables.nanobench_columns), make=_cells
    ),
    "csv": Reader(
        format="csv", file="a.csv", seeds=lambda: _tables(_csv_columns), make=_mapped(COLUMN_MAP, _cells)
    ),
}


@lru_cache
def seeds_of(name: str) -> tuple[bytes, ...]:
    """Return the valid logs of a reader."""
    return READERS[name].seeds()


def input_of(name: str, seed: int, index: int) -> Input:
    """Return the input with an index."""
    rng = Random(f"{name} {seed} {index}")
    return READERS[name].make(rng, rng.choice(seeds_of(name)))


def run(name: str, inputs: int, seed: int, on_progress: Callable[[int], None] = lambda done: None) -> Report:
    """Give a reader so many inputs."""
    read = told = index = 0
    crashes: list[Crash] = []
    seeds_of(name)
    with _folder() as folder, _guarded() as check_memory:
        for index in range(inputs):
            data = input_of(name, seed, index)
            try:
                found = give(READERS[name], data, folder, contents=index % CONTENTS_EVERY == 0)
                check_memory()
            except (Exception, Hanging) as error:
                trace = "".join(traceback.format_exception(error))
                line = f"{type(error).__name__}: {error}"
                crashes.append(Crash(reader=name, index=index, error=line, trace=trace, data=data))
                if len(crashes) == CRASHES_MAX:
                    break
            else:
                told += found.told
                read += found.read
            on_progress(index + 1)
    return Report(inputs=index + 1, read=read, told=told, crashes=tuple(crashes))


class Outcome(NamedTuple):
    """Whether the contents were told and the flight was read."""

    told: bool
    read: bool


def give(reader: Reader, data: Input, folder: Path, *, contents: bool) -> Outcome:
    """Give an input to a reader as an import does, and tell its contents if asked.

    Raises Broken, or whatever the reader should not raise.
    """
    path, map_path = folder / reader.file, folder / "map.toml"
    path.write_bytes(data.log)
    if data.map is not None:
        map_path.write_bytes(data.map)
    columns, topics = (None, None) if data.map is None else (map_path, None)
    if reader.format == "rosbag":
        columns, topics = topics, columns
    printed = StringIO()
    with warnings.catch_warnings(record=True) as warned, redirect_stdout(printed), redirect_stderr(printed):
        warnings.simplefilter("always")
        signal.setitimer(signal.ITIMER_PROF, CPU_S)
        try:
            _refused(lambda: formats.recognise(path), path)
            held = _refused(lambda: formats.module(reader.format).contents(path), path) if contents else None
            recording = _refused(lambda: formats.read(reader.format, path, columns, topics), path, map_path)
            if recording is not None:
                _refused(lambda: consistent_parts(recording, airborne(recording)), path, lines=True)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
    if warned:
        raise Broken(f"warns: {warned[0].category.__name__}: {warned[0].message} at {warned[0].filename}")
    if printed.getvalue():
        raise Broken(f"prints {printed.getvalue()[:200]!r}")
    if held is not None:
        _check_contents(held)
    return Outcome(held is not None, recording is not None)


def _refused(
    act: Callable[[], Any], path: Path, map_path: Path | None = None, *, lines: bool = False
) -> Any | None:
    """Return what `act` returns; None if it refuses the file in one line, or in several if it may."""
    try:
        return act()
    except ConfigurationError as error:
        if map_path is None:
            raise
        for problem in error.problems:
            _check_line(problem, map_path.name)
    except ImportFormatError as error:
        for line in str(error).split("\n") if lines else [str(error)]:
            _check_line(line, path.name)
    return None


def _check_line(line: str, name: str) -> None:
    if escaped(line) != line or name not in line:
        raise Broken(f"an error that is not one line with the name of the file: {line[:2000]!r}")


def _check_contents(contents: Contents) -> None:
    numbers = [contents.duration_s, *(topic.rate_hz for topic in contents.topics)]
    if not all(math.isfinite(number) and number >= 0.0 for number in numbers):
        raise Broken(f"contents with impossible numbers: {contents}")
    for words in (*contents.notes, *(topic.name for topic in contents.topics)):
        if escaped(words) != words:
            raise Broken(f"contents with a name that is not printable: {words[:200]!r}")


@contextmanager
def _folder() -> Iterator[Path]:
    """A folder in memory if the machine has one."""
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as folder:
        yield Path(folder)


def _most_memory_kib() -> int:
    """Return the most memory that this process has held. `getrusage` also counts that of its parent."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM:"))


@contextmanager
def _guarded() -> Iterator[Callable[[], None]]:
    """Bound the CPU time of each input, and the growth of memory by the function that is returned."""

    def hang(*_: object) -> None:
        raise Hanging(f"more than {CPU_S:g} s of CPU time")

    def check_memory() -> None:
        grown = _most_memory_kib() - before
        if grown > MEMORY_MIB * 1024:
            raise Broken(f"memory grew by {grown // 1024} MiB")

    before = _most_memory_kib()
    previous = signal.signal(signal.SIGPROF, hang)
    try:
        yield check_memory
    finally:
        signal.signal(signal.SIGPROF, previous)


def main(words: list[str] | None = None) -> int:
    """Run the fuzzer and return the exit code: 0 without crashes, 1 with crashes."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.readers", description=__doc__)
    parser.add_argument("--inputs", type=int, default=1_000, help="to each reader")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--readers", default=",".join(READERS), help="some of %(default)s")
    parser.add_argument("--replay", metavar="READER:INDEX", help="give this input alone")
    parser.add_argument("--save", type=Path, default=Path(), help="folder for crashing inputs")
    arguments = parser.parse_args(words)
    if arguments.replay:
        name, _, index = arguments.replay.partition(":")
        with _folder() as folder, _guarded():
            print(give(READERS[name], input_of(name, arguments.seed, int(index)), folder, contents=True))
        return 0
    crashed = False
    for name in arguments.readers.split(","):
        begin = time.process_time()
        with Progress(name, arguments.inputs) as bar:
            report = run(name, arguments.inputs, arguments.seed, bar.update)
        for crash in report.crashes:
            path = arguments.save / f"fuzz-{name}-{arguments.seed}-{crash.index}.hex"
            path.write_text(f"{crash.data.log.hex()}\n", encoding="ascii")
            print(f"{name}:{crash.index}: {crash.error}; input in {path}", file=sys.stderr)
        crashed = crashed or bool(report.crashes)
        print(
            f"{name}: {report.inputs} inputs, {report.told} with contents, {report.read} flights read, "
            f"{len(report.crashes)} crashes, {time.process_time() - begin:.1f} s of CPU time",
            flush=True,
        )
    return 1 if crashed else 0


if __name__ == "__main__":
    sys.exit(main())
