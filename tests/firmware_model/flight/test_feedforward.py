"""The uploaded feed-forward in the engine's inputs."""

from array import array

import pytest

from trimtab.firmware_model.flight.feedforward import FeedForwardInput
from trimtab.protocol.blobs import FeedForward


@pytest.fixture
def views():
    return memoryview(array("d", bytes(8 * 13))), memoryview(array("d", bytes(8 * 3)))


def reference(v):
    return (0.0, 0.0, -1.0, *v, *(0.0,) * 6, 0.0, 0.0)


def test_input_is_neutral_until_something_is_loaded(views):
    given = FeedForwardInput(*views)
    assert list(views[0]) == [1.0, *(0.0,) * 12]
    given.update(reference((1.0, 0.0, 0.0)))
    assert list(views[1]) == [0.0, 0.0, 0.0]


def test_network_acts_along_the_reference_and_can_be_held(views):
    # One hidden unit h = tanh(0.5 v_x), out = (2 h, 0, 0.1): each neuron's weights, then its bias.
    given = FeedForwardInput(*views)
    weights = (0.5, *(0.0,) * 6, 2.0, 0.0, 0.0, 0.0, 0.0, 0.1)
    given.load(FeedForward(vehicle_id="0123456789ab", model_id="00112233aabb", layers=(1,), weights=weights))
    given.update(reference((1.0, 5.0, -5.0)))
    assert list(views[1]) == pytest.approx([2.0 * 0.46211715726, 0.0, 0.1])
    given.hold((0.0, 0.0, -1.0))
    given.update(reference((1.0, 0.0, 0.0)))
    assert list(views[1]) == [0.0, 0.0, -1.0]
    given.resume()
    assert list(views[1]) == [0.0, 0.0, 0.0]
    given.clear()
    given.update(reference((1.0, 0.0, 0.0)))
    assert list(views[1]) == [0.0, 0.0, 0.0]
