"""Non-volatile memory of a simulated vehicle, in a file that outlives the process."""

from __future__ import annotations

import contextlib
import fcntl
import os
import stat
from pathlib import Path

from trimtab.firmware_model.storage.flash import ERASED, Flash
from trimtab.firmware_model.storage.store import MAGIC, ReferenceStore, memory_bytes
from trimtab.host.base.artefacts import write_atomic
from trimtab.host.base.errors import UsageError
from trimtab.host.vehicle import ConfigurationError, Vehicle


def open_memory(path: Path, vehicle: Vehicle) -> ReferenceStore:
    """Open the memory in a file, or make it, and lock it. Writes reach the file immediately.

    Raises ConfigurationError if the file cannot be opened or made, is not a memory, is in use, or belongs to
    another vehicle.
    """
    try:
        if not os.path.lexists(path):
            with contextlib.suppress(UsageError):  # another process has made it, or opening it says why not
                write_atomic(path, bytes(MAGIC.ljust(memory_bytes(), ERASED)), mode=0o600)
        file = os.open(path, os.O_RDWR | os.O_NONBLOCK)
    except OSError as error:
        raise _refused(path, f"{error.strerror}; name a file that can be written") from None
    try:
        store = ReferenceStore(Flash(_image(path, file), file))
        _check_owner(path, store, vehicle)
    except BaseException:
        os.close(file)
        raise
    return store


def _image(path: Path, file: int) -> bytearray:
    status = os.fstat(file)
    if not stat.S_ISREG(status.st_mode):
        raise _refused(path, "not a regular file; name one")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        raise _refused(path, "in use by another simulated vehicle; end it or name another file") from None
    if status.st_size != memory_bytes() or os.pread(file, len(MAGIC), 0) != MAGIC:
        raise _refused(path, "not a memory of this version of trimtab; name another file or remove it")
    return bytearray(os.pread(file, status.st_size, 0))


def _check_owner(path: Path, store: ReferenceStore, vehicle: Vehicle) -> None:
    owner = store.settings.vehicle_id
    if owner not in (None, vehicle.id_bytes):
        raise _refused(
            path,
            f"belongs to the vehicle file with id {owner.hex()}, not to {vehicle.name} ({vehicle.id}); "
            "name another file or remove it",
        )


def _refused(path: Path, reason: str) -> ConfigurationError:
    return ConfigurationError([f"memory {path}: {reason}"])
