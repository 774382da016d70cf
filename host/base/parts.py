"""Files that are being written: each has a name of its own until it is complete.

The part of NAME is called NAME.part, or NAME.2.part, NAME.3.part and so on where that one exists. It is
opened exclusively. Its writer holds a lock on it, which ends with the writer, however it ends. A part that
nobody holds is therefore what an interrupted writer left.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
from dataclasses import dataclass
from enum import Enum
from io import FileIO
from pathlib import Path

from trimtab.host.base.errors import UsageError
from trimtab.host.base.trust import user_name

SUFFIX = ".part"
_NUMBERED = re.compile(r"(?P<name>.+?)(\.(?P<number>[2-9]|[1-9][0-9]+))?\.part", re.DOTALL)
_LOOK = os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC


class NameTaken(UsageError):
    """A file of this name exists, or another process is writing one."""


class PartState(Enum):
    """What became of the writer of a part."""

    WRITING = "being written"
    INTERRUPTED = "interrupted"
    UNKNOWN = "unknown"
    """The part cannot be opened, as it may be another user's, or its file system has no locks."""


@dataclass(frozen=True, kw_only=True)
class Unfinished:
    """A part: its path, that of the finished file, its state and its size in bytes.

    owner: name of another user whom it belongs to; None for this one.
    """

    path: Path
    target: Path
    state: PartState
    size: int
    owner: str | None


class PartFile:
    """A file that this process writes, until it is published under its name. Call `close` at the end.

    Attributes
    ----------
    target, path
        Name of the finished file, and name until then.
    file
        The open file, without a buffer. It can be read too.
    published
        Whether the file has its final name.
    is_only
        Whether it is the only part. If it may replace a file, it also replaces this user's interrupted parts.
    """

    def __init__(self, target: Path, path: Path, file: FileIO, *, force: bool) -> None:
        self.target, self.path, self.file = target, path, file
        self.published = False
        self.is_only = False
        self._force = force

    def publish(self, *, durable: bool = False) -> None:
        """Give the file its final name.

        durable: return once it is on disk, so that a power cut does not harm it. Raises OSError, and
        NameTaken if a file has got this name meanwhile, unless the part was opened with `force`. The part
        stays then.
        """
        if durable:
            os.fsync(self.file.fileno())
        try:
            if self._force:
                os.replace(self.path, self.target)
            else:
                _rename_new(self.path, self.target)
        except FileExistsError:
            raise NameTaken(exists(self.target)) from None
        self.published = True
        if self._force and self.is_only:
            remove_interrupted(self.target)

    def content(self) -> bytes:
        """Return what was written so far."""
        return os.pread(self.file.fileno(), os.fstat(self.file.fileno()).st_size, 0)

    def discard(self) -> None:
        """Remove the file, unless it is published, and close it."""
        if not (self.published or self.file.closed):
            with contextlib.suppress(OSError):
                self.path.unlink()
        self.file.close()

    def close(self) -> None:
        """Close the file. What was written but not published stays, to be recovered."""
        if not self.file.closed and os.fstat(self.file.fileno()).st_size == 0:
            self.discard()
        self.file.close()


def part_path(target: Path, number: int = 1) -> Path:
    """Return the path of a part of the file `target`; `number` counts those that lie beside each other."""
    return target.with_name(f"{target.name}{'' if number == 1 else f'.{number}'}{SUFFIX}")


def target_of(part: Path) -> Path:
    """Return the path of the finished file that a part belongs to; other paths unchanged."""
    match = _NUMBERED.fullmatch(part.name)
    return part if match is None else part.with_name(match["name"])


def open_part(target: Path, *, force: bool = False, mode: int = 0o666) -> PartFile:
    """Open a new part of `target`. Others may lie and be written beside it.

    force: whether it may replace a file when it is published. mode: permissions, as far as the umask allows.
    Raises OSError with the name `target`.
    """
    number = 1
    while True:
        try:
            return _created(target, part_path(target, number), force=force, mode=mode)
        except FileExistsError:
            number += 1


def open_only_part(target: Path, *, force: bool = False) -> PartFile:
    """Open a new part of `target` unless another process is writing one. This reserves the name.

    force: whether it may replace the file `target` and what interrupted processes of this user left of it.
    Raises NameTaken, or OSError with the name `target`.
    """
    remove_interrupted(target, only_empty=True)
    others = unfinished(target)
    if others and not force:
        raise NameTaken(_why_taken(others[0]))
    if force:
        part = open_part(target, force=True)
    else:
        try:
            part = _created(target, part_path(target))  # of two processes that come here, one gets this name
        except FileExistsError:
            raise NameTaken(_is_written(target)) from None
    in_use = [
        each
        for each in unfinished(target)
        if each.path != part.path and each.state is not PartState.INTERRUPTED
    ]
    if in_use or (os.path.lexists(target) and not force):
        part.discard()
        raise NameTaken(_why_taken(in_use[0]) if in_use else exists(target))
    part.is_only = True
    return part


