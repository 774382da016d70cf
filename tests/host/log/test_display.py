"""What viewers draw: frames, vehicle, paths and the residual's arrow."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from typing import IO, Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from trimtab.host.log import LogWriter, Provenance
from trimtab.host.log.display import PERIOD_US
from trimtab.host.vehicle import Vehicle

LEVEL = (1.0, 0.0, 0.0, 0.0)
Messages = dict[str, list[tuple[int, Any]]]


def written(provenance: Provenance, fill: Callable[[LogWriter], None]) -> Messages:
    """Log times (ns) and messages by topic of a log, as an independent reader decodes them."""
    stream: IO[bytes] = io.BytesIO()
    with LogWriter(stream, provenance) as log:
        fill(log)
    stream.seek(0)
    reader = make_reader(stream, decoder_factories=[DecoderFactory()])
    messages: Messages = {}
    for each in reader.iter_decoded_messages():
        messages.setdefault(each.channel.topic, []).append((each.message.log_time, each.decoded_message))
    return messages


def rotation(q: Any) -> np.ndarray:
    """The matrix of a quaternion with the fields w, x, y, z."""
    w, x, y, z = q.w, q.x, q.y, q.z
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def vector(message: Any) -> np.ndarray:
    return np.array([message.x, message.y, message.z])


def test_frames_place_the_vehicle_in_a_world_with_z_up(provenance: Provenance) -> None:
    turn = math.sqrt(0.5)  # a quarter turn to the right: the nose points east
    messages = written(
        provenance, lambda log: log.display.pose(0, 0, (1.0, 2.0, -3.0), (turn, 0.0, 0.0, turn))
    )
    (_, world), (_, pose) = messages["/display/world"][0], messages["/display/pose"][0]
    assert (world.parent_frame_id, world.child_frame_id) == ("world", "ned")
    assert (pose.parent_frame_id, pose.child_frame_id) == ("ned", "body_frd")
    place = rotation(world.rotation) @ vector(pose.translation) + vector(world.translation)
    np.testing.assert_allclose(place, [2.0, 1.0, 3.0], atol=1e-12)  # east, north, up
    axes = rotation(world.rotation) @ rotation(pose.rotation)
    np.testing.assert_allclose(axes @ [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], atol=1e-12)  # forward: east
    np.testing.assert_allclose(axes @ [0.0, 0.0, -1.0], [0.0, 0.0, 1.0], atol=1e-12)  # up


def test_vehicle_is_drawn_from_its_file_in_the_body_frame(provenance: Provenance, vehicle: Vehicle) -> None:
    messages = written(provenance, lambda log: None)
    ((log_ns, message),) = messages["/display/vehicle"]
    (entity,) = message.entities
    assert (log_ns, entity.frame_id, entity.frame_locked) == (0, "body_frd", True)
    places = [rotor.position_m for rotor in vehicle.rotors]
    np.testing.assert_array_equal([vector(disc.pose.position) for disc in entity.cylinders], places)
    for disc in entity.cylinders:
        assert (disc.color.r > 0.5) == (disc.pose.position.x > 0.0)  # the front is red
        assert 0.05 < disc.size.x < 0.176  # discs do not overlap: rotors are 0.176 m apart
    (arms,) = entity.lines
    np.testing.assert_array_equal([vector(point) for point in arms.points][1::2], places)
    assert [vector(point).tolist() for point in arms.points][::2] == [[0.0, 0.0, 0.0]] * 4


def test_path_holds_the_poses_shown_from_the_begin_of_the_log_on(provenance: Provenance) -> None:
    def fly(log: LogWriter) -> None:
        for t_us in range(0, 1_000_000, 8_000):
            log.display.pose(t_us + 4_000, t_us, (t_us * 1e-6, 0.0, -1.0), LEVEL)

    messages = written(provenance, fly)
    shown = messages["/display/pose"]
    periods = [pose.timestamp.nanos // 1000 // PERIOD_US for _, pose in shown]
    assert periods == list(range(20))
    ((log_ns, path),) = messages["/display/path"]
    assert (log_ns, path.frame_id) == (0, "ned")
    expected = [vector(pose.translation) for _, pose in shown]
    np.testing.assert_array_equal([vector(pose.position) for pose in path.poses], expected)
    assert {pose.orientation.w for pose in path.poses} == {1.0}


def test_pose_from_before_arm_is_neither_shown_nor_on_the_path(provenance: Provenance) -> None:
    messages = written(provenance, lambda log: log.display.pose(3000, -1000, (0.0, 0.0, 0.0), LEVEL))
    assert set(messages) == {"/display/world", "/display/vehicle"}


def test_pose_that_is_wrong_hides_no_other(provenance: Provenance) -> None:
    def fly(log: LogWriter) -> None:
        log.display.pose(0, 0, (0.0, math.nan, 0.0), LEVEL)
        log.display.pose(0, 9_000_000_000, (0.0, 0.0, 0.0), LEVEL)  # stamped in the far future
        log.display.pose(0, 1000, (1.0, 0.0, 0.0), LEVEL)

    messages = written(provenance, fly)
    assert [pose.translation.x for _, pose in messages["/display/pose"]] == [0.0, 1.0]
    assert len(messages["/display/path"][0][1].poses) == 2


def test_log_without_display_topics_has_none(provenance: Provenance) -> None:
    stream = io.BytesIO()
    with LogWriter(stream, provenance, ()) as log:
        log.display.pose(0, 0, (0.0, 0.0, 0.0), LEVEL)
    assert list(make_reader(io.BytesIO(stream.getvalue())).iter_messages()) == []
    assert log.counts() == {}


@pytest.mark.parametrize(
    "residual",
    [
        (1.0, 0.0, 0.0),
        (-2.0, 0.0, 0.0),
        (0.0, 0.3, 0.0),
        (0.1, -0.2, 0.6),
        (-1.0, 1e-7, 0.0),
        (0.0, 0.0, 0.0),
    ],
)
def test_arrow_shows_the_mean_residual(
    provenance: Provenance, vehicle: Vehicle, residual: Sequence[float]
) -> None:
    thrust = -4.0 * vehicle.thrust_max_n * 0.4**2 / vehicle.mass_kg
    near, far = (np.array([*[0.4] * 4, 0, 0, 0, *f]) for f in ([0, 0, thrust], [0, 0, thrust]))
    near[7:] += 0.5 * np.array(residual)
    far[7:] += 1.5 * np.array(residual)

    def fly(log: LogWriter) -> None:
        log.display.residual(0, 0, 10_000, near.tolist())
        for t_us in (30_000, 60_000):
            log.display.residual(t_us, t_us, 10_000, (near if t_us == 30_000 else far).tolist())

    (_, first), (_, message) = written(provenance, fly)["/display/residual"]
    assert first.entities[0].arrows[0].shaft_length == pytest.approx(0.5 * math.hypot(*residual))
    (arrow,) = message.entities[0].arrows
    tip = rotation(arrow.pose.orientation) @ [arrow.shaft_length, 0.0, 0.0]
    np.testing.assert_allclose(tip, residual, atol=1e-6)
    assert message.entities[0].frame_id == "body_frd"
