"""Interface of the flight MCU to its control law: named blocks of doubles as inputs and outputs.

The firmware does not depend on how the step function is compiled. `FloatEngine` runs the source of the law on
Python floats, for unit tests and for reading. Sessions use a compiled engine with the same interface.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, cast


class Block(Protocol):
    """A named vector of an engine."""

    @property
    def name(self) -> str: ...

    @property
    def size(self) -> int: ...


class Engine(Protocol):
    """A step function with fixed memory: write `inputs`, call `run`, read `outputs`.

    Each value is a writable memoryview of format "d" that stays the same for the lifetime of the engine.
    """

    @property
    def inputs(self) -> Mapping[str, memoryview]: ...

    @property
    def outputs(self) -> Mapping[str, memoryview]: ...

    @property
    def run(self) -> Callable[[], None]: ...


def doubles(blocks: Mapping[str, memoryview]) -> Mapping[str, memoryview[float]]:
    """Return the same blocks with the type of their elements."""
    return cast("Mapping[str, memoryview[float]]", blocks)


class FloatEngine:
    """An Engine that evaluates `step(ops, inputs) -> outputs` with the given operations.

    Parameters
    ----------
    step
        Function from a dict of input blocks to a dict of output blocks.
    ops
        Operations of the step, usually `trimtab.firmware_model.law.ops.FLOAT`.
    inputs, outputs
        Blocks of the step.
    """

    def __init__(
        self,
        step: Callable[[Any, dict[str, Sequence[float]]], Mapping[str, Sequence[float]]],
        ops: Any,
        inputs: Sequence[Block],
        outputs: Sequence[Block],
    ) -> None:
        self._step = step
        self._ops = ops
        self.inputs = {block.name: memoryview(array("d", bytes(8 * block.size))) for block in inputs}
        self.outputs = {block.name: memoryview(array("d", bytes(8 * block.size))) for block in outputs}

    def run(self) -> None:
        """Compute one step from the input blocks into the output blocks.

        Raises ValueError if blocks or sizes of the result differ from `outputs`.
        """
        result = self._step(self._ops, {name: tuple(view) for name, view in self.inputs.items()})
        if result.keys() != self.outputs.keys():
            raise ValueError(f"step returned {sorted(result)}, not {sorted(self.outputs)}")
        for name, view in self.outputs.items():
            values = array("d", result[name])
            if len(values) != len(view):
                raise ValueError(f"step returned {len(values)} values for {name}, not {len(view)}")
            view[:] = memoryview(values)
