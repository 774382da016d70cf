"""Engines: the same interface and the same bits, by virtual machine and by C, on the law's whole tick."""

from __future__ import annotations

import gc
import os
import pickle
import signal
import subprocess
import sys
from array import array

import casadi as ca
import numpy as np
import pytest

from trimtab.firmware_model.flight.engine import doubles
from trimtab.firmware_model.law import step as law
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.codegen import (
    CodegenError,
    Compiler,
    compile_blocks,
    compile_function,
    function_engine,
    held_interrupts,
    sx_function,
)
from trimtab.host.codegen.engine import Block
from trimtab.host.codegen.libraries import cache_directory
from trimtab.protocol.parameters import DEFAULTS

IN = (Block(name="x", size=2), Block(name="k", size=1))
OUT = (Block(name="sum", size=1), Block(name="scaled", size=2))


def _example(ops, inputs):
    x, (k,) = inputs["x"], inputs["k"]
    return {"scaled": [k * value for value in x], "sum": [x[0] + ops.sin(x[1])]}


@pytest.fixture(params=["vm", "c"])
def kind(request, require):
    """Each engine this machine can run."""
    if request.param == "c":
        require("compiler")
    return request.param


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache in place of the user's."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


def test_engine_reads_and_writes_named_blocks(kind):
    engine = compile_blocks(_example, IN, OUT, "example", engine=kind)
    assert engine.kind == kind
    inputs, scaled = doubles(engine.inputs), engine.outputs["scaled"]
    x, k = inputs["x"], inputs["k"]
    for view in (x, scaled):
        assert (view.format, view.readonly) == ("d", False)
    x[0], x[1], k[0] = 1.0, 0.5, 3.0
    engine.run()
    assert scaled.tolist() == [3.0, 1.5]
    assert engine.outputs["sum"][0] == 1.0 + FLOAT.sin(0.5)
    k[0] = 2.0
    engine.run()
    assert scaled.tolist() == [2.0, 1.0]


def test_engine_outlives_everything_it_was_made_of(kind):
    engine = compile_blocks(_example, IN, OUT, "example", engine=kind)
    gc.collect()
    junk = [compile_blocks(_example, IN, OUT, "example", engine=kind) for _ in range(5)]
    del junk
    gc.collect()
    doubles(engine.inputs)["x"][0] = 2.0
    engine.run()
    assert engine.outputs["sum"][0] == 2.0


def test_ctrl_c_while_casadi_asks_what_it_is_given_is_not_lost():
    class Two:
        def __getattr__(self, name):
            raise AttributeError(name)

        def __SX__(self):  # noqa: N802
            os.kill(os.getpid(), signal.SIGINT)
            return ca.SX(2.0)

    traced = []

    def example(ops, inputs):
        traced.append(inputs["x"][0] + Two())
        return {"scaled": inputs["x"], "sum": traced}

    with pytest.raises(KeyboardInterrupt):
        sx_function(example, IN, OUT, "example")
    assert len(traced) == 1
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_ctrl_c_that_was_held_goes_to_whoever_handled_it_before():
    handled = []
    before = signal.signal(signal.SIGINT, lambda number, frame: handled.append(number))
    try:
        with held_interrupts() as interrupted:
            assert not interrupted()
            os.kill(os.getpid(), signal.SIGINT)
            assert interrupted()
            assert handled == []
        assert handled == [signal.SIGINT]
    finally:
        signal.signal(signal.SIGINT, before)


def _random_inputs(rng):
    """Values of every input block, from gentle to far beyond what saturates."""
    size = 10.0 ** rng.uniform(-2, 1)
    values = {block.name: rng.normal(size=block.size) * size for block in law.INPUTS}
    values["memory"][law.EST_Q] += (1.0, 0.0, 0.0, 0.0)
    values["specific_force"][2] -= 9.81
    values["mocap_q"] /= np.linalg.norm(values["mocap_q"])
    for name in ("mocap_age_s", "mocap_interval_s"):
        values[name] = rng.uniform(0.0, 0.05, 1)
    values["mocap_new"], values["armed"] = rng.integers(0, 2, (2, 1)).astype(float)
    for name in ("piece", "yaw_piece"):
        values[name][0] = rng.uniform(0.0, 0.5)
    values["feedforward"] *= 0.1 / size
    values["feedforward"][0] = rng.uniform(0.8, 1.25)
    values["parameters"] = np.array(law.parameter_vector(DEFAULTS)) * rng.uniform(0.9, 1.1)
    return values


def test_virtual_machine_and_c_agree_bit_for_bit_on_ten_thousand_steps(require):
    require("compiler")
    vm, c = (compile_blocks(law.step, law.INPUTS, law.OUTPUTS, "law", engine=kind) for kind in ("vm", "c"))
    rng = np.random.default_rng(11)
    saturated = 0.0
    for _ in range(10_000):
        for name, value in _random_inputs(rng).items():
            vm.inputs[name][:] = c.inputs[name][:] = array("d", value)
        vm.run()
        c.run()
        for name, view in vm.outputs.items():
            assert bytes(view) == bytes(c.outputs[name]), name
        saturated += vm.outputs["saturated"][0]
    assert 1_000 < saturated < 9_000
    assert np.isfinite(vm.outputs["memory"]).all()


