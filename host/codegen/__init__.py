"""Turns functions written with `ops` into callables: CasADi's virtual machine, or C where possible."""

from trimtab.host.codegen.compiler import CodegenError, Compiler, find_compiler
from trimtab.host.codegen.engine import (
    Block,
    CompiledEngine,
    compile_blocks,
    compile_function,
    function_engine,
    sx_function,
)
from trimtab.host.codegen.interrupts import held_interrupts
from trimtab.host.codegen.ops import CASADI, LIBM, NUMPY

__all__ = [
    "CASADI",
    "LIBM",
    "NUMPY",
    "Block",
    "CodegenError",
    "CompiledEngine",
    "Compiler",
    "compile_blocks",
    "compile_function",
    "find_compiler",
    "function_engine",
    "held_interrupts",
    "sx_function",
]
