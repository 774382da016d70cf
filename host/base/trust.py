"""What may be loaded as code: files that nobody but this user and root can change.

One rule for compiled libraries, for effects of a workspace and for plants. A file or folder is trusted if it
and every folder above it, up to the home folder or the root of the file system,

- belongs to this user or to root, and
- can be written by its owner alone. A group may write too if it is the owner's private group: it has the
  owner's name and no other member. In a sticky folder, such as /tmp, nobody can replace files of others, so
  one above the file may be written by all.

Links are followed first, and the folders that hold them are checked as well. On a system without owners of
files, everything is trusted.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from trimtab.host.base import output
from trimtab.host.base.errors import UsageError

ROOT = 0
_announced: set[Path] = set()


class UntrustedError(UsageError):
    """Others can change a file that would be loaded as code. `reason` says how."""

    def __init__(self, path: Path, reason: str) -> None:
        self._path, self.reason = path, reason
        super().__init__(f"{path}: not run, {reason}; read it, then add --trust to run its code all the same")

    def __reduce__(self) -> tuple[type[UntrustedError], tuple[Path, str]]:
        """Return the type and arguments that rebuild the error, for pickle."""
        return type(self), (self._path, self.reason)


def distrust(path: Path) -> str | None:
    """Return how others can change what is at `path`, in words; None if they cannot.

    Raises OSError if there is nothing at `path`.
    """
    if not hasattr(os, "geteuid"):
        return None
    target = path.resolve(strict=True)
    for place in _places(path):
        fault = _fault(place, place.stat(), above=place != target)
        if fault is not None:
            return fault
    return None


def read_code(path: Path, *, trusted: bool = False) -> bytes:
    """Return the source in a file of the user's, and name the file on stderr, once in a process.

    trusted: whether the user trusts the file whoever can change it. Raises UntrustedError without that, and
    OSError if the file cannot be read.
    """
    content = _read(path, trusted=trusted)
    place = path.resolve()
    if place not in _announced:
        _announced.add(place)
        output.warn(f"runs the code in {place}")
    return content


def read_library(path: Path) -> bytes:
    """Return the content of a compiled library. Raises UntrustedError or OSError."""
    return _read(path, trusted=False)


def _read(path: Path, *, trusted: bool) -> bytes:
    """Return the content of a file that is checked while it is open."""
    with path.open("rb") as file:
        if not trusted:
            reason = distrust(path)
            if reason is None and not os.path.samestat(os.fstat(file.fileno()), path.stat()):
                reason = "it was replaced while it was read"
            if reason is not None:
                raise UntrustedError(path, reason)
        return file.read()


def _places(path: Path) -> Iterator[Path]:
    """Yield what is at `path` and the folders that lead to it, links followed, up to the home folder."""
    home, visited = _home(), set[Path]()
    for named in (path.absolute(), *path.absolute().parents):
        real = named.resolve()
        for place in (real, *real.parents):
            if place in visited:
                break
            visited.add(place)
            yield place
            if place == home:
                break
        if real == home:
            return


def _home() -> Path | None:
    try:
        return Path.home().resolve()
    except (OSError, RuntimeError):  # a user without a home
        return None


def _fault(place: Path, status: os.stat_result, *, above: bool) -> str | None:
    """Return how others can change a file or folder. `above`: it is a folder above the one in question."""
    if status.st_uid not in (ROOT, os.geteuid()):
        return f"{place} belongs to {user_name(status.st_uid) or f'user {status.st_uid}'}"
    if above and status.st_mode & stat.S_ISVTX:
        return None
    if status.st_mode & stat.S_IWOTH:
        return f"everybody can write to {place}"
    if status.st_mode & stat.S_IWGRP and not _is_private(status.st_gid, status.st_uid):
        return f"a group can write to {place}"
    return None


def user_name(uid: int) -> str | None:
    """Return the name of a user; None for a number that no user has."""
    import pwd

    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return None


@cache
def _is_private(gid: int, uid: int) -> bool:
    """Return whether a group has the name of this user and no other member."""
    import grp
    import pwd

    try:
        group, user = grp.getgrgid(gid), pwd.getpwuid(uid).pw_name
    except KeyError:
        return False
    return group.gr_name == user and set(group.gr_mem) <= {user}
