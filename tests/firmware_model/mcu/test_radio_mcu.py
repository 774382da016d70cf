"""Radio processors: whole messages cross, priorities hold, buffers end, nothing moves without a tick."""

import random

import pytest

from trimtab.firmware_model.mcu.radio_mcu import AIR_BYTES, RadioMcu
from trimtab.firmware_model.mcu.uart import UartPort, connect
from trimtab.protocol import messages as m
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import HOST, HOST_RADIO, VEHICLE
from trimtab.protocol.uwb_pieces import FRAME_BYTES


@pytest.fixture
def radio():
    return RadioMcu()


@pytest.fixture
def line(radio):
    port = UartPort(baud=921_600, rx_bytes=1 << 15, tx_bytes=1 << 15)
    connect(port, radio.uart)
    return port


def ping(codec, k):
    """A message of 26 B."""
    return codec.encode(m.Ping(k, k, 255, 190))


def test_session_without_radio_ticks_passes_no_frame(make_session):
    session = make_session()
    session.radio_ticks = False
    session.run(2.0)
    assert session.inbox == [] or {type(x) for x in session.inbox} == {m.RadioStats}
    assert session.radio.frames_sent == 0
    assert session.flight.flight.poses.used == 0
    session.radio_ticks = True
    session.run(0.5)
    assert session.received(m.FcControl)
    assert session.flight.flight.poses.used > 0


def test_ground_radio_reports_to_the_host_over_its_own_line(make_session):
    session = make_session()
    session.run(2.1)
    senders = {(s.get_srcSystem(), s.get_srcComponent()) for s in session.received(m.RadioStats)}
    assert senders == {HOST_RADIO, m.VEHICLE_RADIO}


def test_frames_hold_whole_messages_and_no_more_than_fit(radio, line):
    codec = Codec(*VEHICLE)
    sent = [ping(codec, k) for k in range(10)]
    line.write(b"".join(sent), 0)
    radio.tick(10_000)
    frames = []
    while (frame := radio.air_send(10_000)) is not None:
        assert len(frame) <= FRAME_BYTES
        frames.append(frame)
    assert b"".join(frames) == b"".join(sent)
    assert radio.frames_sent == len(frames) == 3  # four messages of 26 B a frame


def test_commands_overtake_uploads():
    radio = RadioMcu(address=HOST_RADIO)
    line = UartPort(baud=921_600, rx_bytes=1 << 15, tx_bytes=1 << 15)
    connect(line, radio.uart)
    codec = Codec(*HOST)
    for k in range(5):
        line.write(codec.encode(m.UploadChunk(1, k, 1, bytes(range(99)))), 0)
    command = codec.encode(m.CommandLong(1, 1, 21, 0, 0, 0, 0, 0, 0, 0, 0))
    line.write(command, 0)
    radio.tick(20_000)
    assert radio.air_send(20_000) == command


def test_vehicle_radio_keeps_the_order_of_each_component(radio, line):
    """Fast telemetry has a component of its own and goes ahead; nothing else overtakes."""
    autopilot, fast, private = Codec(*VEHICLE), Codec(*m.VEHICLE_FAST), Codec(*m.VEHICLE_PRIVATE)
    for k in range(6):
        line.write(autopilot.encode(m.FileTransfer(0, 255, 190, bytes([k + 1] * 251))), 0)
        line.write(private.encode(m.UploadVerdict(0.0, 0.0, k, 0, 1, 0, b"")), 0)
        line.write(autopilot.encode(m.CommandAck(400, 0, 0, 0, 255, 190)), 0)
        line.write(fast.encode(m.FcObserver(k, [0.0] * 3)), 0)
    radio.tick(40_000)
    ground = RadioMcu(address=HOST_RADIO)
    connect(host := UartPort(baud=921_600, rx_bytes=1 << 15, tx_bytes=1 << 15), ground.uart)
    now_us = 40_000
    while (frame := radio.air_send(now_us)) is not None:
        ground.air_receive(frame, now_us)
        ground.tick(now_us)
        now_us += 2_000
    received = Codec(*HOST).decode(host.read(10_000_000))
    assert len(received) == 24
    assert {type(message) for message in received[:6]} == {m.FcObserver}
    for address in (VEHICLE, m.VEHICLE_FAST, m.VEHICLE_PRIVATE):
        numbers = [message.get_seq() for message in received if m.sender_of(message) == address]
        assert numbers == list(range(len(numbers)))


def test_duplicate_of_a_frame_is_ignored_and_a_later_repeat_passes(radio, line):
    frame = ping(Codec(*HOST), 1)
    for now_us in (0, 1_000, 10_000):
        radio.air_receive(frame, now_us)
        radio.tick(now_us)
    assert line.read(1_000_000) == frame * 2
    assert radio.frames_received == 2


