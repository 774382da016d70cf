"""Compiled C for ctypes: hand-written sources, compiled functions, and addresses of memory."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import lru_cache

import casadi as ca

from trimtab.host.codegen.compiler import compiled
from trimtab.host.codegen.engine import c_source
from trimtab.host.codegen.libraries import load_library


def address(view: memoryview) -> int:
    """Return the address of a writable view's first element; 0 for an empty one."""
    return ctypes.addressof(ctypes.c_char.from_buffer(view)) if len(view) else 0


@lru_cache(maxsize=32)
def c_library(source: str) -> ctypes.CDLL | None:
    """Return a hand-written C source as a loaded library; None where C does not work or is not wanted.

    Raises CodegenError where "c" is requested and not possible.
    """
    return compiled(lambda compiler: load_library(ctypes.CDLL, source, compiler))


@lru_cache(maxsize=32)
def c_function(function: ca.Function) -> Callable[..., int] | None:
    """Return a function in C, with CasADi's arguments; None where C does not work or is not wanted.

    Raises CodegenError where "c" is requested and not possible.
    """
    library = c_library(c_source(function))
    return None if library is None else library[function.name()]
