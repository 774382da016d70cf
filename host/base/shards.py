"""Shards of a study: several machines compute its pieces, and one merges their files.

Shard I of N computes a fixed part of the pieces in its own folder. A folder with the pieces of all shards is
that of a whole study.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from trimtab.host.base.artefacts import write_atomic
from trimtab.host.base.errors import UsageError
from trimtab.host.base.output import json_text
from trimtab.host.base.program import git_state, version

CONFIG, PIECES, SHARD = "study.json", "pieces", "shard"

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Shard:
    """Shard `index` of `count`, counted from 1. settings: the options of the whole study, as given."""

    index: int
    count: int
    settings: Mapping[str, Any] = field(default_factory=dict)

    def of(self, pieces: Sequence[T]) -> list[T]:
        """Return the pieces of this shard: every `count`-th."""
        return list(pieces[self.index - 1 :: self.count])

    def record(self) -> dict[str, Any]:
        """Return what all shards of a study have in common, besides its configuration."""
        return {SHARD: {"settings": dict(self.settings), "program": [version(), git_state()]}}


class ShardDone(Exception):
    """A shard is complete, and pieces of other shards are missing: the study has no result yet."""

    def __init__(self, shard: Shard, done: int, total: int) -> None:
        super().__init__(f"shard {shard.index}/{shard.count}: {done} of {total} pieces are in the folder")
        self.done, self.total = done, total


def parse_shard(text: str, settings: Mapping[str, Any]) -> Shard:
    """Return the shard that a text such as `2/4` names. Raises UsageError."""
    match = re.fullmatch(r"([0-9]{1,6})/([0-9]{1,6})", text)
    index, count = (int(part) for part in match.groups()) if match else (0, 0)
    if not 1 <= index <= count:
        raise UsageError(f"--shard {text}: give I/N with I from 1 to N, such as 1/4")
    return Shard(index=index, count=count, settings=settings)


def merge(folders: Sequence[Path], folder: Path, settings: Mapping[str, Any]) -> None:
    """Copy the files of shards into a folder.

    Raises UsageError for a folder without a shard, for shards that differ in settings or program from each
    other, or in settings from those of this study, and for a piece that differs between two folders.
    """
    configs = [_read(each) for each in folders]
    records = [{**config, **config[SHARD]} for config in configs]
    for each, record in zip(folders, records, strict=True):
        different = [key for key in record if key != SHARD and record[key] != records[0].get(key)]
        if different or len(record) != len(records[0]):
            what = ", ".join(different) or "configuration"
            raise UsageError(f"{each}: not of the same study as {folders[0]}: another {what}")
        if record["settings"] != json.loads(json.dumps(dict(settings))):
            given = ", ".join(f"{key} {value}" for key, value in record["settings"].items())
            raise UsageError(f"{each}: a shard with {given}; give the same options to merge it")
    for each in folders:
        for path in sorted(path for path in each.rglob("*") if path.is_file()):
            name = path.relative_to(each)
            if name.name != "lock" and str(name) != CONFIG:
                _join(path, folder / name, top=len(name.parts) == 1)
    config = {key: value for key, value in configs[0].items() if key != SHARD}
    if not (folder / CONFIG).is_file():
        write_atomic(folder / CONFIG, json_text(config), force=True)


def _join(path: Path, target: Path, *, top: bool) -> None:
    """Copy a file of a shard to the merged folder, unless it is there.

    At the top of the folder, JSON objects are ledgers with an entry for each piece and are joined. Raises
    UsageError for pieces and entries that differ.
    """
    if not target.is_file():
        target.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(target, path.read_bytes())
        return
    same = True
    if top and path.suffix == ".json":
        ours, theirs = (json.loads(each.read_text("utf-8")) for each in (target, path))
        same = all(ours.get(key, value) == value for key, value in theirs.items())
        if same:
            joined = dict(sorted({**ours, **theirs}.items()))
            write_atomic(target, json_text(joined), force=True)
    elif target.parent.name == PIECES:
        same = target.read_bytes() == path.read_bytes()
    if not same:
        raise UsageError(f"{path}: differs from {target}; leave one of the folders out")


def _read(folder: Path) -> dict[str, Any]:
    """Return what a shard's folder records. Raises UsageError."""
    try:
        record = json.loads((folder / CONFIG).read_text("utf-8"))
        if {"settings", "program"} <= set(record[SHARD]):
            return record
    except (OSError, ValueError, TypeError, KeyError):
        pass
    raise UsageError(f"{folder}: holds no shard of a study; give folders that --shard wrote")
