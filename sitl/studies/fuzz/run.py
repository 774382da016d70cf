"""Run of the fuzzer: inputs of every kind in batches, each with its own seed, over one or several processes.

A batch begins with new instances in one of its target's situations. Its inputs depend on seed, kind and
number alone, so any input can be replayed with all earlier ones of its batch.
"""

from __future__ import annotations

import contextlib
import hashlib
import multiprocessing
import traceback
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field
from random import Random
from typing import Any, NamedTuple

from trimtab.sitl.studies.fuzz import files, host, radio, vehicle
from trimtab.sitl.studies.fuzz.source import Source, record

BATCH = 1_000
"""Number of inputs for the same instances."""

CRASHES_MAX = 10
"""A batch with this many crashes ends early."""

OnProgress = Callable[[int, int, str], None]
"""Called with the inputs done, the total, and a detail text."""


class Kind(NamedTuple):
    """A kind of inputs: its share per thousand, its target, and the function that makes an input."""

    share: int
    target: Callable[[Source, Random, int], Any]
    make: Callable[[Any, Random, Source], Any]


KINDS: dict[str, Kind] = {
    "vehicle-bytes": Kind(170, vehicle.VehicleTarget, vehicle.raw),
    "vehicle-messages": Kind(260, vehicle.VehicleTarget, vehicle.messages),
    "vehicle-recording": Kind(130, vehicle.VehicleTarget, vehicle.recorded),
    "radio": Kind(90, radio.RadioTarget, radio.radio_frames),
    "host-bytes": Kind(80, host.HostTarget, host.raw),
    "host-messages": Kind(120, host.HostTarget, host.messages),
    "host-recording": Kind(60, host.HostTarget, host.recorded),
    "mocap": Kind(50, host.HostTarget, host.datagrams),
    "blobs": Kind(34, files.BlobTarget, files.blobs),
    "texts": Kind(5, files.TextTarget, files.texts),
    "logs": Kind(1, files.LogTarget, files.logs),
}


@dataclass(frozen=True, kw_only=True)
class Crash:
    """An input that violated a rule. `index` counts within its kind; `data` is the input as hex."""

    kind: str
    seed: int
    index: int
    error: str
    trace: str
    data: str


@dataclass(frozen=True, kw_only=True)
class FuzzReport:
    """Result of a run: inputs in total and by kind, valid messages or files among them, and crashes."""

    seed: int
    inputs: int
    valid: int
    by_kind: dict[str, int] = field(default_factory=dict)
    crashes: tuple[Crash, ...] = ()


class _Batch(NamedTuple):
    kind: str
    seed: int
    number: int
    inputs: int


class _Outcome(NamedTuple):
    kind: str
    inputs: int
    valid: int
    crashes: tuple[Crash, ...]


def run_fuzz(
    inputs: int,
    seed: int,
    on_progress: OnProgress = lambda done, total, detail: None,
    *,
    workers: int = 1,
    kinds: tuple[str, ...] = tuple(KINDS),
) -> FuzzReport:
    """Run `inputs` inputs of `kinds`, in proportion to their shares, and return the result.

    The same seed gives the same inputs for any number of processes.
    """
    batches = list(_batches(inputs, seed, kinds))
    total = sum(batch.inputs for batch in batches)
    done, valid, crashes = 0, 0, []
    by_kind: Counter[str] = Counter()
    with contextlib.closing(_outcomes(batches, workers)) as outcomes:
        for outcome in outcomes:
            done += outcome.inputs
            valid += outcome.valid
            crashes += outcome.crashes
            by_kind[outcome.kind] += outcome.inputs
            on_progress(done, total, f"{len(crashes)} crashes")
    crashes.sort(key=lambda crash: (crash.kind, crash.index))
    return FuzzReport(seed=seed, inputs=done, valid=valid, by_kind=dict(by_kind), crashes=tuple(crashes))


def replay(kind: str, seed: int, index: int) -> Crash | None:
    """Replay an input after the earlier ones of its batch. Return its crash, or None if it is fixed."""
    number, at = divmod(index, BATCH)
    crashes = _run_recorded(_Batch(kind, seed, number, at + 1)).crashes
    return next((crash for crash in crashes if crash.index == index), None)


def _batches(inputs: int, seed: int, kinds: tuple[str, ...]) -> Iterator[_Batch]:
    """Return batches of all kinds in an evenly mixed order."""
    shares = {name: KINDS[name].share for name in kinds}
    whole = sum(shares.values())
    counts = {name: inputs * share // whole for name, share in shares.items()}
    counts[kinds[0]] += inputs - sum(counts.values())
    spread = []
    for name, count in counts.items():
        for number in range(-(-count // BATCH)):
            size = min(BATCH, count - number * BATCH)
            spread.append(((number * BATCH + size / 2) / count, _Batch(name, seed, number, size)))
    return (batch for _, batch in sorted(spread))


def _outcomes(batches: list[_Batch], workers: int) -> Generator[_Outcome, None, None]:
    if workers == 1:
        yield from map(_run_recorded, batches)
        return
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        yield from pool.imap_unordered(_run_recorded, batches)


def _run_recorded(batch: _Batch) -> _Outcome:
    return _run(record(), batch)


def _run(source: Source, batch: _Batch) -> _Outcome:
    """Run all inputs of a batch. After a crash, the next input gets new instances."""
    kind = KINDS[batch.kind]
    seed = hashlib.sha256(f"{batch.kind} {batch.seed} {batch.number}".encode()).digest()
    rng = Random(seed)
    target = kind.target(source, rng, batch.number)
    crashes: list[Crash] = []
    at = valid = 0
    while at < batch.inputs and len(crashes) < CRASHES_MAX:
        data = kind.make(target, rng, source)
        try:
            target.give(data)
        except Exception as error:
            crashes.append(_crash(batch, at, error, data))
            valid += target.valid
            _close(target)
            target = kind.target(source, rng, batch.number)
        at += 1
    valid += target.valid
    _close(target)
    return _Outcome(batch.kind, at, valid, tuple(crashes))


def _crash(batch: _Batch, at: int, error: Exception, data: Any) -> Crash:
    return Crash(
        kind=batch.kind,
        seed=batch.seed,
        index=batch.number * BATCH + at,
        error=f"{type(error).__name__}: {error}",
        trace="".join(traceback.format_exception(error)),
        data=_hex(data),
    )


def _close(target: Any) -> None:
    close = getattr(target, "close", None)
    if close is not None:
        close()


def _hex(data: Any) -> str:
    """Return the input as hex, with datagrams separated by spaces."""
    return data.hex() if isinstance(data, bytes) else " ".join(part.hex() for part in data)