def test_engine_of_the_law_agrees_with_the_float_law(kind):
    engine = compile_blocks(law.step, law.INPUTS, law.OUTPUTS, "law", engine=kind)
    rng = np.random.default_rng(12)
    for _ in range(100):
        values = _random_inputs(rng)
        for name, value in values.items():
            engine.inputs[name][:] = array("d", value)
        engine.run()
        expected = law.step(FLOAT, {name: value.tolist() for name, value in values.items()})
        for name, view in engine.outputs.items():
            scale = max(1.0, *map(abs, expected[name]))
            assert np.allclose(view, expected[name], rtol=0.0, atol=1e-12 * scale)


def test_compiled_library_is_cached_by_content(cache, require):
    require("compiler")
    for factor in (1.0, 1.0, 2.0):
        x = ca.SX.sym("x")
        compile_function(ca.Function("f", [x], [factor * x * x]), engine="c")
    assert len(list(cache_directory().rglob("*.so"))) == 2


def test_without_a_compiler_auto_is_the_virtual_machine_and_c_an_error(monkeypatch):
    monkeypatch.setattr("trimtab.host.codegen.compiler.find_compiler", lambda: None)
    monkeypatch.delenv("TRIMTAB_ENGINE", raising=False)
    assert compile_blocks(_example, IN, OUT, "example").kind == "vm"
    with pytest.raises(CodegenError, match="install cc, gcc, clang or the Python package ziglang"):
        compile_blocks(_example, IN, OUT, "example", engine="c")


def test_with_a_compiler_that_fails_auto_warns_and_is_the_virtual_machine(cache, monkeypatch, capsys):
    broken = Compiler(command=("no-such-compiler",), identity="broken")
    monkeypatch.setattr("trimtab.host.codegen.compiler.find_compiler", lambda: broken)
    monkeypatch.setattr("trimtab.host.codegen.compiler._warned", set())
    engine = compile_blocks(_example, IN, OUT, "example", engine="auto")
    doubles(engine.inputs)["x"][0] = 2.0
    engine.run()
    assert (engine.kind, engine.outputs["sum"][0]) == ("vm", 2.0)
    assert "continuing without compiled code" in capsys.readouterr().err
    with pytest.raises(CodegenError, match="does not run"):
        compile_blocks(_example, IN, OUT, "example", engine="c")


def test_environment_chooses_the_engine(monkeypatch):
    monkeypatch.setenv("TRIMTAB_ENGINE", "vm")
    assert compile_blocks(_example, IN, OUT, "example").kind == "vm"


@pytest.mark.parametrize(
    ("result", "message"),
    [
        (lambda ops, inputs: {"sum": [0.0]}, "returned the blocks"),
        (lambda ops, inputs: {"sum": [0.0], "scaled": [0.0]}, "returned 1 values for scaled, not 2"),
    ],
)
def test_sx_function_of_a_wrong_result_raises_value_error(result, message):
    with pytest.raises(ValueError, match=message):
        sx_function(result, IN, OUT, "example")


def test_sx_function_with_constant_outputs_is_dense():
    function = sx_function(
        lambda ops, inputs: {"sum": [0.0], "scaled": [0, inputs["k"][0]]}, IN, OUT, "example"
    )
    assert [function.nnz_out(k) for k in range(2)] == [1, 2]


def test_function_engine_with_other_sizes_raises_value_error():
    function = sx_function(_example, IN, OUT, "example")
    with pytest.raises(ValueError, match="not the blocks' sizes"):
        function_engine(function, IN[::-1], OUT, engine="vm")


def test_blocks_of_the_same_name_raise_value_error():
    twice = (Block(name="x", size=1), Block(name="x", size=1))
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    with pytest.raises(ValueError, match="twice"):
        function_engine(ca.Function("f", [x, y], [x + y]), twice, (Block(name="s", size=1),), engine="vm")


def test_engine_refuses_to_be_pickled():
    with pytest.raises(TypeError, match="cannot be pickled"):
        pickle.dumps(compile_blocks(_example, IN, OUT, "example", engine="vm"))


def test_engine_is_compiled_in_a_folder_that_the_locale_cannot_decode(tmp_path, require):
    require("compiler")
    code = (
        "import casadi as ca\n"
        "from trimtab.host.codegen import compile_function\n"
        "x = ca.SX.sym('x')\n"
        "double = ca.Function('double_it', [x], [2 * x])\n"
        "compiled, kind = compile_function(double, engine='c')\n"
        "print(kind, compiled(3))\n"
    )
    locale = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    folder = {"XDG_CACHE_HOME": str(tmp_path / "cäche")}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, check=True, env={**os.environ, **locale, **folder}
    )
    assert done.stdout == b"c 6\n"
    assert list((tmp_path / "cäche").rglob("*.so"))
