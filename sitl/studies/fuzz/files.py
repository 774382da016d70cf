"""Fuzz targets for files: damaged blobs, logs and TOML files.

A reader must return a valid object or raise a documented error with one line for each problem. An accepted
blob must encode to the same bytes, and the vehicle's verdict on it must not raise.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

from trimtab.firmware_model.flight import track
from trimtab.firmware_model.flight.parameters import ParameterValues
from trimtab.firmware_model.flight.verdict import check_blob
from trimtab.host.base.errors import TrimtabError
from trimtab.host.log import LogError, read_flight, recover
from trimtab.host.models.file import read_model
from trimtab.host.route import load_route
from trimtab.host.vehicle import ConfigurationError, load_vehicle, to_parameters
from trimtab.protocol.blobs import BlobError, Reference, from_bytes
from trimtab.sitl.draw import draw_world
from trimtab.sitl.studies.fuzz import mutations
from trimtab.sitl.studies.fuzz.board import Broken
from trimtab.sitl.studies.fuzz.source import Source
from trimtab.sitl.world import load_world

_SUFFIX = {"vehicle": ".toml", "route": ".toml", "world": ".toml", "model": ".model.toml"}


class BlobTarget:
    """Blobs, read as from a file and as from an upload."""

    def __init__(self, source: Source, rng: Random, situation: int) -> None:
        self._parameters = ParameterValues(to_parameters(source.vehicle))
        self._vehicle_id = source.vehicle.id
        self.valid = 0

    def give(self, data: bytes) -> None:
        """Read the blob. If it is accepted, check it and build its track."""
        for kind in (1, 2):
            check_blob(kind, data, parameters=self._parameters, vehicle_id=self._vehicle_id)
        try:
            blob = from_bytes(data)
        except BlobError as error:
            _check_message(error)
            return
        self.valid += 1
        if blob.to_bytes() != data:
            raise Broken("the blob does not encode to its original bytes")
        verdict = check_blob(blob.KIND, data, parameters=self._parameters, vehicle_id=self._vehicle_id)
        if verdict.ok and isinstance(blob, Reference):
            track.track(blob.nodes_ned(), blob.yaw_nodes())


def blobs(target: BlobTarget, rng: Random, source: Source) -> bytes:
    """Return a damaged reference or feed-forward."""
    return mutations.mutated_file(rng, rng.choice((source.reference, source.feedforward)))


class _InFolder:
    """A target that reads files."""

    def __init__(self, source: Source, rng: Random, situation: int) -> None:
        self._source = source
        self._folder = tempfile.TemporaryDirectory()
        self.folder = Path(self._folder.name)
        self.valid = 0

    def close(self) -> None:
        """Remove the files."""
        self._folder.cleanup()

    def read(self, act: Callable[[], Any], *documented: type[Exception]) -> None:
        """Call `act`, which must return or raise one of the documented errors."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                act()
        except documented as error:
            _check_message(error)
        else:
            self.valid += 1


class LogTarget(_InFolder):
    """Flight logs: read, and recovered."""

    def give(self, data: bytes) -> None:
        """Read the log and recover it; each may refuse."""
        path = self.folder / "flight.mcap"
        path.write_bytes(data)
        self.read(lambda: read_flight(path), LogError)
        self.read(lambda: recover(path, self.folder / "again.mcap", force=True), LogError)


def logs(target: LogTarget, rng: Random, source: Source) -> bytes:
    """Return the damaged log of a real flight."""
    return mutations.mutated_file(rng, source.log)


class TextTarget(_InFolder):
    """TOML files. The first line of an input gives the kind of file."""

    def give(self, data: bytes) -> None:
        """Read the file, or refuse it."""
        first_line, _, content = data.partition(b"\n")
        name = first_line.decode()
        path = self.folder / f"a{_SUFFIX[name]}"
        path.write_bytes(content)
        readers: dict[str, Callable[[], Any]] = {
            "vehicle": lambda: load_vehicle(path),
            "route": lambda: load_route(path, vehicle=self._source.vehicle),
            "world": lambda: draw_world("a", load_world(path)[1], 7, self._source.vehicle),
            "model": lambda: read_model(path),
        }
        self.read(readers[name], ConfigurationError, TrimtabError)


def texts(target: TextTarget, rng: Random, source: Source) -> bytes:
    """Return a shipped file with changed numbers, words and lines."""
    kind = rng.choice(("vehicle", "route", "route", "world", "world", "model"))
    return kind.encode() + b"\n" + mutations.mutated_text(rng, rng.choice(source.texts[kind]))


def _check_message(error: Exception) -> None:
    message = str(error)
    if not message or "\r" in message:
        raise Broken(f"an error with an empty or malformed message: {message!r}")
