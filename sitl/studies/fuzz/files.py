"""Files: blobs, logs and TOML, damaged and read as everybody reads them.

A reader either gives something whole or raises one of its documented errors with a message of one line a
problem. A blob that is taken is written again byte for byte, and the vehicle's verdict on it never raises.
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
    """Blobs, as from a file and as from an upload."""

    def __init__(self, source: Source, rng: Random, situation: int) -> None:
        self._parameters = ParameterValues(to_parameters(source.vehicle))
        self._vehicle_id = source.vehicle.id
        self.valid = 0

    def give(self, data: bytes) -> None:
        """Read the blob: it is refused, or judged and made a track."""
        for kind in (1, 2):
            check_blob(kind, data, parameters=self._parameters, vehicle_id=self._vehicle_id)
        try:
            blob = from_bytes(data)
        except BlobError as error:
            _check_told(error)
            return
        self.valid += 1
        if blob.to_bytes() != data:
            raise Broken("the blob is not what its bytes were")
        verdict = check_blob(blob.KIND, data, parameters=self._parameters, vehicle_id=self._vehicle_id)
        if verdict.ok and isinstance(blob, Reference):
            track.track(blob.nodes_ned(), blob.yaw_nodes())


def blobs(target: BlobTarget, rng: Random, source: Source) -> bytes:
    """Return references and feed-forwards with damage."""
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
        """Call `act`, which returns or raises one of the documented errors."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                act()
        except documented as error:
            _check_told(error)
        else:
            self.valid += 1


class LogTarget(_InFolder):
    """Flight logs: read, and recovered."""

    def give(self, data: bytes) -> None:
        """Read the log and recover it; each may refuse."""
        path = self.folder / "flight.mcap"
        path.write_bytes(data)
        self.read(lambda: read_flight(path), LogError)
        self.read(lambda: recover(path, self.folder / "again.mcap"), LogError)


def logs(target: LogTarget, rng: Random, source: Source) -> bytes:
    """Return a real flight's log with damage."""
    return mutations.mutated_file(rng, source.log)


class TextTarget(_InFolder):
    """TOML files; an input begins with a line that says what it is."""

    def give(self, data: bytes) -> None:
        """Read the file, or refuse it."""
        what, _, content = data.partition(b"\n")
        name = what.decode()
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
    """Return the shipped files with other numbers, words and lines."""
    what = rng.choice(("vehicle", "route", "route", "world", "world", "model"))
    return what.encode() + b"\n" + mutations.mutated_text(rng, rng.choice(source.texts[what]))


def _check_told(error: Exception) -> None:
    told = str(error)
    if not told or "\r" in told:
        raise Broken(f"an error that says nothing, or in no line: {told!r}")
