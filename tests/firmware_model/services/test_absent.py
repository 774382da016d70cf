"""What the vehicle does not have: each request ends at once, with the true reason."""

import pytest

from trimtab.protocol import messages as m
from trimtab.protocol.messages import mavlink

STATION = (245, 190)


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_mission_fence_and_rally_points_are_refused_before_their_first_item(make_line, kind):
    line = make_line()
    line.send(m.MissionCount(1, 1, 3, kind), source=STATION)
    line.run(0.1)
    (ack,) = line.received(m.MissionAck)
    assert (ack.type, ack.mission_type) == (mavlink.MAV_MISSION_UNSUPPORTED, kind)
    assert (ack.target_system, ack.target_component) == STATION


def test_capabilities_name_the_protocol_of_missions_so_that_clients_ask(make_line):
    line = make_line()
    line.command(512, float(m.AutopilotVersion.id))
    line.run(0.1)
    (version,) = line.received(m.AutopilotVersion)
    assert version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT


def test_list_of_logs_is_empty(make_line):
    line = make_line()
    line.send(m.LogRequestList(1, 1, 0, 0xFFFF), source=STATION)
    line.run(0.1)
    (entry,) = line.received(m.LogEntry)
    assert (entry.id, entry.num_logs) == (0, 0)


def test_shell_says_that_there_is_none_and_replies_to_no_reply(make_line):
    line = make_line()
    shell, data = mavlink.SERIAL_CONTROL_DEV_SHELL, list(b"help\n".ljust(70, b"\0"))
    line.send(m.SerialControl(shell, 6, 0, 0, 5, data, 1, 1), source=STATION)
    line.send(m.SerialControl(shell, mavlink.SERIAL_CONTROL_FLAG_REPLY, 0, 0, 5, data, 1, 1), source=STATION)
    line.run(0.1)
    (reply,) = line.received(m.SerialControl)
    assert bytes(reply.data[: reply.count]).startswith(b"no shell")
    assert reply.flags == mavlink.SERIAL_CONTROL_FLAG_REPLY
    assert (reply.target_system, reply.target_component) == STATION
