"""A CasADi SX function over many lanes at once: a sequence of numpy calls without allocation.

A model in `ops` style can also run on numpy arrays directly. Here its SX graph becomes one Python function of
ufunc calls into preallocated rows, with common sub-expressions removed. An operation takes about 0.4 us at a
few hundred lanes, a half to a third of the direct way, and no compiler is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import casadi
import numpy as np

from trimtab.host.codegen import compile_function

FEW = 48
"""Lanes up to which CasADi's virtual machine is faster: about 3 us a lane against 300 us for all."""

_UNARY = {
    casadi.OP_NEG: "negative",
    casadi.OP_EXP: "exp",
    casadi.OP_LOG: "log",
    casadi.OP_SQRT: "sqrt",
    casadi.OP_SQ: "square",
    casadi.OP_SIN: "sin",
    casadi.OP_COS: "cos",
    casadi.OP_TAN: "tan",
    casadi.OP_ASIN: "arcsin",
    casadi.OP_ACOS: "arccos",
    casadi.OP_ATAN: "arctan",
    casadi.OP_FLOOR: "floor",
    casadi.OP_CEIL: "ceil",
    casadi.OP_FABS: "absolute",
    casadi.OP_SIGN: "sign",
    casadi.OP_INV: "reciprocal",
    casadi.OP_SINH: "sinh",
    casadi.OP_COSH: "cosh",
    casadi.OP_TANH: "tanh",
    casadi.OP_NOT: "logical_not",
    casadi.OP_ASSIGN: "positive",
}
_BINARY = {
    casadi.OP_ADD: "add",
    casadi.OP_SUB: "subtract",
    casadi.OP_MUL: "multiply",
    casadi.OP_DIV: "divide",
    casadi.OP_POW: "power",
    casadi.OP_CONSTPOW: "power",
    casadi.OP_FMIN: "minimum",
    casadi.OP_FMAX: "maximum",
    casadi.OP_ATAN2: "arctan2",
    casadi.OP_FMOD: "fmod",
    casadi.OP_COPYSIGN: "copysign",
    casadi.OP_LT: "less",
    casadi.OP_LE: "less_equal",
    casadi.OP_EQ: "equal",
    casadi.OP_NE: "not_equal",
    casadi.OP_AND: "logical_and",
    casadi.OP_OR: "logical_or",
    casadi.OP_IF_ELSE_ZERO: "multiply",  # condition (0 or 1) times value
}


class LaneProgram:
    """A CasADi SX function as a program over lanes; bind it to a number of lanes to run it.

    Every input and output of the function must be a dense column. Raises ValueError otherwise, and for an
    operation numpy has no ufunc for.
    """

    def __init__(self, function: casadi.Function) -> None:
        self.function = function
        names = [function.name_in(i) for i in range(function.n_in())]
        self.inputs = {name: function.size1_in(i) for i, name in enumerate(names)}
        names = [function.name_out(i) for i in range(function.n_out())]
        self.outputs = {name: function.size1_out(i) for i, name in enumerate(names)}
        for i in range(function.n_in()):
            if not function.sparsity_in(i).is_dense() or function.size2_in(i) != 1:
                raise ValueError(f"input {function.name_in(i)} of {function.name()} is not a dense column")
        for i in range(function.n_out()):
            if not function.sparsity_out(i).is_dense() or function.size2_out(i) != 1:
                raise ValueError(f"output {function.name_out(i)} of {function.name()} is not a dense column")
        self._build, self.operations = self._emit()

    def bind(self, lanes: int, *, compiled: bool = False) -> Lanes:
        """Return the program with arrays for `lanes` lanes; `compiled`: in C where a compiler works."""
        if compiled:
            function, kind = compile_function(self.function)
            if kind == "c":
                return Lanes(self, self._build, lanes, function)
        return Lanes(self, self._build, lanes)

    def _emit(self) -> tuple[Callable[..., Callable[[], None]], int]:
        """Return a factory of the bound program, from its source text, and the number of numpy calls."""
        f = self.function
        body: list[str] = []
        constants: list[float] = []
        source_of: dict[int, str] = {}  # work slot -> the row with its current value
        ufuncs: set[str] = set()
        for k in range(f.n_instructions()):
            code = f.instruction_id(k)
            if code == casadi.OP_CONST:
                constants.append(float(f.instruction_constant(k)))
                source_of[f.instruction_output(k)[0]] = f"c{len(constants) - 1}"
            elif code == casadi.OP_INPUT:
                block, row = f.instruction_input(k)
                source_of[f.instruction_output(k)[0]] = f"i{block}_{row}"
            elif code == casadi.OP_OUTPUT:
                block, row = f.instruction_output(k)
                body.append(f"copyto(o{block}_{row}, {source_of[f.instruction_input(k)[0]]})")
            else:
                target = f.instruction_output(k)[0]
                arguments = [source_of[slot] for slot in f.instruction_input(k)]
                if code == casadi.OP_TWICE:
                    name, arguments = "add", arguments * 2
                elif code in _UNARY:
                    name, arguments = _UNARY[code], arguments[:1]
                elif code in _BINARY:
                    name = _BINARY[code]
                else:
                    raise ValueError(f"{f.name()}: operation {code} has no numpy counterpart")
                ufuncs.add(name)
                keyword = "out=" if name in ("minimum", "maximum") else ""  # numpy deprecates it by position
                body.append(f"{name}({', '.join(arguments)}, {keyword}w{target})")
                source_of[target] = f"w{target}"
        rows = [f"    w{slot} = w[{slot}]" for slot in range(f.sz_w())]
        rows += [f"    c{i} = c[{i}]" for i in range(len(constants))]
        for letter, sizes in (("i", self.inputs), ("o", self.outputs)):
            for block, (name, size) in enumerate(sizes.items()):
                rows += [f"    {letter}{block}_{row} = {letter}['{name}'][{row}]" for row in range(size)]
        rows += [f"    {name} = np.{name}" for name in sorted(ufuncs | {"copyto"})]
        lines = ["def build(np, w, c, i, o):", *rows, "    def run():"]
        lines += [f"        {line}" for line in body] or ["        pass"]
        lines.append("    return run")
        namespace: dict[str, Callable[..., Callable[[], None]]] = {}
        exec(compile("\n".join(lines), f"<lanes of {f.name()}>", "exec"), namespace)
        self._constants = constants
        return namespace["build"], len(body)

    @property
    def constants(self) -> list[float]:
        """Constants of the program."""
        return self._constants


