"""A function of named blocks as an engine: fixed memory in and out, and `run`, a call without arguments.

Compiled C or CasADi's virtual machine evaluates it, both through CasADi's buffer interface and with the same
bits. `engine` is "auto" (C where a compiler works, else the virtual machine), "vm" or "c"; None reads the
environment's TRIMTAB_ENGINE.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Protocol

import casadi as ca

from trimtab.host.base.text import readable
from trimtab.host.codegen.compiler import Compiler, compiled
from trimtab.host.codegen.interrupts import held_interrupts
from trimtab.host.codegen.libraries import load_library
from trimtab.host.codegen.ops import CASADI


class BlockLike(Protocol):
    """A named vector."""

    @property
    def name(self) -> str: ...
    @property
    def size(self) -> int: ...


@dataclass(frozen=True, kw_only=True)
class Block:
    """A named vector of `size` doubles."""

    name: str
    size: int


BlockFunction = Callable[[Any, Mapping[str, Sequence[Any]]], Mapping[str, Sequence[Any]]]
"""fn(ops, inputs) -> outputs, both by block name."""


class CompiledEngine:
    """Write `inputs`, call `run`, read `outputs`: memoryviews of doubles by block name, which never move.

    run: evaluates the function at `inputs` into `outputs`. kind: "vm" or "c".
    function: its casadi.Function. It holds addresses, so it must not be copied or pickled.
    """

    def __init__(
        self, function: ca.Function, inputs: Sequence[BlockLike], outputs: Sequence[BlockLike], kind: str
    ) -> None:
        self.kind = kind
        self.function = function
        self.inputs: Mapping[str, memoryview] = _memory(inputs)
        self.outputs: Mapping[str, memoryview] = _memory(outputs)
        # `run` crashes without the function and its buffer: keep all three.
        self.run: Callable[[], None]
        self._buffer, self.run = function.buffer()
        for index, view in enumerate(self.inputs.values()):
            self._buffer.set_arg(index, view)  # pyright: ignore[reportCallIssue]
        for index, view in enumerate(self.outputs.values()):
            self._buffer.set_res(index, view)  # pyright: ignore[reportCallIssue]

    def __reduce__(self) -> Any:
        raise TypeError("an engine holds addresses of this process and cannot be pickled")


@held_interrupts()
def sx_function(
    fn: BlockFunction, inputs: Sequence[BlockLike], outputs: Sequence[BlockLike], name: str
) -> ca.Function:
    """Return the casadi.Function of `fn`, traced with SX scalars: one column vector per block, in order.

    Raises ValueError where `fn` returns other blocks or sizes than declared.
    """
    symbols = [ca.SX.sym(block.name, block.size) for block in inputs]
    values: dict[str, Sequence[Any]] = {
        block.name: ca.vertsplit(symbol) if block.size > 1 else [symbol]
        for block, symbol in zip(inputs, symbols, strict=True)
    }
    result = fn(CASADI, values)
    names = [block.name for block in outputs]
    if sorted(result) != sorted(names):
        raise ValueError(f"{name} returned the blocks {sorted(result)}, not {sorted(names)}")
    columns = []
    for block in outputs:
        scalars = list(result[block.name])
        if len(scalars) != block.size:
            raise ValueError(f"{name} returned {len(scalars)} values for {block.name}, not {block.size}")
        columns.append(ca.densify(ca.vertcat(*(ca.SX(scalar) for scalar in scalars))))
    labels_in = [f"in_{block.name}" for block in inputs]
    labels_out = [f"out_{block.name}" for block in outputs]
    return ca.Function(name, symbols, columns, labels_in, labels_out, {"cse": True})


def c_source(function: ca.Function) -> str:
    """Return the function as C source; the C function has its name."""
    generator = ca.CodeGenerator(f"{function.name()}.c", {"with_header": False})
    generator.add(function)
    return generator.dump()


def compile_function(
    function: ca.Function, *, engine: str | None = None, native: bool = False
) -> tuple[ca.Function, str]:
    """Return the same function and "c" where it could be compiled, else `function` itself and "vm".

    native: compile for all instructions of this machine, which takes longer and changes no bit of the result.
    Raises CodegenError where "c" is requested and there is no compiler, or the compiler fails.
    """

    def external(compiler: Compiler) -> ca.Function:
        name = function.name()
        # CasADi takes the path as UTF-8, whatever the locale.
        return load_library(
            lambda path: ca.external(name, readable(path)), c_source(function), compiler, native=native
        )

    found = compiled(external, engine)
    return (function, "vm") if found is None else (found, "c")


def function_engine(
    function: ca.Function,
    inputs: Sequence[BlockLike],
    outputs: Sequence[BlockLike],
    *,
    engine: str | None = None,
) -> CompiledEngine:
    """Return an engine for a casadi.Function of dense vectors, whose arguments and results are the blocks.

    Raises ValueError where the sizes differ, CodegenError as `compile_function` does.
    """
    sizes = [function.nnz_in(k) for k in range(function.n_in())]
    sizes_out = [function.nnz_out(k) for k in range(function.n_out())]
    if sizes != [block.size for block in inputs] or sizes_out != [block.size for block in outputs]:
        raise ValueError(f"{function.name()} has {sizes} to {sizes_out} values, not the blocks' sizes")
    compiled, kind = compile_function(function, engine=engine)
    return CompiledEngine(compiled, inputs, outputs, kind)


def compile_blocks(
    fn: BlockFunction,
    inputs: Sequence[BlockLike],
    outputs: Sequence[BlockLike],
    name: str,
    *,
    engine: str | None = None,
) -> CompiledEngine:
    """Return an engine for `fn(ops, inputs) -> outputs`, traced once with SX scalars.

    `name` is a C identifier. Raises ValueError where `fn` returns other blocks, CodegenError as
    `compile_function`.
    """
    return function_engine(sx_function(fn, inputs, outputs, name), inputs, outputs, engine=engine)


def _memory(blocks: Sequence[BlockLike]) -> Mapping[str, memoryview]:
    """Return zeros for each block. Raises ValueError for a name that occurs twice."""
    views = {block.name: memoryview(array("d", bytes(8 * block.size))) for block in blocks}
    if len(views) != len(blocks):
        raise ValueError("a block's name occurs twice")
    return MappingProxyType(views)
