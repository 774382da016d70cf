"""Compiled C for ctypes: hand-written sources, compiled functions, and addresses of memory."""

from __future__ import annotations

import ctypes
import logging
from collections.abc import Callable
from functools import lru_cache

import casadi as ca

from trimtab.host.codegen.compiler import (
    CodegenError,
    engine_choice,
    find_compiler,
    library_path,
    shared_library,
)
from trimtab.host.codegen.engine import c_source

_log = logging.getLogger(__name__)


def address(view: memoryview) -> int:
    """Return the address of a writable view's first element; 0 for an empty one."""
    return ctypes.addressof(ctypes.c_char.from_buffer(view)) if len(view) else 0


@lru_cache(maxsize=32)
def c_library(source: str) -> ctypes.CDLL | None:
    """Return a hand-written C source as a loaded library; None where C does not work.

    Raises CodegenError or OSError where "c" is requested.
    """
    compiler = find_compiler()
    if compiler is None:
        return None
    try:
        return ctypes.CDLL(str(shared_library(source, compiler)))
    except (CodegenError, OSError) as error:
        if engine_choice() == "c":
            raise
        _log.warning("%s; going on without it, slower", error)
        return None


@lru_cache(maxsize=32)
def c_function(function: ca.Function) -> Callable[..., int] | None:
    """Return the C function that `engine.compile_function` has compiled, with CasADi's arguments, or None."""
    compiler = find_compiler()
    if compiler is None:
        return None
    try:
        return ctypes.CDLL(str(library_path(c_source(function), compiler)))[function.name()]
    except OSError:
        return None
