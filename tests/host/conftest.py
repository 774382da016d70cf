"""Compilers for other machines than this one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from trimtab.host.codegen import Compiler, find_compiler


@pytest.fixture(scope="session")
def compiler_of_width(require: Callable[[str], None]) -> Callable[[int], Compiler]:
    """The compiler with as many lanes in a vector as one asks for, instead of its target's."""
    require("compiler")

    def narrowed(lanes: int) -> Compiler:
        compiler = find_compiler()
        assert compiler is not None
        option = f"-DLANES={lanes}"
        return replace(
            compiler, command=(*compiler.command, option), identity=f"{compiler.identity} {option}"
        )

    return narrowed
