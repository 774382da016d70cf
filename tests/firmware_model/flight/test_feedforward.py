"""The uploaded feed-forward in the engine's inputs."""

from array import array

import pytest

from trimtab.firmware_model.flight.engine import doubles
from trimtab.firmware_model.flight.feedforward import FeedForwardInput
from trimtab.firmware_model.law import feedforward as law
from trimtab.firmware_model.law.step import INPUTS, OUTPUTS
from trimtab.protocol.blobs import NEUTRAL_BLOCK, FeedForward, TrainedRegion
from trimtab.protocol.parameters import float32

# One hidden unit h = tanh(0.5 v_x), out = (2 h, 0, 0.1): each neuron's weights, then its bias.
WORLD = (0.5, *(0.0,) * 6, 2.0, 0.0, 0.0, 0.0, 0.0, 0.1)
BODY = (0.5, *(0.0,) * 3, 2.0, 0.0, 0.0, 0.0, 0.0, 0.1)
H = 0.46211715726  # tanh(0.5)
REGION = TrainedRegion(4.0, 0.5, 7.0, 13.0)


def views(blocks):
    return doubles({block.name: memoryview(array("d", bytes(8 * block.size))) for block in blocks})


class Board:
    def __init__(self):
        self.inputs, self.outputs = views(INPUTS), views(OUTPUTS)
        self.outputs["ff_weight"][0] = 1.0
        self.feedforward = FeedForwardInput(self.inputs, self.outputs)

    def fly(self, *, v=(1.0, 0.0, 0.0), a=(0.0, 0.0, 0.0), yaw=0.0, voltage_ratio=1.0):
        reference = (0.0, 0.0, -1.0, *v, *a, 0.0, 0.0, 0.0, yaw, 0.0)
        self.outputs["reference"][:] = memoryview(array("d", reference))
        return self.feedforward.update(voltage_ratio)

    def block(self, name):
        return self.inputs[name].tolist()


@pytest.fixture
def board():
    return Board()


def blob(**fields):
    return FeedForward(vehicle_id="0123456789ab", model_id="00112233aabb", **fields)


def test_input_is_neutral_until_something_is_loaded(board):
    board.fly()
    assert tuple(board.block("feedforward")) == law.NEUTRAL
    assert board.block("ff_accel_ned") == board.block("ff_jerk_ned") == [0.0, 0.0, 0.0]


def test_network_acts_along_the_reference_and_can_be_held(board):
    board.feedforward.load(blob(layers=(1,), weights=WORLD, region=REGION))
    board.fly(v=(1.0, 5.0, -5.0))
    assert board.block("ff_accel_ned") == pytest.approx([2.0 * H, 0.0, 0.1])
    assert tuple(board.block("feedforward")[law.REGION]) == REGION
    board.feedforward.hold((0.0, 0.0, -1.0))
    board.fly()
    assert board.block("ff_accel_ned") == [0.0, 0.0, -1.0]
    assert tuple(board.block("feedforward")[law.REGION]) == law.OPEN_REGION
    board.feedforward.resume()
    assert board.block("ff_accel_ned") == [0.0, 0.0, 0.0]
    assert tuple(board.block("feedforward")[law.REGION]) == REGION
    board.feedforward.clear()
    board.fly()
    assert board.block("ff_accel_ned") == [0.0, 0.0, 0.0]
    assert tuple(board.block("feedforward")) == law.NEUTRAL


def test_network_of_the_body_frame_turns_with_the_heading(board):
    board.feedforward.load(blob(layers=(1,), weights=BODY, frame="body"))
    board.fly(v=(0.0, 1.0, 0.0), yaw=0.5 * 3.141592653589793)
    assert board.block("ff_accel_ned") == pytest.approx([0.0, 2.0 * H, 0.1])


def test_version_2_feeds_the_derivative_forward_and_version_1_does_not(board):
    # In forward acceleration v_x changes by a_x, and the vehicle pitches at constant attitude.
    slope = 2.0 * (1.0 - H * H) * 0.5
    board.feedforward.load(blob(layers=(1,), weights=WORLD))
    board.fly(a=(3.0, 0.0, 0.0))
    assert board.block("ff_jerk_ned") == pytest.approx([3.0 * slope, 0.0, 0.0])
    board.feedforward.load(blob(layers=(1,), weights=WORLD, version=1))
    board.fly(a=(3.0, 0.0, 0.0))
    assert board.block("ff_jerk_ned") == [0.0, 0.0, 0.0]


def test_gain_follows_the_battery_voltage(board):
    board.feedforward.load(blob(block=(0.9, *NEUTRAL_BLOCK[1:16], 2.0)))
    gain = float32(0.9)
    for ratio, expected in ((1.0, gain), (0.9, 0.81 * gain), (0.0, 0.81 * gain), (float("nan"), 0.81 * gain)):
        board.fly(voltage_ratio=ratio)
        assert board.block("feedforward")[law.GAIN] == pytest.approx(expected)
    board.fly(voltage_ratio=0.1)
    assert board.block("feedforward")[law.GAIN] == pytest.approx(gain * law.VOLTAGE_RATIO[0] ** 2)


def test_update_reports_the_first_fading_of_a_flight(board):
    board.feedforward.load(blob(block=NEUTRAL_BLOCK, region=REGION))
    assert not board.fly()
    board.outputs["ff_weight"][0] = 0.4
    assert board.feedforward.weight == 0.4
    assert board.fly()
    assert not board.fly()
    board.feedforward.resume()
    assert board.fly()
