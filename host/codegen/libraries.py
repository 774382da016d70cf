"""Shared libraries from C source: compiled once, cached, checked and loaded.

The cache is a directory for each key, the hash of everything that determines a library: its source, the
compiler, its flags, and for native code the processor. A library's name is the hash of its content. So one
that is cut short, was damaged, or is another machine's is never loaded but compiled anew. Neither is one that
others can change (`trimtab.host.base.trust`): a folder of this process takes the place of such a cache.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import platform
import shutil
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from trimtab.host.base.artefacts import write_atomic
from trimtab.host.base.errors import TrimtabError, UsageError
from trimtab.host.base.text import readable
from trimtab.host.base.trust import UntrustedError, distrust, read_library
from trimtab.host.codegen.compiler import CodegenError, Compiler, flags, processor, run_compiler, warn_once

T = TypeVar("T")

_uncached: dict[str, list[Path]] = {}
"""Libraries by key that this process has compiled and the cache has not."""
_temporary_folders: list[Path] = []
"""Folders of this process for libraries, the one in use last."""
_compiling = threading.RLock()
"""Held while a library is found or compiled, so that threads that need the same one do not all compile it."""


class CacheError(TrimtabError):
    """There is no folder in which compiled code can be kept. The text says why."""

    exit_code = 2


def load_library(
    load: Callable[[str], T],
    key: str,
    compiler: Compiler,
    *,
    source: Callable[[], str] | None = None,
    native: bool = False,
    include: Path | None = None,
) -> T:
    """Return `load(path)` of a library, which is compiled now unless the cache has it.

    `key`: the C source, or a text that determines it; then `source` returns the C. `native`: for the
    instructions of this machine. `include`: directory of headers; the key must name their version. Raises
    CodegenError where the library cannot be compiled or loaded.
    """
    name = library_key(key, compiler, native=native)
    with _compiling:
        for path in _whole_libraries(cache_directory() / name) or _uncached.get(name, []):
            with suppress(OSError, RuntimeError):  # it needs what this machine lacks, say: compile it again
                return load(str(path))
        return _compiled(load, key if source is None else source(), name, compiler, native, include)


def _compiled(
    load: Callable[[str], T], text: str, name: str, compiler: Compiler, native: bool, include: Path | None
) -> T:
    """Return `load(path)` of a library that is compiled now. Raises CodegenError."""
    scratch = _temporary()
    try:
        with tempfile.TemporaryDirectory(prefix=".build-", dir=scratch) as folder:
            library = run_compiler(text, compiler, Path(folder), native=native, include=include)
            return load(str(_publish(library, name)))
    except (OSError, RuntimeError) as error:
        raise CodegenError(f"compiled code cannot be written or loaded: {readable(str(error))}") from None


def library_key(key: str, compiler: Compiler, *, native: bool = False) -> str:
    """Return the name in the cache for this source or key, compiler, flags and machine."""
    parts = (key, compiler.identity, " ".join(flags(native=native)), sys.platform, platform.machine())
    parts += (processor(),) if native else ()
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:32]


def writable_cache() -> Path:
    """Return the directory of compiled libraries, like `cache_directory`.

    Raises CacheError if nothing can be kept there.
    """
    path = _trusted_cache()
    try:
        with tempfile.TemporaryFile(dir=path):
            return path
    except OSError as error:
        raise CacheError(str(error)) from None


def cache_directory() -> Path:
    """Return the directory of compiled libraries: XDG_CACHE_HOME or ~/.cache, then trimtab/codegen.

    It is made if missing. Where it cannot be made or others can change it, return one that is deleted when
    this process ends.
    """
    try:
        return _trusted_cache()
    except CacheError as error:
        _warn_of_cache(str(error))
        return _temporary()


def _trusted_cache() -> Path:
    """Return the directory of compiled libraries, made. Raises CacheError if it cannot be used."""
    try:
        path = _cache_path()
        _make_private(path)
        reason = distrust(path)
    except (OSError, RuntimeError) as error:  # RuntimeError: a user without a home
        raise CacheError(str(error)) from None
    if reason is not None:
        raise CacheError(reason)
    return path


def _cache_path() -> Path:
    """Return where the cache belongs. Raises RuntimeError for a user without a home."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    root = Path(base) if os.path.isabs(base) else Path.home() / ".cache"
    return root / "trimtab" / "codegen"


def _make_private(folder: Path) -> None:
    """Make a folder and those above it that are missing, for this user alone."""
    if not folder.is_dir():
        _make_private(folder.parent)
        folder.mkdir(mode=0o700, exist_ok=True)


def _temporary() -> Path:
    """Return a directory that is deleted when this process ends. Raises CodegenError if there is none."""
    if not (_temporary_folders and _temporary_folders[-1].is_dir()):
        try:
            path = Path(tempfile.mkdtemp(prefix="trimtab-"))
        except OSError as error:
            raise CodegenError(f"no room for compiled code: {error}") from None
        atexit.register(shutil.rmtree, path, ignore_errors=True)
        _temporary_folders.append(path)
    return _temporary_folders[-1]


def _whole_libraries(folder: Path) -> list[Path]:
    """Return the trusted libraries of this directory whose content has the hash in their name."""
    libraries = []
    with suppress(OSError):  # it cannot be read: compile it again
        for path in sorted(folder.glob("*.so")):
            with suppress(UntrustedError):
                if path.stem == _content_hash(read_library(path)):
                    libraries.append(path)
    return libraries


def _publish(library: Path, name: str) -> Path:
    """Move a library into the cache and return its path, or into a temporary directory where that fails.

    It appears whole or not at all, also where two processes do the same.
    """
    content = library.read_bytes()
    try:
        return _written(content, cache_directory() / name)
    except (OSError, UsageError) as error:  # UsageError: it vanished meanwhile, or others can change it
        _warn_of_cache(error.reason if isinstance(error, UntrustedError) else str(error))
        _uncached[name] = [_written(content, _temporary() / name)]
        return _uncached[name][0]


def _written(content: bytes, folder: Path) -> Path:
    """Write a library under the name of its content and return its path."""
    _make_private(folder)
    path = write_atomic(folder / f"{_content_hash(content)}.so", content, force=True, mode=0o644)
    read_library(path)  # the folder may belong to somebody else
    return path


def _content_hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:32]


def _warn_of_cache(reason: str) -> None:
    warn_once(
        "cache",
        f"no cache of compiled code, so each run compiles it anew: {reason}; set XDG_CACHE_HOME to a "
        "folder that only you can write to",
    )
