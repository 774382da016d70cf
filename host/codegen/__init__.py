"""Turns functions written with `ops` into callables: CasADi's virtual machine, or C where possible."""

from host.codegen.compiler import CodegenError, Compiler, find_compiler
from host.codegen.engine import (
    Block,
    CompiledEngine,
    compile_blocks,
    compile_function,
    function_engine,
    sx_function,
)
from host.codegen.interrupts import held_interrupts
from host.codegen.ops import CASADI, NUMPY

__all__ = [
    "CASADI",
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
