"""Key files of message signing: made, read and checked.

A key file holds one line of 64 hexadecimal digits. Beside it, NAME.used holds the time of the last use, so
that a clock that was set back is noticed. Such a station could sign two messages with the same timestamp.
"""

from __future__ import annotations

import os
import secrets
from dataclasses import dataclass
from pathlib import Path

from trimtab.host.base.artefacts import write_atomic
from trimtab.host.base.errors import UsageError
from trimtab.protocol.signing import KEY_BYTES, UNIT_US, SigningKey, key_text

CLOCK_BACK_S = 60
"""Greatest number of seconds by which the clock may be behind the last use of a key."""
_OTHERS = 0o077


@dataclass(frozen=True, kw_only=True)
class StationKey:
    """The key of a ground station, and the name of its file for messages."""

    key: SigningKey
    name: str


def new_key(path: Path, force: bool = False) -> None:
    """Write a new random key to a file that only its owner can read. An existing file needs `force`.

    Raises UsageError if the file exists or cannot be written.
    """
    write_atomic(path, key_text(secrets.token_bytes(KEY_BYTES)) + "\n", force, mode=0o600)
    if force:
        _used_path(path).unlink(missing_ok=True)


def read_key(path: Path) -> StationKey:
    """Return the key in a file. Raises UsageError, which never repeats the content of the file."""
    try:
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            content = file.read(KEY_BYTES * 4)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}); check the file") from None
    if mode & _OTHERS:
        raise UsageError(f"{path}: other users can read this key; run `chmod 600 {path}`")
    try:
        return StationKey(
            key=SigningKey.from_text(content.decode("ascii").removesuffix("\n")), name=str(path)
        )
    except ValueError:
        raise UsageError(
            f"{path}: not a key, which is one line of 64 hexadecimal digits; make one with `trimtab key new`"
        ) from None


def use_key(path: Path, now: int) -> StationKey:
    """Return the key in a file and record its use at the present time, a timestamp of signatures.

    Raises UsageError like `read_key`, and if the clock is behind the last use.
    """
    station = read_key(path)
    record = _used_path(path)
    try:
        used = int(record.read_text(encoding="ascii"))
    except FileNotFoundError:
        used = 0
    except (OSError, ValueError):
        raise UsageError(f"{record}: not the time of a key's last use; remove this file") from None
    behind_s = (used - now) * UNIT_US / 1e6
    if behind_s > CLOCK_BACK_S:
        raise UsageError(
            f"{path}: this computer's clock is {behind_s:.0f} s behind the key's last use; set the clock, or "
            f"remove {record} if it was wrong then"
        )
    write_atomic(record, f"{max(now, used)}\n", force=True)
    return station


def _used_path(path: Path) -> Path:
    return path.with_name(path.name + ".used")
