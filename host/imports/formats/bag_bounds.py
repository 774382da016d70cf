"""Bounds on what a bag makes the rosbags library do: decompress, parse definitions, query a database.

The library bounds none of these. Its entry points to them are replaced, once in a process, by ones that spend
from the budget of the bag that is open.
"""

from __future__ import annotations

import bz2
import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

from trimtab.host.base.bounds import (
    BAG_ARRAYS,
    BAG_CHUNK_BYTES,
    BAG_CONTENT,
    BAG_DEFINITION_BYTES,
    BAG_METADATA_BYTES,
    BAG_STEPS,
    TooLarge,
)

METADATA = "metadata.yaml"
_NESTED = re.compile(r"^[ \t]*([A-Za-z][\w/]*)\[(\d{1,18})\]", re.MULTILINE | re.ASCII)
"""A field that is an array of fixed length, in a definition: type and length."""
_PLAIN = re.compile(r"u?int(8|16|32|64)|float(32|64)|bool|byte|char|string|wstring|octet")
_STEPS_AT_ONCE = 10_000


class Budget:
    """What the bag that is open may still cost.

    parsed: its definitions, by the arguments of their parser. problem: the bound that it broke, if any; the
    library may raise an error of its own instead of TooLarge.
    """

    def __init__(self, path: Path) -> None:
        size = sum(part.stat().st_size for part in (path.iterdir() if path.is_dir() else [path]))
        self._content_limit, self._step_limit = BAG_CONTENT.limit_of(size), BAG_STEPS.limit_of(size)
        self._content = self._definitions = self._steps = 0
        self.parsed: dict[tuple[Any, ...], Any] = {}
        self.problem: str | None = None

    def _refuse(self, problem: str) -> TooLarge:
        self.problem = problem
        return TooLarge(problem)

    def spend_content(self, count: int) -> None:
        """Count bytes that were decompressed. Raises TooLarge."""
        self._content += count
        if self._content > self._content_limit:
            raise self._refuse(BAG_CONTENT.problem(limit=self._content_limit))

    def spend_definition(self, text: str) -> None:
        """Count a definition. Raises TooLarge."""
        self._definitions += len(text)
        if self._definitions > BAG_DEFINITION_BYTES.limit:
            raise self._refuse(BAG_DEFINITION_BYTES.problem())
        lengths = [int(count) for kind, count in _NESTED.findall(text) if not _PLAIN.fullmatch(kind)]
        if math.prod(lengths) > BAG_ARRAYS.limit:
            raise self._refuse(BAG_ARRAYS.problem())

    def spend_steps(self) -> bool:
        """Count steps of a query and return whether it must end."""
        self._steps += _STEPS_AT_ONCE
        if self._steps > self._step_limit:
            self.problem = BAG_STEPS.problem(limit=self._step_limit)
        return self._steps > self._step_limit


_open: list[Budget] = []
"""The budget of the bag that is open, the last one of those of this process."""


@contextmanager
def bounded(path: Path) -> Iterator[Budget]:
    """Bound what is done with the bag at `path` inside the context. Raises TooLarge."""
    _replace_entry_points()
    metadata = path / METADATA
    if metadata.is_file() and metadata.stat().st_size > BAG_METADATA_BYTES.limit:
        raise TooLarge(f"{METADATA}: {BAG_METADATA_BYTES.problem(metadata.stat().st_size)}")
    budget = Budget(path)
    _open.append(budget)
    try:
        yield budget
    finally:
        _open.pop()


@cache
def _replace_entry_points() -> None:
    rosbag1, rosbag2, mcap, anyreader, apsw = (
        cast(Any, import_module(name))
        for name in (
            "rosbags.rosbag1.reader",
            "rosbags.rosbag2.reader",
            "rosbags.rosbag2.storage_mcap",
            "rosbags.highlevel.anyreader",
            "apsw",
        )
    )
    lz4 = import_module("lz4.frame").LZ4FrameDecompressor
    zstd = rosbag2.zstd
    rosbag1.decompressors["lz4"] = _decompress(lz4)
    rosbag1.decompressors["bz2"] = _decompress(bz2.BZ2Decompressor)
    mcap.DECOMPRESSORS["lz4"] = lambda data, _: _decompress(lz4)(data)
    mcap.DECOMPRESSORS["zstd"] = lambda data, _: _decompress(zstd.ZstdDecompressor)(data)
    rosbag2.zstd = SimpleNamespace(
        decompress=_decompress(zstd.ZstdDecompressor),
        open=lambda *arguments: _File(zstd.open(*arguments)),
    )
    for name in ("get_types_from_msg", "get_types_from_idl"):
        setattr(anyreader, name, _parse(getattr(anyreader, name)))
    apsw.connection_hooks.append(_bound_queries)


def _decompress(decompressor: Callable[[], Any]) -> Callable[[bytes], bytes]:
    """Return a function that decompresses one frame after the other. It raises TooLarge."""

    def decompress(data: bytes) -> bytes:
        limit, content = BAG_CHUNK_BYTES.limit, bytearray()
        while data:
            frame = decompressor()
            content += frame.decompress(data, limit + 1 - len(content))
            if len(content) > limit:
                raise TooLarge(BAG_CHUNK_BYTES.problem())
            if not frame.eof:
                raise EOFError("compressed content that ends early")
            data = frame.unused_data or b""
        if _open:
            _open[-1].spend_content(len(content))
        return bytes(content)

    return decompress


class _File:
    """A compressed file that is open for reading. A context manager."""

    def __init__(self, file: Any) -> None:
        self._file = file

    def __enter__(self) -> _File:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def read(self, size: int = -1) -> bytes:
        """Return the next bytes. Raises TooLarge."""
        data: bytes = self._file.read(size)
        if _open:
            _open[-1].spend_content(len(data))
        return data


def _parse(parse: Callable[..., Any]) -> Callable[..., Any]:
    """Return the parser of definitions with a bound, which parses equal ones once. It raises TooLarge."""

    def bounded_parse(*arguments: Any) -> Any:
        if not _open:
            return parse(*arguments)
        budget = _open[-1]
        if arguments not in budget.parsed:
            budget.spend_definition(arguments[0])
            budget.parsed[arguments] = parse(*arguments)
        return budget.parsed[arguments]

    return bounded_parse


def _bound_queries(connection: Any) -> None:
    """Bound the values and the work of the queries of a database that is being opened."""
    if not _open:
        return
    apsw, budget = import_module("apsw"), _open[-1]
    connection.limit(apsw.SQLITE_LIMIT_LENGTH, BAG_CHUNK_BYTES.limit)
    connection.set_progress_handler(budget.spend_steps, _STEPS_AT_ONCE)
