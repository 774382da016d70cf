"""How the flight MCU calls its law: named blocks of doubles in, named blocks of doubles out.

The firmware neither knows who compiled its step function nor how. `FloatEngine` runs the law's own source on
Python floats: for unit tests and for readers. Sessions hand in a compiled engine, which looks the same.
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
    """A step function with fixed memory: write `inputs`, call, read `outputs`.

    Each value is a writable memoryview of format "d" that stays the same for the engine's life.
    """

    @property
    def inputs(self) -> Mapping[str, memoryview]: ...

    @property
    def outputs(self) -> Mapping[str, memoryview]: ...

    def __call__(self) -> None: ...


def doubles(blocks: Mapping[str, memoryview]) -> Mapping[str, memoryview[float]]:
    """Return the same blocks, seen as what they hold."""
    return cast("Mapping[str, memoryview[float]]", blocks)


class FloatEngine:
    """An Engine that evaluates `step(ops, inputs) -> outputs` with the operations given, value by value.

    Parameters
    ----------
    step
        maps a dict of sequences, one an input block, to a dict of sequences, one an output block.
    ops
        operations the step is evaluated with, `trimtab.firmware_model.law.ops.FLOAT` as a rule.
    inputs, outputs
        blocks of the step.
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

    def __call__(self) -> None:
        """Compute one step from the input blocks into the output blocks.

        Raises ValueError where the step's result has other blocks or sizes than stated.
        """
        result = self._step(self._ops, {name: tuple(view) for name, view in self.inputs.items()})
        if result.keys() != self.outputs.keys():
            raise ValueError(f"step returned {sorted(result)}, not {sorted(self.outputs)}")
        for name, view in self.outputs.items():
            values = array("d", result[name])
            if len(values) != len(view):
                raise ValueError(f"step returned {len(values)} values for {name}, not {len(view)}")
            view[:] = memoryview(values)
