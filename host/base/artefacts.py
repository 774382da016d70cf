"""Files that verbs leave behind: written whole or not at all, never over another one; provenance."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, BinaryIO

from trimtab.host.base.errors import UsageError

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""What the system says where a file cannot be written to its end: for the user to mend, no bug."""
LOG_SUFFIX = ".mcap"
SEALED_OPTIONS = ("--world", "--world-seed", "--plant", "--plant-options", "--truth")
"""Options that tell what a simulated world holds: left out of every provenance."""


def content_id(content: bytes) -> str:
    """First 12 hex digits of the SHA-256 of an artefact's content (without its provenance)."""
    return hashlib.sha256(content).hexdigest()[:12]


def check_output(path: str | Path, force: bool = False) -> Path:
    """`path` as one that may be written. Call it before the work starts.

    Raises UsageError where its folder is missing or read-only, it is a folder, or it exists and `force` is
    not set.
    """
    target = Path(path)
    _check_parent(target)
    if target.is_dir():
        raise UsageError(f"{path}: is a folder, give a file name")
    if target.exists() and not force:
        raise UsageError(f"{path}: exists, choose another name or add --force")
    return target


def check_log(path: str | Path, force: bool = False) -> Path:
    """`path` as a flight log that may be written, as `check_output` says it.

    Raises UsageError too where its name is not that of a log, or where a killed flight left what can be
    recovered of it and `force` is not set.
    """
    if Path(path).suffix != LOG_SUFFIX:
        raise UsageError(f"{path}: a flight log's name ends in {LOG_SUFFIX}")
    target = check_output(path, force)
    partial = target.with_name(target.name + ".part")
    if partial.exists() and not force:
        raise UsageError(
            f"{partial}: a flight was cut short there, run `trimtab log recover {path}` and remove it, "
            "choose another name or add --force"
        )
    return target


def check_folder(path: str | Path, names: Sequence[str], force: bool = False) -> Path:
    """`path` as a folder that `names` may be written in; it is made when there is something to write.

    Raises UsageError where its own folder is missing or read-only, it is a file, or a name exists and `force`
    is not set.
    """
    folder = Path(path)
    if folder.is_dir():
        for name in names:
            check_output(folder / name, force)
    elif folder.exists():
        raise UsageError(f"{path}: is a file, give a folder's name")
    else:
        _check_parent(folder)
    return folder


def _check_parent(path: Path) -> None:
    """Raise UsageError where nothing can be made beside `path`."""
    if not path.parent.is_dir():
        raise UsageError(f"{path}: its folder does not exist, make it or choose another name")
    if not os.access(path.parent, os.W_OK | os.X_OK, effective_ids=True):
        raise UsageError(f"{path}: its folder cannot be written to, choose another one")


@contextlib.contextmanager
def open_atomic(path: str | Path, force: bool = False) -> Iterator[BinaryIO]:
    """Yield a binary file that appears under `path` when the block ends, and never where the block raises.

    Until then it is `path`.part. Raises UsageError as `check_output` does, OSError with the file's name where
    it cannot be written.
    """
    target = check_output(path, force)
    partial = target.with_name(target.name + ".part")
    try:
        with partial.open("wb") as file:
            yield file
        check_output(target, force)
        os.replace(partial, target)
    except BaseException as error:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        if isinstance(error, OSError) and (error.errno in NO_ROOM or error.filename == str(partial)):
            error.filename = str(target)  # write() says none, open() one that is nobody's business
        raise


def write_atomic(path: str | Path, content: bytes | str, force: bool = False) -> Path:
    """Return the path written: the whole content under its final name, or nothing. Raises UsageError."""
    with open_atomic(path, force) as file:
        file.write(content.encode() if isinstance(content, str) else content)
    return Path(path)


def version() -> str:
    """Trimtab's version, as installed."""
    return metadata.version("trimtab")


def git_state() -> str | None:
    """Commit of the checkout this code runs from, with -dirty where files differ; None outside of one."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    try:
        answer = subprocess.run(command, capture_output=True, text=True, check=False, timeout=10)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return answer.stdout.strip() or None


def without_options(words: Sequence[str], with_value: Sequence[str], flags: Sequence[str] = ()) -> list[str]:
    """`words` of a command line without these options and their values, in every spelling that is taken.

    A long option may be spelt with underscores for hyphens, a short one may have its value glued to it.
    """
    kept = []
    rest = iter(words)
    for word in rest:
        option, glued, _ = word.partition("=")
        if option.startswith("--"):
            option = option.replace("_", "-")
        elif option.startswith("-"):
            option, glued = option[:2], glued or option[2:]
        if option in with_value:
            if not glued:
                next(rest, None)
        elif option not in flags:
            kept.append(word)
    return kept


def public_command(argv: Sequence[str] | None = None) -> str:
    """Return the command line without what the seal forbids and without absolute paths.

    World, plant, their options and seeds are left out, for `demo` its seed too; a path keeps its last part.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    sealed = SEALED_OPTIONS + (("--seed",) if words[:1] == ["demo"] else ())
    kept = ["trimtab"]
    for word in without_options(words, sealed):
        option, equals, value = word.partition("=")
        if equals and option.startswith("-"):
            kept.append(f"{option}={_without_folder(value)}")
        else:
            kept.append(_without_folder(word))
    return " ".join(kept)


def provenance(
    *, seed: int | None = None, parents: Mapping[str, str] | None = None, argv: Sequence[str] | None = None
) -> dict[str, Any]:
    """Where an artefact comes from: version, git state, command, host seed, and its parents' ids by role.

    No wall-clock time, no absolute path, nothing that the seal forbids.
    """
    return {
        "version": version(),
        "git": git_state(),
        "command": public_command(argv),
        "seed": seed,
        "parents": dict(parents or {}),
    }


def _without_folder(word: str) -> str:
    """Return the last part of an absolute path, any other word as it is."""
    return Path(word).name if os.path.isabs(word) and len(word) > 1 else word
