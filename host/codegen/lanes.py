"""CasADi SX functions as C over SIMD lanes, which follows `trimtab.host.codegen.simd.PRELUDE`.

The C keeps the order of the graph, with two exceptions. A quotient by a number, by a value that stays
constant, or by a value that divides more than once is a product with its reciprocal: a division takes ten
times as long. What depends only on inputs that stay constant over many calls is computed once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

_UNARY = {
    ca.OP_NEG: "-{0}",
    ca.OP_EXP: "vexp({0})",
    ca.OP_LOG: "vlog({0})",
    ca.OP_SQRT: "vsqrt({0})",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_SIN: "vsin({0})",
    ca.OP_COS: "vcos({0})",
    ca.OP_TAN: "vtan({0})",
    ca.OP_ASIN: "vasin({0})",
    ca.OP_ACOS: "vacos({0})",
    ca.OP_ATAN: "vatan({0})",
    ca.OP_SINH: "vsinh({0})",
    ca.OP_COSH: "vcosh({0})",
    ca.OP_TANH: "vtanh({0})",
    ca.OP_FLOOR: "vfloor({0})",
    ca.OP_CEIL: "vceil({0})",
    ca.OP_FABS: "vabs({0})",
    ca.OP_SIGN: "vsign({0})",
    ca.OP_NOT: "truth({0} == 0.0)",
    ca.OP_ASSIGN: "{0}",
}
_BINARY = {
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_POW: "vpow({0}, {1})",
    ca.OP_CONSTPOW: "vpow({0}, {1})",
    ca.OP_FMIN: "vmin({0}, {1})",
    ca.OP_FMAX: "vmax({0}, {1})",
    ca.OP_ATAN2: "vatan2({0}, {1})",
    ca.OP_FMOD: "vfmod({0}, {1})",
    ca.OP_COPYSIGN: "vcopysign({0}, {1})",
    ca.OP_LT: "truth({0} < {1})",
    ca.OP_LE: "truth({0} <= {1})",
    ca.OP_EQ: "truth({0} == {1})",
    ca.OP_NE: "truth({0} != {1})",
    ca.OP_AND: "truth(({0} != 0.0) & ({1} != 0.0))",
    ca.OP_OR: "truth(({0} != 0.0) | ({1} != 0.0))",
    ca.OP_IF_ELSE_ZERO: "choose({0} != 0.0, {1}, splat(0.0))",
}


@dataclass(frozen=True, kw_only=True)
class _Value:
    """A value of a program, in the order of computation.

    code: operation. arguments: places of its arguments. text: C of an input. number: of a constant. fixed:
    whether it depends on constants and constant inputs alone.
    """

    code: int
    arguments: tuple[int, ...] = ()
    text: str = ""
    number: float = 0.0
    fixed: bool = True

    @property
    def read(self) -> bool:
        """Whether it takes no computation: a constant or an input."""
        return self.code in (ca.OP_CONST, ca.OP_INPUT)

    def c(self, name_of: Mapping[int, str]) -> str:
        """Return the C, with names of the arguments."""
        if self.code == ca.OP_CONST:
            return f"splat({_number(self.number)})"
        if self.code == ca.OP_INPUT:
            return self.text
        form = _UNARY.get(self.code) or _BINARY[self.code]
        return form.format(*(name_of[place] for place in self.arguments))


def lane_source(function: ca.Function, name: str, constant: Sequence[str] = ()) -> str:
    """Return C of `name`(const V *input..., V *output...), with a pointer for each dense column.

    Raises ValueError for an operation without a counterpart.

    Parameters
    ----------
    function
        SX function.
    name
        Name of the function in C.
    constant
        Inputs that stay constant over many calls. With any, `name` has one more argument, const V *constants,
        which `name`_constants(const V *constant input..., V *constants) computes. There are NAME_CONSTANTS.
    """
    fixed_inputs = sorted(function.index_in(each) for each in constant)
    values, outputs = _program(function, fixed_inputs)
    ins = [f"const V *i{k}" for k in range(function.n_in())]
    outs = [f"V *o{k}" for k in range(function.n_out())]
    results = [(f"o{block}[{row}]", place) for block, row, place in outputs]
    if not constant:
        return _c_function(name, [*ins, *outs], values, {}, results)
    used = {place for value in values if not value.fixed for place in value.arguments}
    used |= {place for _, place in results}
    once = sorted(place for place in used if values[place].fixed and not values[place].read)
    stored = [(f"constants[{index}]", place) for index, place in enumerate(once)]
    return "".join(
        [
            f"#define {name.upper()}_CONSTANTS {max(1, len(once))}\n",
            _c_function(
                f"{name}_constants", [*(ins[k] for k in fixed_inputs), "V *constants"], values, {}, stored
            ),
            _c_function(
                name,
                [*ins, *outs, "const V *constants"],
                values,
                {place: text for text, place in stored},
                results,
            ),
        ]
    )


def _program(
    function: ca.Function, fixed_inputs: Sequence[int]
) -> tuple[list[_Value], list[tuple[int, int, int]]]:
    """Return the values of a function, and (output, row, place of its value)."""
    values: list[_Value] = []
    outputs: list[tuple[int, int, int]] = []
    place_of: dict[int, int] = {}  # work slot -> place of its current value
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        if code == ca.OP_OUTPUT:
            block, row = function.instruction_output(k)
            outputs.append((block, row, place_of[function.instruction_input(k)[0]]))
            continue
        if code == ca.OP_CONST:
            value = _Value(code=code, number=function.instruction_constant(k))
        elif code == ca.OP_INPUT:
            block, row = function.instruction_input(k)
            value = _Value(code=code, text=f"i{block}[{row}]", fixed=block in fixed_inputs)
        elif code in _UNARY or code in _BINARY:
            arguments = tuple(place_of[slot] for slot in function.instruction_input(k))
            value = _Value(
                code=code, arguments=arguments, fixed=all(values[place].fixed for place in arguments)
            )
        else:
            raise ValueError(f"{function.name()}: operation {code} has no counterpart over lanes")
        place_of[function.instruction_output(k)[0]] = len(values)
        values.append(value)
    return _with_reciprocals(values, outputs)


def _with_reciprocals(
    values: Sequence[_Value], outputs: Sequence[tuple[int, int, int]]
) -> tuple[list[_Value], list[tuple[int, int, int]]]:
    """Return the program with products in place of quotients by fixed values and by values that recur."""
    divisors = Counter(value.arguments[-1] for value in values if value.code in (ca.OP_DIV, ca.OP_INV))
    inverted = {place for place, count in divisors.items() if count > 1 or values[place].fixed}
    result: list[_Value] = []
    moved: list[int] = []  # place of each value in `result`
    reciprocal: dict[int, int] = {}
    for value in values:
        divisor = value.arguments[-1] if value.code in (ca.OP_DIV, ca.OP_INV) else None
        if divisor in inverted and divisor not in reciprocal:
            reciprocal[divisor] = len(result)
            result.append(_reciprocal(values[divisor], moved[divisor]))
        arguments = tuple(moved[place] for place in value.arguments)
        if divisor in inverted and value.code == ca.OP_INV:
            moved.append(reciprocal[divisor])
            continue
        code = value.code
        if divisor in inverted:
            code, arguments = ca.OP_MUL, (arguments[0], reciprocal[divisor])
        moved.append(len(result))
        result.append(replace(value, code=code, arguments=arguments))
    return result, [(block, row, moved[place]) for block, row, place in outputs]


def _reciprocal(value: _Value, place: int) -> _Value:
    if value.code == ca.OP_CONST and value.number:
        return replace(value, number=1.0 / value.number)
    return _Value(code=ca.OP_INV, arguments=(place,), fixed=value.fixed)


def _c_function(
    name: str,
    arguments: Sequence[str],
    values: Sequence[_Value],
    known: Mapping[int, str],
    results: Sequence[tuple[str, int]],
) -> str:
    """Return the C function that computes results, (C of the result, place of its value).

    known: C of values that are not computed here.
    """
    needed = {place for _, place in results} - set(known)
    for place in range(len(values) - 1, -1, -1):
        if place in needed:
            needed |= set(values[place].arguments) - set(known)
    names = {**{place: f"v{place}" for place in needed}, **known}
    lines = [f"    const V v{place} = {values[place].c(names)};" for place in sorted(needed)]
    lines += [f"    {text} = {names[place]};" for text, place in results]
    return "\n".join([f"INLINE void {name}({', '.join(arguments)}) {{", *lines, "}"]) + "\n"


def _number(value: float) -> str:
    return (
        repr(value) if np.isfinite(value) else f"({value})".replace("inf", "INFINITY").replace("nan", "NAN")
    )