class Lanes:
    """A bound program: write `inputs`, call, read `outputs`. The arrays are (rows, lanes) and never move.

    Few lanes run one by one in CasADi's virtual machine, many together in numpy. With a compiled function,
    any number run one by one in C.
    """

    def __init__(
        self,
        program: LaneProgram,
        build: Callable[..., Callable[[], None]],
        lanes: int,
        compiled: casadi.Function | None = None,
    ) -> None:
        if lanes < 1:
            raise ValueError(f"lanes must be at least 1, got {lanes}")
        self.lanes = lanes
        self.inputs: Mapping[str, np.ndarray]
        self.outputs: Mapping[str, np.ndarray]
        if compiled is not None or lanes <= FEW:
            self._one_by_one(compiled or program.function)
        else:
            self._together(program, build)

    def __call__(self) -> None:
        """Compute the outputs from the inputs."""
        self._run()

    def _together(self, program: LaneProgram, build: Callable[..., Callable[[], None]]) -> None:
        lanes = self.lanes
        self.inputs = {name: np.zeros((size, lanes)) for name, size in program.inputs.items()}
        self.outputs = {name: np.zeros((size, lanes)) for name, size in program.outputs.items()}
        work = np.zeros((max(program.function.sz_w(), 1), lanes))
        constants = np.repeat(np.array(program.constants, dtype=float)[:, None], lanes, axis=1)
        self._run = build(np, work, constants, self.inputs, self.outputs)

    def _one_by_one(self, function: casadi.Function) -> None:
        # The trigger holds the addresses of the function, its buffer and the arrays: keep them all.
        self._mapped = function.map(self.lanes)
        self._buffer, self._run = self._mapped.buffer()
        self.inputs, self.outputs = {}, {}
        for i in range(function.n_in()):
            array = np.zeros((self.lanes, function.size1_in(i)))
            self._buffer.set_arg(i, array.reshape(-1).data)  # pyright: ignore[reportCallIssue]
            self.inputs[function.name_in(i)] = array.T
        for i in range(function.n_out()):
            array = np.zeros((self.lanes, function.size1_out(i)))
            self._buffer.set_res(i, array.reshape(-1).data)  # pyright: ignore[reportCallIssue]
            self.outputs[function.name_out(i)] = array.T


def lane_program(function: casadi.Function) -> LaneProgram:
    """Return the lane program of an SX function, after removing common sub-expressions."""
    arguments = function.sx_in()
    outputs = function.call(arguments)
    names_in = [function.name_in(i) for i in range(function.n_in())]
    names_out = [function.name_out(i) for i in range(function.n_out())]
    outputs = [casadi.densify(output) for output in casadi.cse(outputs)]
    return LaneProgram(casadi.Function(function.name(), arguments, outputs, names_in, names_out))
