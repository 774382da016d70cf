"""A compiler that fails: the portable path, one line on stderr, and exit code 0."""

from __future__ import annotations

import numpy as np
import pytest

from trimtab.host.cli import main
from trimtab.host.codegen import compiler as compiler_module
from trimtab.host.learn.adjoint import Rollouts
from trimtab.host.learn.lanes import rollouts
from trimtab.host.models.network import Layout
from trimtab.host.models.phi import Phi
from trimtab.host.vehicle import load_vehicle

PLAN = ["plan", "hover", "--kind", "min-control", "--nodes", "20", "--force", "-o"]


@pytest.fixture(autouse=True)
def failing_compiler(tmp_path, monkeypatch):
    """The only compiler on PATH fails; the cache is empty."""
    program = tmp_path / "bin" / "cc"
    program.parent.mkdir()
    program.write_text('#!/bin/sh\necho "no space left" >&2\nexit 1\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(program.parent))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("TRIMTAB_ENGINE", raising=False)
    monkeypatch.setattr(compiler_module, "_warned", set())


def test_plan_with_a_failing_compiler_succeeds_with_one_line(tmp_path, capsys):
    path = str(tmp_path / "hover.ref")
    assert main([*PLAN, path]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "compiler" in line]
    assert lines == [
        "trimtab: the C compiler cc failed: no space left; continuing without compiled code, slower"
    ]


def test_plan_that_requires_c_ends_with_code_2(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("TRIMTAB_ENGINE", "c")
    assert main([*PLAN, str(tmp_path / "hover.ref")]) == 2
    assert "the C compiler cc failed: no space left" in capsys.readouterr().err


def test_learning_with_a_failing_compiler_is_casadi_with_one_line(capsys):
    phi = Phi(vehicle=load_vehicle("research"), estimator=False)
    for _ in range(2):
        made = rollouts(phi, Layout(hidden=(4,)), np.zeros(0), batch=1, step_s=0.02, weight=np.ones(12))
        assert isinstance(made, Rollouts)
    assert capsys.readouterr().err.count("continuing without compiled code") == 1
