"""Output files: written completely or not at all, without overwriting others; and their provenance."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import json
import os
import shlex
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from io import BufferedWriter
from pathlib import Path
from typing import Any, BinaryIO

from trimtab.host.base.errors import UsageError
from trimtab.host.base.parts import (
    NameTaken,
    PartFile,
    exists,
    is_at,
    open_only_part,
    open_part,
    remove_interrupted,
)
from trimtab.host.base.program import git_state, program_id, version
from trimtab.host.base.text import readable

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""Error numbers for a file that cannot be written completely. The user can fix these; they are not bugs."""
LOG_SUFFIX = ".mcap"
SEALED_OPTIONS = ("--world", "--world-seed", "--plant", "--plant-options", "--truth")
"""Options that reveal the content of a simulated world. Every provenance leaves them out."""


def content_id(content: bytes) -> str:
    """Return the first 12 hex digits of the SHA-256 of an artefact's content (without its provenance)."""
    return hashlib.sha256(content).hexdigest()[:12]


def content_id_of(path: Path) -> str:
    """Return the content id of a file, or of a folder's files in the order of their names."""
    digest = hashlib.sha256()
    for part in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if part.is_file():
            with part.open("rb") as stream:
                while block := stream.read(1 << 20):
                    digest.update(block)
    return digest.hexdigest()[:12]


def check_output(path: str | Path, force: bool = False) -> Path:
    """Check that the file `path` can be written, and return it. Call this before the work starts.

    Raises UsageError if its folder is missing or read-only, if it is a folder, or if it exists and `force` is
    not set.
    """
    target = Path(path)
    _check_parent(target)
    if target.is_dir():
        raise UsageError(f"{path}: is a folder; give a file name")
    if target.exists() and not force:
        raise NameTaken(exists(path))
    return target


def reserve_log(path: str | Path, force: bool = False) -> PartFile:
    """Open the file of the flight log `path`, which only this process writes. Call this before the work.

    What interrupted flights left stays. Raises UsageError like `check_output`, and if the name does not end
    in `.mcap`; NameTaken if another process is writing it, or if an interrupted flight left a file that can
    be recovered and `force` is not set.
    """
    if Path(path).suffix != LOG_SUFFIX:
        raise UsageError(f"{path}: give the flight log a name that ends in {LOG_SUFFIX}")
    return open_only_part(check_output(path, force), force=force)


def check_folder(path: str | Path, names: Sequence[str], force: bool = False) -> Path:
    """Check that files `names` can be written in the folder `path`, and return it.

    Makes no folder: the caller makes those that are missing. Raises UsageError if they cannot be made, or if
    a folder above it is a file; NameTaken if it is a file, or if a name exists and `force` is not set.
    """
    folder = Path(path)
    if folder.is_dir():
        for name in names:
            check_output(folder / name, force)
    elif folder.exists():
        raise NameTaken(f"{path}: is a file; give a folder")
    else:
        above = next(parent for parent in folder.parents if parent.exists())
        if not above.is_dir():
            raise UsageError(f"{path}: {above} is a file; choose another folder")
        _check_writable(path, above)
    return folder


@contextlib.contextmanager
def own_folder(path: str | Path, force: bool = False) -> Iterator[Path]:
    """Yield a folder in which no other process writes during the block, and which is empty unless `force`.

    It is made if missing, and then removed again if the block leaves it empty. Raises NameTaken if another
    process writes in it, or if it holds files and `force` is not set; UsageError like `check_folder`.
    """
    folder = check_folder(path, ())
    existed = folder.is_dir()
    handle = _locked_folder(folder)
    try:
        if any(folder.iterdir()) and not force:
            raise NameTaken(f"{path}: is not empty; choose another folder or add --force")
        yield folder
    finally:
        if not existed:
            with contextlib.suppress(OSError):  # it holds files
                folder.rmdir()
        os.close(handle)


def _locked_folder(folder: Path) -> int:
    """Make, open and lock a folder. Return its file descriptor. Raises NameTaken if it is locked."""
    while True:
        folder.mkdir(parents=True, exist_ok=True)
        try:
            handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except FileNotFoundError:  # another process removed it, as it had written nothing
            continue
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            raise NameTaken(
                f"{folder}: another process writes in this folder; wait until it has ended or choose another"
            ) from None
        except OSError:  # a file system without locks
            return handle
        if is_at(handle, folder):
            return handle
        os.close(handle)


def check_new_folder(path: str | Path) -> Path:
    """Check that the folder `path` can be made, and return it. Call this before the work starts.

    Raises UsageError if the folder above it is missing or read-only, or if anything has its name.
    """
    target = Path(path)
    _check_parent(target)
    if target.exists():  # nobody checks what a folder holds, so none is ever replaced
        raise UsageError(f"{path}: exists; choose another name")
    return target


def _check_parent(path: Path) -> None:
    """Raise UsageError if the folder of `path` does not exist or cannot be written to."""
    if not path.parent.is_dir():
        raise UsageError(f"{path}: its folder does not exist; make it or choose another name")
    _check_writable(path, path.parent)


def _check_writable(path: str | Path, folder: Path) -> None:
    """Raise UsageError, which names `path`, if nothing can be made in `folder`."""
    if not os.access(folder, os.W_OK | os.X_OK, effective_ids=True):
        raise UsageError(f"{path}: its folder cannot be written to; choose another one")


