"""Files of a study, written completely or not at all, so that an interrupted run leaves no partial file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trimtab.host.base.artefacts import write_atomic
from trimtab.host.base.errors import TrimtabError


class StudyError(TrimtabError):
    """A study cannot continue. The text says why and what to do."""

    exit_code = 2


class SealBroken(StudyError):
    """A truth differs from the one whose hash was recorded before tracing."""

    exit_code = 1


def write_whole(path: Path, content: bytes) -> None:
    """Write a complete file that a power cut does not harm, or leave the old one unchanged."""
    write_atomic(path, content, force=True, durable=True)


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write `content` as a complete file with sorted keys. Raises ValueError on NaN or infinity."""
    write_whole(path, (json.dumps(content, indent=1, sort_keys=True, allow_nan=False) + "\n").encode())


def read_json(path: Path) -> dict[str, Any]:
    """Return the content of a file that `write_json` wrote."""
    return json.loads(path.read_bytes())


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file, 64 hex digits."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


class Ledger:
    """Hashes of the truths of a study by world, recorded before tracing.

    Only one process writes it. An entry never changes.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._hashes: dict[str, str] = read_json(path) if path.is_file() else {}

    def record(self, world: str, digest: str) -> None:
        """Write the hash to disk. Raises SealBroken if another one is recorded."""
        if world in self._hashes:
            self.check(world, digest)
            return
        write_json(self._path, {**self._hashes, world: digest})
        self._hashes[world] = digest

    def check(self, world: str, digest: str) -> None:
        """Raise SealBroken if no hash or a different one was recorded."""
        known = self._hashes.get(world)
        if known is None:
            raise SealBroken(f"world {world}: no hash of its truth was recorded before it was traced")
        if known != digest:
            raise SealBroken(
                f"world {world}: its truth ({digest[:12]}) is not the one that was sealed ({known[:12]})"
            )
