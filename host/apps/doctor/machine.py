"""Compiled code, its cache, and room for files."""

from __future__ import annotations

import ctypes
import shutil
import tempfile
from pathlib import Path

from trimtab.host.apps.doctor.check import Check
from trimtab.host.base.extras import install_command
from trimtab.host.codegen.compiler import (
    ENGINE_VARIABLE,
    CodegenError,
    engine_choice,
    run_compiler,
    vector_instructions,
    wanted_compiler,
)
from trimtab.host.codegen.libraries import CacheError, writable_cache
from trimtab.host.codegen.simd import PRELUDE, lane_count

FREE_MIN_BYTES = 1 << 30
"""Free space below which a check has a note."""
_SLOWER = "everything works without compiled code, slower"


def compiled_code() -> Check:
    """Return the check of the compiler: it compiles a small function, which is loaded and called."""
    name = "compiled code"
    try:
        compiler = wanted_compiler()
    except CodegenError as error:  # TRIMTAB_ENGINE asks for what is not there
        return Check(name=name, status="problem", text=str(error), remedy=f"or unset {ENGINE_VARIABLE}")
    if compiler is None:
        if engine_choice() == "vm":
            text, remedy = f"not used, since {ENGINE_VARIABLE} is vm: {_SLOWER}", f"unset {ENGINE_VARIABLE}"
        else:
            text = f"no C compiler: {_SLOWER}"
            remedy = f"install cc, gcc or clang, or run {install_command('compiler')}"
        return Check(name=name, status="note", text=text, remedy=remedy)
    try:
        with tempfile.TemporaryDirectory(prefix="trimtab-") as folder:
            library = run_compiler(PRELUDE, compiler, Path(folder), native=True)
            lanes = lane_count(ctypes.CDLL(str(library)))
    except (CodegenError, OSError) as error:
        remedy = "repair the compiler or install another one"
        if engine_choice() == "c":
            return Check(name=name, status="problem", text=str(error), remedy=remedy)
        return Check(name=name, status="note", text=f"{error}; {_SLOWER}", remedy=remedy)
    known = ", ".join(vector_instructions()) or "of an unknown processor"
    text = f"works, with {compiler.name}; vectors of {lanes} doubles (instructions {known})"
    return Check(name=name, status="ok", text=text)


def cache() -> Check:
    """Return the check of the folder in which compiled code is kept."""
    name = "cache"
    try:
        path = writable_cache()
    except CacheError as error:
        text = f"compiled code cannot be kept, so each run compiles it anew: {error}"
        remedy = "set XDG_CACHE_HOME to a folder that only you can write to"
        return Check(name=name, status="note", text=text, remedy=remedy)
    return Check(name=name, status="ok", text=str(path))


def temporary_files() -> Check:
    """Return the check of the folder for temporary files."""
    name = "temporary files"
    try:
        path = Path(tempfile.gettempdir())
    except OSError as error:
        remedy = "set TMPDIR to a folder that can be written to"
        return Check(name=name, status="problem", text=f"no folder can be written to: {error}", remedy=remedy)
    return room(name, path)


def room(name: str, folder: Path) -> Check:
    """Return the check of the space that is free where `folder` is."""
    free = shutil.disk_usage(folder).free
    text = f"{folder}, {free / (1 << 30):.1f} GiB free"
    if free < FREE_MIN_BYTES:
        return Check(name=name, status="note", text=text, remedy="make room before long flights and studies")
    return Check(name=name, status="ok", text=text)