def unfinished(target: Path) -> list[Unfinished]:
    """Return the parts of the file `target` that lie beside it, by name."""
    return _looked([path for path in _parts(target.parent) if target_of(path) == target])


def unfinished_in(folder: Path) -> list[Unfinished]:
    """Return the parts in a folder, by name. A folder that cannot be read has none."""
    return _looked(_parts(folder))


def _parts(folder: Path) -> list[Path]:
    try:
        return sorted(folder / name for name in os.listdir(folder) if name.endswith(SUFFIX))
    except OSError:
        return []


def _looked(paths: list[Path]) -> list[Unfinished]:
    return [each for each in map(look, paths) if each is not None]


def look(path: Path) -> Unfinished | None:
    """Return what a part is; None for a path that is no part, or that has gone."""
    target = target_of(path)
    if target == path:
        return None
    try:
        size, state = path.lstat().st_size, _state(path)
    except OSError:
        return None
    if state is None:
        return None
    return Unfinished(path=path, target=target, state=state, size=size, owner=owner_of(path))


def remove_interrupted(target: Path, *, only_empty: bool = False) -> None:
    """Remove this user's parts of `target` whose writer was interrupted.

    only_empty: only those that hold nothing.
    """
    for each in unfinished(target):
        if each.state is not PartState.INTERRUPTED or each.owner is not None:
            continue
        with contextlib.suppress(OSError):
            handle = os.open(each.path, _LOOK)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                empty = os.fstat(handle).st_size == 0
                if is_at(handle, each.path) and (empty or not only_empty):
                    os.unlink(each.path)
            finally:
                os.close(handle)


def exists(path: str | Path) -> str:
    """Return the message for a name that a file has."""
    return f"{path}: exists; choose another name or add --force"


def _created(target: Path, path: Path, *, force: bool = False, mode: int = 0o666) -> PartFile:
    """Open and lock a new file at `path`. Raises OSError with the name `target`."""
    while True:
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
        except OSError as error:
            error.filename = str(target)  # that of the part means nothing to the user
            raise
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(handle, fcntl.LOCK_EX)  # others hold it for a moment only, while they look
        if is_at(handle, path):
            return PartFile(target, path, FileIO(handle, "r+"), force=force)
        os.close(handle)  # it was removed before it was locked, since it looked interrupted


def is_at(handle: int, path: Path) -> bool:
    """Return whether an open file is the one at `path`."""
    try:
        return os.path.samestat(os.fstat(handle), os.lstat(path))
    except FileNotFoundError:
        return False


def _state(path: Path) -> PartState | None:
    """Return the state of a part; None if it has gone."""
    try:
        handle = os.open(path, _LOOK)
    except FileNotFoundError:
        return None
    except OSError:
        return PartState.UNKNOWN
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return PartState.WRITING
    except OSError:
        return PartState.UNKNOWN
    finally:
        os.close(handle)
    return PartState.INTERRUPTED


def _rename_new(path: Path, target: Path) -> None:
    """Rename a file to a name that no file has. Raises FileExistsError."""
    try:
        os.link(path, target)
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links: take the name first
        os.close(os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC))
        os.replace(path, target)
        return
    with contextlib.suppress(OSError):
        path.unlink()


def _why_taken(other: Unfinished) -> str:
    """Return the message for a name that a part has taken."""
    if other.state is PartState.WRITING:
        return _is_written(other.target)
    if other.owner is not None:
        return f"{other.path}: belongs to another user ({other.owner}); choose another name"
    if other.state is PartState.UNKNOWN:
        return f"{other.path}: another process may be writing it; choose another name"
    return (
        f"{other.path}: the log of an interrupted flight; run `trimtab log recover {other.path}` and "
        "remove it, choose another name or add --force"
    )


def _is_written(target: Path) -> str:
    return f"{target}: another process is writing it; wait until it has ended or choose another name"


def owner_of(path: Path) -> str | None:
    """Return the name of the user whom a file belongs to; None if it is ours or cannot be looked at."""
    try:
        number = path.lstat().st_uid
    except OSError:
        return None
    return None if number == os.geteuid() else user_name(number) or str(number)