@contextlib.contextmanager
def open_atomic(
    path: str | Path, force: bool = False, *, alone: bool = False, durable: bool = False, mode: int = 0o666
) -> Iterator[BinaryIO]:
    """Yield a binary file that appears as `path` when the block ends without an error.

    alone: no other process writes this file meanwhile, so that several files can be written together.
    durable: a power cut after the block does not harm it. mode: permissions, as far as the umask allows.
    Raises UsageError like `check_output`, NameTaken if another process writes it `alone`, or OSError with
    the name of the file if it cannot be written.
    """
    target = check_output(path, force)
    if target.suffix != LOG_SUFFIX:  # what is left of a log can be recovered
        remove_interrupted(target)
    part = open_only_part(target, force=force) if alone else open_part(target, force=force, mode=mode)
    file = BufferedWriter(part.file)
    try:
        yield file
        file.flush()
        part.publish(durable=durable)
    except OSError as error:
        if error.errno in NO_ROOM or error.filename == str(part.path):
            error.filename = str(target)  # write() gives no name, and that of the part means nothing
        raise
    finally:
        part.discard()


@contextlib.contextmanager
def folder_atomic(path: str | Path) -> Iterator[Path]:
    """Yield a path for the block to make a folder at, which appears as `path` when the block ends.

    Its last part is that of `path`. After an error nothing remains. Raises UsageError like
    `check_new_folder`.
    """
    target = check_new_folder(path)
    with tempfile.TemporaryDirectory(prefix=f".{target.name}-", dir=target.parent) as temporary:
        yield Path(temporary) / target.name
        check_new_folder(target)
        os.rename(Path(temporary) / target.name, target)


def write_atomic(
    path: str | Path, content: bytes | str, force: bool = False, *, durable: bool = False, mode: int = 0o666
) -> Path:
    """Write the complete content to `path` or nothing, and return the path. Raises like `open_atomic`."""
    with open_atomic(path, force, durable=durable, mode=mode) as file:
        file.write(readable(content).encode() if isinstance(content, str) else content)
    return Path(path)


def record_path(path: Path) -> Path:
    """Return the file beside an artefact that holds its record: NAME.json."""
    return path.with_name(path.name + ".json")


def check_recorded(path: str | Path, *, suffix: str, what: str, force: bool = False) -> Path:
    """Return the path, if an artefact called `what` may be written there with its record.

    Raises UsageError for another suffix and like `check_output`. Call it before the work starts.
    """
    target = Path(path)
    if target.suffix != suffix:
        raise UsageError(f"{path}: a {what}'s name ends in {suffix}")
    check_output(target, force)
    check_output(record_path(target), force)
    return target


def write_recorded(path: Path, content: bytes, record: Mapping[str, Any], force: bool = False) -> Path:
    """Write an artefact and its record, each whole or not at all, the artefact last. Raises UsageError.

    Of two processes that write the same artefact, one is refused: record and artefact belong together.
    """
    text = json.dumps(record, indent=2, sort_keys=True, allow_nan=False) + "\n"
    with open_atomic(path, force, alone=True) as file:
        file.write(content)
        write_atomic(record_path(path), text, force)
    return path


def without_options(words: Sequence[str], with_value: Sequence[str], flags: Sequence[str] = ()) -> list[str]:
    """Return the words of a command line without these options and their values, in every accepted spelling.

    A long option may have underscores instead of hyphens, and a short one may be joined to its value.
    """
    remaining = []
    words_iterator = iter(words)
    for word in words_iterator:
        option, joined, _ = word.partition("=")
        if option.startswith("--"):
            option = option.replace("_", "-")
        elif option.startswith("-"):
            option, joined = option[:2], joined or option[2:]
        if option in with_value:
            if not joined:
                next(words_iterator, None)
        elif option not in flags:
            remaining.append(word)
    return remaining


def public_command(argv: Sequence[str] | None = None) -> str:
    """Return the command line, quoted for a shell, without sealed options and absolute paths.

    World, plant, their options and seeds are left out; for `demo`, also its seed. Of a path, only the last
    part remains.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    sealed = SEALED_OPTIONS + (("--seed",) if words[:1] == ["demo"] else ())
    public = ["trimtab"]
    for word in without_options(words, sealed):
        option, equals, value = word.partition("=")
        if equals and option.startswith("-"):
            public.append(f"{option}={_without_folder(value)}")
        else:
            public.append(_without_folder(word))
    return readable(shlex.join(public))


def provenance(
    *, seed: int | None = None, parents: Mapping[str, str] | None = None, argv: Sequence[str] | None = None
) -> dict[str, Any]:
    """Return the provenance of an artefact: version, git state, command, host seed, and parents' ids by role.

    It contains no wall-clock time, no absolute path and nothing that is sealed. argv: words of the command;
    those of this process by default. Without any word, as for work of a script, the command is None.
    """
    return {
        "version": version(),
        "git": git_state(),
        "command": public_command(argv) if argv is None or argv else None,
        "seed": seed,
        "parents": dict(parents or {}),
    }


def log_provenance(argv: Sequence[str] | None = None) -> dict[str, str]:
    """Return the program and the command of a flight, for its log. argv: as for `public_command`.

    The same program gives the same entries wherever it is installed, with git or without: a log's id covers
    its provenance.
    """
    return {"version": version(), "program_id": program_id(), "command": public_command(argv)}


def _without_folder(word: str) -> str:
    """Return the last part of an absolute path, or any other word unchanged."""
    return Path(word).name if os.path.isabs(word) and len(word) > 1 else word
