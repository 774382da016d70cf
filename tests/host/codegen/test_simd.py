"""Vectors of lanes: their width by the compiler's target."""

from __future__ import annotations

import platform
from dataclasses import replace

import pytest

from trimtab.host.codegen import find_compiler
from trimtab.host.codegen.simd import lane_count, simd_library

X86 = platform.machine().lower() in ("x86_64", "amd64")


@pytest.mark.skipif(not X86, reason="the options are those of x86")
@pytest.mark.parametrize(
    ("options", "lanes"),
    [
        (("-mno-avx512f", "-mno-avx"), 2),
        (("-mavx2", "-mno-avx512f"), 4),
        (("-mavx512f",), 8),
    ],
)
def test_width_is_that_of_the_registers_of_the_compilers_target(options, lanes, require):
    require("compiler")
    compiler = find_compiler()
    assert compiler is not None
    other = replace(
        compiler, command=(*compiler.command, *options), identity=f"{compiler.identity} {options}"
    )
    assert lane_count(simd_library("", other)) == lanes
