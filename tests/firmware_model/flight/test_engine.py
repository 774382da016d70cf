"""The float engine: fixed memory, the law's own source, a flight like the compiled law's."""

import pytest

from trimtab.firmware_model.flight.engine import FloatEngine, doubles
from trimtab.firmware_model.law import step as law
from trimtab.firmware_model.law.ops import FLOAT


def test_float_engine_keeps_its_views():
    engine = FloatEngine(law.step, FLOAT, law.INPUTS, law.OUTPUTS)
    before = engine.outputs["motor_command"]
    inputs = doubles(engine.inputs)
    inputs["memory"][6] = 1.0
    inputs["feedforward"][0] = 1.0
    for k in range(len(law.PARAMETERS)):
        inputs["parameters"][k] = 1.0
    engine.run()
    assert engine.outputs["motor_command"] is before
    assert engine.outputs["memory"][6] == pytest.approx(1.0)


def test_float_engine_with_a_step_that_returns_the_wrong_blocks_raises():
    blocks = (law.Block(name="a", size=2),)
    with pytest.raises(ValueError, match="step returned"):
        FloatEngine(lambda ops, x: {"b": (0.0,)}, FLOAT, blocks, blocks).run()
    with pytest.raises(ValueError, match="1 values for a"):
        FloatEngine(lambda ops, x: {"a": (0.0,)}, FLOAT, blocks, blocks).run()


def test_float_and_compiled_law_fly_alike(engine, make_rig):
    floats = FloatEngine(law.step, FLOAT, law.INPUTS, law.OUTPUTS)
    ends = []
    for law_engine in (floats, engine):
        rig = make_rig(engine=law_engine)
        rig.take_off()
        rig.run(1.0)
        ends.append((*rig.body.p, *rig.body.v, *rig.command))
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)