def test_newer_pose_replaces_the_one_that_waits(radio, line):
    codec = Codec(*HOST)
    poses = [codec.encode(m.AttPosMocap(k, [1.0, 0.0, 0.0, 0.0], 0.1, 0.2, 0.3)) for k in range(1, 4)]
    line.write(b"".join(poses), 0)
    radio.tick(20_000)
    assert radio.air_send(20_000) == poses[-1]
    assert radio.air_send(20_000) is None
    assert radio.packer.replaced == 2


def test_bytes_between_messages_are_counted_and_dropped(radio, line):
    codec = Codec(*VEHICLE)
    message = ping(codec, 1)
    line.write(b"noise" + message + b"\xfd\xff" + message, 0)
    radio.tick(20_000)
    line.write(bytes(300), 20_000)  # what the false header claimed
    radio.tick(40_000)
    assert radio.air_send(40_000) == message + message


def test_serial_buffer_overrun_is_counted_and_messages_after_it_pass(line, radio):
    codec = Codec(*VEHICLE)
    data = b"".join(ping(codec, k) for k in range(300))
    line.write(data, 0)
    radio.tick(200_000)
    assert radio.uart.overruns == len(data) - radio.uart.rx_bytes
    while radio.air_send(200_000) is not None:
        pass
    after = ping(codec, 1_000)
    line.write(after, 200_000)
    radio.tick(300_000)
    assert radio.air_send(300_000) == after


def test_air_buffer_overrun_is_counted_and_frames_after_it_pass(radio, line):
    codec = Codec(*HOST)
    frames = [ping(codec, 1) * 4 for _ in range(20)]
    for frame in frames:
        radio.air_receive(frame, 0)
    frame = frames[-1]
    kept = AIR_BYTES // len(frame)
    assert radio.air_overruns == (20 - kept) * len(frame)
    radio.tick(0)
    assert line.read(1_000_000) == b"".join(frames[:kept])
    radio.air_receive(frame, 1_000_000)
    radio.tick(1_000_000)
    assert line.read(2_000_000) == frame


def test_frames_wait_while_the_line_has_no_room():
    radio = RadioMcu(tx_bytes=120)
    port = UartPort(baud=921_600, rx_bytes=1 << 15, tx_bytes=1 << 15)
    connect(port, radio.uart)
    codec = Codec(*HOST)
    frames = [ping(codec, 1) * 4 for _ in range(3)]
    for frame in frames:
        radio.air_receive(frame, 0)
    radio.tick(0)
    assert radio.due_us == 0
    for k in range(1, 5):
        radio.tick(1_000 * k)
    assert port.read(10_000) == b"".join(frames)


def test_due_names_the_tick_that_has_work(radio, line):
    radio.tick(0)
    assert radio.due_us == 1_000_000  # its own report
    line.write(ping(Codec(*VEHICLE), 1), 0)
    assert radio.due_us == line._busy_until // 921_600 + 1
    assert not radio.tick(radio.due_us - 1)
    assert radio.tick(radio.due_us)


def test_long_messages_cross_whole_and_a_lost_piece_is_reported():
    sender, receiver = RadioMcu(address=HOST_RADIO), RadioMcu()
    far = UartPort(baud=921_600, rx_bytes=1 << 15, tx_bytes=1 << 15)
    connect(line := UartPort(baud=921_600, rx_bytes=1 << 15, tx_bytes=1 << 15), sender.uart)
    connect(far, receiver.uart)
    codec = Codec(*HOST)
    longest = m.mavlink.MAVLink_file_transfer_protocol_message
    sent = [codec.encode(longest(0, 1, 1, [k] * 250 + [255])) for k in range(1, 5)]
    line.write(b"".join(sent), 0)
    sender.tick(50_000)
    frames = []
    while (frame := sender.air_send(50_000)) is not None:
        frames.append(frame)
    assert len(frames) == 12
    assert max(map(len, frames)) == FRAME_BYTES
    for k, frame in enumerate(frames):
        if k != 4:
            receiver.air_receive(frame, 50_000)
            receiver.tick(50_000)
    assert far.read(900_000) == sent[0] + sent[2] + sent[3]
    receiver.tick(1_000_000)
    receiver.tick(2_000_000)
    frame = receiver.air_send(2_000_000)
    assert frame is not None
    reports = codec.decode(frame)
    broken = [report.broken for report in reports if isinstance(report, m.RadioStats)]
    assert (len(reports), broken) == (2, [0, 1])
    assert receiver.frames_received == 11


def test_garbage_from_the_air_neither_ends_nor_blocks_a_radio(radio, line):
    chance, codec = random.Random(4), Codec(*HOST)
    for k in range(3_000):
        start = chance.choice((b"", b"\x02", b"\xfd"))
        radio.air_receive(start + chance.randbytes(chance.randrange(116)), 1_000 * k)
        radio.tick(1_000 * k)
        line.read(1_000 * k)
    message = ping(codec, 1)
    radio.air_receive(message, 4_000_000)
    radio.tick(4_000_000)
    assert line.read(5_000_000).endswith(message)
