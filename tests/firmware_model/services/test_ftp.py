"""Files over MAVLink FTP: the rules that stock clients rely on, and what becomes of what they write."""

import random
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from trimtab.firmware_model.flight.supervisor import State
from trimtab.firmware_model.services.files import BlobFiles
from trimtab.firmware_model.services.ftp import IDLE_US, SESSIONS_MAX, FtpServer
from trimtab.firmware_model.storage.store import ReferenceStore
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Kind
from trimtab.protocol.ftp import DATA_BYTES, Error, Opcode, Packet, crc32
from trimtab.protocol.messages import UploadState
from trimtab.protocol.upload import UploadReceiver, UploadSender, Verdict

STATION, OTHER = (245, 190), (255, 230)
LIVE = bytes(range(256)) * 9
STAGED = "/ref/staged.ref"


class Server:
    """An FtpServer over a store that checks nothing, and clients that count their requests."""

    def __init__(self, verdict=None):
        self.store = ReferenceStore()
        self.store.stage(Kind.REFERENCE, LIVE)
        self.store.commit(Kind.REFERENCE)
        self.upload = UploadReceiver(
            self.store,
            check=lambda kind, blob: verdict or Verdict(ok=True),
            may_commit=lambda kind: True,
            capacity=self.store.blob_bytes_max,
        )
        self.texts, self.events, self.sent = [], [], []
        files = BlobFiles(
            store=self.store,
            upload=self.upload,
            text=lambda severity, text: self.texts.append(text),
            on_upload=lambda events, now_us: self.events.extend(events),
            least_bytes=len,
        )
        self.writers: set[tuple[int, int]] | None = None  # None: everybody
        self.server = FtpServer(files, send=self.sent.append, may_write=self._may_write)
        self.now_us = 0
        self.number = 100

    def _may_write(self, station):
        return self.writers is None or station in self.writers

    def ask(self, opcode, *, source=STATION, session=0, size=None, offset=0, data=b"", number=None):
        """The answers that come at once."""
        if number is None:
            self.number = number = self.number + 1
        size = len(data) if size is None else size
        asked = Packet(number=number, session=session, opcode=opcode, size=size, offset=offset, data=data)
        message = m.FileTransfer(0, 1, 1, asked.encode())
        message._header.srcSystem, message._header.srcComponent = source
        self.sent.clear()
        self.server.receive(message, self.now_us)
        return self.answers(source)

    def answers(self, source=STATION):
        assert all((a.target_system, a.target_component) == source for a in self.sent)
        return [Packet.decode(answer.payload) for answer in self.sent]

    def one(self, opcode, **keywords):
        (answer,) = self.ask(opcode, **keywords)
        assert answer.request == opcode
        return answer

    def put(self, blob, *, path=STAGED, size=DATA_BYTES, leave_out=(), **keywords):
        """The answer to the end of writing a whole file."""
        assert self.one(Opcode.CREATE_FILE, data=path.encode(), **keywords).opcode == Opcode.ACK
        for offset in range(0, len(blob), size):
            if offset not in leave_out:
                part = blob[offset : offset + size]
                got = self.one(Opcode.WRITE_FILE, offset=offset, data=part, **keywords)
                assert got.opcode == Opcode.ACK
        return self.one(Opcode.TERMINATE_SESSION, **keywords)

    def get(self, path, *, size=DATA_BYTES, **keywords):
        opened = self.one(Opcode.OPEN_FILE_RO, data=path.encode(), **keywords)
        assert opened.opcode == Opcode.ACK
        data = b""
        while True:
            got = self.one(Opcode.READ_FILE, offset=len(data), size=size, **keywords)
            if got.opcode == Opcode.NAK:
                assert got.data[0] == Error.EOF
                assert int.from_bytes(opened.data, "little") == len(data)
                assert self.one(Opcode.TERMINATE_SESSION, **keywords).opcode == Opcode.ACK
                return data
            data += got.data

    def looks(self, count):
        self.sent.clear()
        for _ in range(count):
            self.now_us += 10_000
            self.server.update(self.now_us)


def nak(answer, error):
    return answer.opcode == Opcode.NAK and answer.data == bytes([error])


# The rules.


def test_answers_carry_the_next_number_the_session_and_the_offset_of_their_request():
    server = Server()
    opened = server.one(Opcode.OPEN_FILE_RO, data=b"/ref/live.ref", session=77, number=65_535)
    assert (opened.number, opened.session) == (0, 77)
    read = server.one(Opcode.READ_FILE, session=77, offset=100, size=50, number=5)
    assert (read.number, read.session, read.offset, read.data) == (6, 77, 100, LIVE[100:150])
    end = server.one(Opcode.READ_FILE, session=77, offset=len(LIVE), size=50, number=6)
    assert nak(end, Error.EOF)
    assert (end.number, end.session, end.offset) == (7, 77, len(LIVE))


def test_burst_counts_its_packets_honours_the_size_and_ends_with_a_mark():
    server = Server()
    server.one(Opcode.OPEN_FILE_RO, data=b"/ref/live.ref", session=3)
    assert server.ask(Opcode.BURST_READ_FILE, session=3, size=100, offset=200, number=40) == []
    server.looks(200)
    packets = server.answers()
    assert [p.number for p in packets] == list(range(41, 41 + len(packets)))
    assert all(p.request == Opcode.BURST_READ_FILE for p in packets)
    assert {len(p.data) for p in packets[:-1]} == {100}
    assert b"".join(p.data for p in packets) == LIVE[200:]
    assert [p.burst_complete for p in packets] == [False] * (len(packets) - 1) + [True]
    assert nak(server.one(Opcode.BURST_READ_FILE, session=3, size=100, offset=len(LIVE)), Error.EOF)


def test_burst_keeps_its_pace_and_any_other_request_ends_it():
    server = Server()
    server.one(Opcode.OPEN_FILE_RO, data=b"/ref/live.ref")
    server.ask(Opcode.BURST_READ_FILE, size=239)
    server.looks(10)
    assert 3 <= len(server.sent) <= 6
    server.one(Opcode.READ_FILE, offset=0, size=10)
    server.looks(10)
    assert server.sent == []


def test_repeated_request_gets_its_answer_again_and_is_not_done_twice():
    server = Server()
    first = server.one(Opcode.CREATE_FILE, data=STAGED.encode(), number=1)
    server.one(Opcode.WRITE_FILE, data=LIVE[:100], number=2)
    assert server.one(Opcode.CREATE_FILE, data=STAGED.encode(), number=1) == first
    server.one(Opcode.WRITE_FILE, data=LIVE[100:150], offset=100, number=3)
    closed = server.one(Opcode.TERMINATE_SESSION, number=4)
    assert closed.opcode == Opcode.ACK
    assert server.one(Opcode.TERMINATE_SESSION, number=4) == closed
    assert server.store.staged(Kind.REFERENCE) == LIVE[:150]
    assert nak(server.one(Opcode.TERMINATE_SESSION, number=5), Error.INVALID_SESSION)


def test_refusal_is_told_again_to_the_same_request():
    server = Server(Verdict(ok=False, node=3, reason=7, message="too fast"))
    server.put(LIVE[:300])
    texts = list(server.texts)
    assert nak(server.one(Opcode.TERMINATE_SESSION, number=server.number), Error.FAIL)
    assert server.texts == texts == ["staged.ref refused at node 3:", "too fast"]


def test_restarted_client_that_counts_from_the_start_again_is_not_taken_for_an_echo():
    server = Server()
    for _ in range(2):
        server.one(Opcode.RESET_SESSIONS, number=0)
        server.one(Opcode.CREATE_FILE, data=STAGED.encode(), number=1)
        assert server.one(Opcode.WRITE_FILE, data=LIVE[:9], number=2).opcode == Opcode.ACK


# Files.


@pytest.mark.parametrize("size", [80, 89, 239])
def test_live_file_reads_back_byte_by_byte(size):
    assert Server().get("/ref/live.ref", size=size) == LIVE


def test_folders_are_listed_and_their_end_is_told():
    server = Server()
    assert server.one(Opcode.LIST_DIRECTORY, data=b"/").data == b"Dref\0Dff\0"
    assert server.one(Opcode.LIST_DIRECTORY, data=b"").data == b"Dref\0Dff\0"
    assert server.one(Opcode.LIST_DIRECTORY, data=b"/ref/").data == b"Flive.ref\t2304\0"
    assert server.put(LIVE[:500]).opcode == Opcode.ACK
    assert server.one(Opcode.LIST_DIRECTORY, data=b"ref").data == b"Flive.ref\t2304\0Fstaged.ref\t500\0"
    assert server.one(Opcode.LIST_DIRECTORY, data=b"ref", offset=1).data == b"Fstaged.ref\t500\0"
    assert nak(server.one(Opcode.LIST_DIRECTORY, data=b"ref", offset=2), Error.EOF)
    assert nak(server.one(Opcode.LIST_DIRECTORY, data=b"/ff"), Error.EOF)
    assert nak(server.one(Opcode.LIST_DIRECTORY, data=b"/etc"), Error.FILE_NOT_FOUND)


@pytest.mark.parametrize("path", [b"@PARAM/param.pck", b"/param.pck", b"/ff/live.ff", b"\xff\xfe", b""])
def test_what_is_not_there_is_not_found(path):
    server = Server()
    for opcode in (Opcode.OPEN_FILE_RO, Opcode.CALC_FILE_CRC32):
        assert nak(server.one(opcode, data=path), Error.FILE_NOT_FOUND)


def test_checksum_is_that_of_the_bytes_on_board():
    answer = Server().one(Opcode.CALC_FILE_CRC32, data=b"/ref/live.ref")
    assert int.from_bytes(answer.data, "little") == crc32(LIVE)


@pytest.mark.parametrize("opcode", [9, 10, 11, 12, 13, 16, 77, 200])
def test_unknown_operation_is_refused(opcode):
    assert nak(Server().one(opcode), Error.UNKNOWN_COMMAND)


@pytest.mark.parametrize("path", [b"/ref/live.ref", b"/ref/other.ref", b"/staged.ref", b"@PARAM/param.pck"])
def test_only_staged_files_can_be_written(path):
    assert nak(Server().one(Opcode.CREATE_FILE, data=path), Error.FILE_PROTECTED)


def test_file_that_was_written_is_staged_and_read_back():
    server = Server()
    blob = bytes(reversed(LIVE))
    assert server.put(blob).opcode == Opcode.ACK
    assert server.store.staged(Kind.REFERENCE) == blob
    assert server.store.live(Kind.REFERENCE) == LIVE
    assert server.get(STAGED) == blob
    server.now_us += 10 * IDLE_US
    assert server.upload.advance(server.now_us) == []  # it waits for its commit
    assert server.upload.next_deadline_us() in (0, None)


def test_parts_may_arrive_in_any_order_and_twice():
    server = Server()
    blob = random.Random(4).randbytes(1000)
    offsets = [*range(0, 1000, 100), 0, 500]
    random.Random(5).shuffle(offsets)
    server.one(Opcode.CREATE_FILE, data=STAGED.encode())
    for offset in offsets:
        server.one(Opcode.WRITE_FILE, offset=offset, data=blob[offset : offset + 100])
    assert server.one(Opcode.TERMINATE_SESSION).opcode == Opcode.ACK
    assert server.store.staged(Kind.REFERENCE) == blob


def test_what_is_live_already_is_accepted_and_not_staged():
    server = Server()
    assert server.put(LIVE).opcode == Opcode.ACK
    assert server.store.staged(Kind.REFERENCE) is None


def test_file_with_a_hole_leaves_nothing_and_says_so():
    server = Server()
    assert nak(server.put(LIVE, size=200, leave_out=(400,)), Error.FAIL)
    assert server.store.staged(Kind.REFERENCE) is None
    assert server.texts == ["staged.ref refused: 200 of 2304 bytes missing"]


def test_empty_file_is_refused_with_a_text_and_leaves_what_was_staged():
    server = Server()
    for data in (b"staged", b""):
        server.ask(Opcode.CREATE_FILE, data=STAGED.encode())
        if data:
            server.ask(Opcode.WRITE_FILE, data=data)
        (answer,) = server.ask(Opcode.TERMINATE_SESSION)
    assert (answer.opcode, answer.data[0]) == (Opcode.NAK, Error.FAIL)
    assert server.texts[-1] == "staged.ref refused: empty"
    assert server.store.staged(Kind.REFERENCE) == b"staged"


def test_file_that_is_too_large_is_refused_while_it_is_written():
    server = Server()
    server.one(Opcode.CREATE_FILE, data=STAGED.encode())
    most = server.store.blob_bytes_max
    assert nak(server.one(Opcode.WRITE_FILE, offset=most, data=b"x"), Error.INVALID_DATA_SIZE)
    assert nak(server.one(Opcode.WRITE_FILE, offset=0xFFFF_FFFF, data=b"x"), Error.INVALID_DATA_SIZE)
    assert server.one(Opcode.WRITE_FILE, offset=most - 1, data=b"x").opcode == Opcode.ACK


def test_station_that_may_not_write_reads_and_changes_nothing():
    server = Server()
    assert server.put(LIVE, session=3).opcode == Opcode.ACK
    server.one(Opcode.CREATE_FILE, data=STAGED.encode(), session=5)
    server.writers = set()
    assert server.get("/ref/live.ref") == LIVE
    assert nak(server.one(Opcode.CREATE_FILE, data=STAGED.encode(), session=4), Error.FILE_PROTECTED)
    assert nak(server.one(Opcode.REMOVE_FILE, data=STAGED.encode()), Error.FILE_PROTECTED)
    assert nak(server.one(Opcode.TERMINATE_SESSION, session=5), Error.FILE_PROTECTED)
    server.writers = {STATION}
    assert server.put(LIVE, session=4).opcode == Opcode.ACK


def test_file_that_was_refused_leaves_nothing():
    server = Server(Verdict(ok=False, message="no"))
    assert nak(server.put(LIVE[:300]), Error.FAIL)
    assert server.store.staged(Kind.REFERENCE) is None
    assert server.store.live(Kind.REFERENCE) == LIVE
    assert server.upload.state is UploadState.IDLE


def test_writing_while_an_upload_runs_is_refused_and_does_not_mix():
    server = Server()
    sender = UploadSender(bytes(5000), Kind.REFERENCE)
    for message in sender.send(0):
        server.upload.receive(message, 0)
    assert nak(server.put(LIVE[:300]), Error.FAIL)
    assert server.texts == ["staged.ref refused: an upload or a swap is in progress"]
    assert server.upload.state is UploadState.RECEIVING
    assert server.upload.held == 0


def test_upload_begun_while_a_file_is_written_is_not_disturbed():
    server = Server()
    server.one(Opcode.CREATE_FILE, data=STAGED.encode())
    server.one(Opcode.WRITE_FILE, data=LIVE[:200])
    sender = UploadSender(bytes(150), Kind.REFERENCE, commit=False)
    for _ in range(20):
        for message in sender.send(server.now_us):
            server.upload.receive(message, server.now_us)
        server.now_us += 10_000
        for answer in server.upload.send(server.now_us):
            sender.receive(answer, server.now_us)
    assert server.store.staged(Kind.REFERENCE) == bytes(150)


def test_staged_file_can_be_removed_and_nothing_else():
    server = Server()
    assert nak(server.one(Opcode.REMOVE_FILE, data=STAGED.encode()), Error.FILE_NOT_FOUND)
    assert nak(server.one(Opcode.REMOVE_FILE, data=b"/ref/live.ref"), Error.FILE_PROTECTED)
    assert nak(server.one(Opcode.REMOVE_FILE, data=b"/x"), Error.FILE_NOT_FOUND)
    server.put(LIVE[:10])
    assert server.one(Opcode.REMOVE_FILE, data=STAGED.encode()).opcode == Opcode.ACK
    assert server.store.staged(Kind.REFERENCE) is None
    assert server.upload.staged() == (0, bytes(6))


# Sessions.


def test_two_stations_read_and_write_at_the_same_time():
    server = Server()
    for source in (STATION, OTHER):
        server.one(Opcode.OPEN_FILE_RO, data=b"/ref/live.ref", source=source)
    server.ask(Opcode.BURST_READ_FILE, size=200, source=STATION)
    server.ask(Opcode.BURST_READ_FILE, size=100, source=OTHER)
    heard = {STATION: b"", OTHER: b""}
    for _ in range(400):
        server.looks(1)
        for message in server.sent:
            source = (message.target_system, message.target_component)
            heard[source] += Packet.decode(message.payload).data
    assert heard == {STATION: LIVE, OTHER: LIVE}
    server.one(Opcode.CREATE_FILE, data=STAGED.encode(), source=OTHER)
    server.one(Opcode.RESET_SESSIONS, source=STATION)
    assert server.one(Opcode.WRITE_FILE, data=b"ab", source=OTHER).opcode == Opcode.ACK
    assert nak(server.one(Opcode.READ_FILE, size=9, source=STATION), Error.INVALID_SESSION)


def test_sessions_are_limited_and_end_when_nobody_uses_them():
    server = Server()
    for session in range(SESSIONS_MAX):
        assert server.one(Opcode.OPEN_FILE_RO, data=b"/ref/live.ref", session=session).opcode == Opcode.ACK
    for opcode, path in ((Opcode.OPEN_FILE_RO, b"/ref/live.ref"), (Opcode.CREATE_FILE, STAGED.encode())):
        assert nak(server.one(opcode, data=path, session=99), Error.NO_SESSIONS_AVAILABLE)
    server.now_us += IDLE_US
    server.looks(1)
    assert server.one(Opcode.OPEN_FILE_RO, data=b"/ref/live.ref", session=99).opcode == Opcode.ACK
    assert nak(server.one(Opcode.READ_FILE, size=9, session=0), Error.INVALID_SESSION)


def test_session_reads_what_was_live_when_it_was_opened():
    server = Server()
    server.one(Opcode.OPEN_FILE_RO, data=b"/ref/live.ref")
    server.put(b"x" * 50, session=1)
    server.upload.commit(server.upload.staged()[1], server.now_us)
    assert server.store.live(Kind.REFERENCE) == b"x" * 50
    assert server.one(Opcode.READ_FILE, size=30).data == LIVE[:30]


PATHS = (b"/ref/live.ref", STAGED.encode(), b"/ff/staged.ff", b"/ref", b"/", b"@PARAM/param.pck", b"\xff")
requests = st.tuples(
    st.sampled_from([*range(0, 18), 77, 128, 129, 255]),
    st.integers(0, 2),
    st.sampled_from([STATION, OTHER]),
    st.one_of(st.integers(0, 500), st.integers(0, 0xFFFF_FFFF)),
    st.integers(0, 255),
    st.one_of(st.sampled_from(PATHS), st.binary(max_size=DATA_BYTES)),
    st.integers(0, 3),
)


@settings(max_examples=150, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(st.lists(st.one_of(requests, st.binary(min_size=251, max_size=251)), max_size=60))
def test_no_requests_crash_it_or_change_what_is_live(sequence):
    server = Server()
    for item in sequence:
        if isinstance(item, bytes):
            message = m.FileTransfer(0, 1, 1, item)
            message._header.srcSystem, message._header.srcComponent = STATION
            server.server.receive(message, server.now_us)
        else:
            opcode, session, source, offset, size, data, number = item
            answers = server.ask(
                opcode, session=session, source=source, offset=offset, size=size, data=data, number=number
            )
            assert all(a.number == number + 1 and a.session == session for a in answers)
            assert len(answers) <= 1
        server.looks(1)
        assert server.store.live(Kind.REFERENCE) == LIVE
        assert len(server.server._sessions) <= SESSIONS_MAX


# With the flight processor.


def transfer(line, opcode, number, *, session=1, source=STATION, **fields):
    asked = Packet(number=number, session=session, opcode=opcode, **fields)
    line.send(m.FileTransfer(0, 1, 1, asked.encode()), source=source)


def put_file(line, blob, path=b"/ref/staged.ref", number=1):
    """The answer to the end of writing."""
    transfer(line, Opcode.CREATE_FILE, number, size=len(path), data=path)
    for offset in range(0, len(blob), DATA_BYTES):
        line.run(0.02)
        number += 1
        part = blob[offset : offset + DATA_BYTES]
        transfer(line, Opcode.WRITE_FILE, number, offset=offset, size=len(part), data=part)
    line.run(0.02)
    transfer(line, Opcode.TERMINATE_SESSION, number + 1)
    line.run(0.05)
    return Packet.decode(line.received(m.FileTransfer)[-1].payload)


def test_reference_put_as_a_file_is_checked_committed_by_command_and_armed_with(make_line, make_blob):
    line = make_line()
    line.run(0.3)
    blob = make_blob()
    answer = put_file(line, blob.to_bytes())
    assert (answer.opcode, answer.request) == (Opcode.ACK, Opcode.TERMINATE_SESSION)
    line.run(0.3)
    status = line.received(m.FcStatus)[-1]
    assert (bytes(status.staged_id).hex(), status.staged_kind) == (blob.id, Kind.REFERENCE)
    assert line.store.live(Kind.REFERENCE) is None
    line.run(40.0)  # longer than the silence that ends an upload
    line.command(31010, *(float(int(blob.id[k : k + 4], 16)) for k in (0, 4, 8)))
    line.run(0.2)
    assert line.received(m.CommandAck)[-1].result == 0
    assert line.store.live(Kind.REFERENCE) == blob.to_bytes()
    assert bytes(line.received(m.FcStatus)[-1].reference_id).hex() == blob.id


def test_reference_put_as_a_file_that_is_too_fast_is_refused_with_node_and_reason(make_line, make_blob):
    line = make_line()
    line.run(0.3)
    answer = put_file(line, make_blob(reach=3.0, seconds=0.7).to_bytes())
    assert nak(answer, Error.FAIL)
    node, *reason = line.texts()[-3:]
    assert node.startswith("staged.ref refused at node ")
    assert "above" in " ".join(reason)
    assert line.store.staged(Kind.REFERENCE) is None


def test_file_that_is_too_large_by_its_header_is_refused_at_the_first_write(make_line, make_blob):
    line = make_line()
    line.run(0.3)
    blob = bytearray(make_blob().to_bytes())
    blob[38:42] = (6000).to_bytes(4, "little")  # the count of nodes
    transfer(line, Opcode.CREATE_FILE, 1, size=len(STAGED), data=STAGED.encode())
    for number in (2, 3):
        transfer(line, Opcode.WRITE_FILE, number, size=DATA_BYTES, data=bytes(blob[:DATA_BYTES]))
        line.run(0.05)
        answer = Packet.decode(line.received(m.FileTransfer)[-1].payload)
        assert (answer.request, nak(answer, Error.INVALID_DATA_SIZE)) == (Opcode.WRITE_FILE, True)
    assert line.texts().count("staged.ref refused: 312058 bytes, at most 262144") == 1
    assert nak(put_file(line, bytes(300), number=9), Error.FAIL)
    assert any(text.startswith("magic: ") for text in line.texts())
    assert put_file(line, make_blob().to_bytes(), number=20).opcode == Opcode.ACK


def test_reason_longer_than_a_text_comes_in_lines(make_line, make_blob):
    line = make_line()
    line.run(0.3)
    blob = make_blob(pieces=20)
    nodes = list(blob.nodes)
    state = nodes[7].state
    nodes[7] = nodes[7]._replace(state=(*state[:6], state[6] + 0.5, *state[7:]))
    assert nak(put_file(line, replace(blob, nodes=tuple(nodes)).to_bytes()), Error.FAIL)
    node, *reason = line.texts()[-3:]
    assert node == "staged.ref refused at node 7:"
    assert all(len(text) <= 50 for text in reason)
    assert " ".join(reason).endswith(" m/s^2")


def test_feedforward_in_the_references_place_is_refused(make_line, make_blob):
    line = make_line()
    line.run(0.3)
    assert nak(put_file(line, make_blob().to_bytes(), b"/ff/staged.ff"), Error.FAIL)
    assert any("it is kind 1" in text for text in line.texts())


def test_live_reference_is_read_in_a_burst_while_the_vehicle_stays_in_standby(make_line, make_blob):
    line = make_line()
    blob = make_blob().to_bytes()
    line.store.stage(Kind.REFERENCE, blob)
    line.store.commit(Kind.REFERENCE)
    line.run(0.3)
    path = b"/ref/live.ref"
    transfer(line, Opcode.OPEN_FILE_RO, 1, size=len(path), data=path)
    line.run(0.05)
    line.inbox.clear()
    transfer(line, Opcode.BURST_READ_FILE, 2, size=80)
    line.run(1.0)
    packets = [Packet.decode(message.payload) for message in line.received(m.FileTransfer)]
    assert b"".join(p.data for p in packets) == blob
    assert line.flight.state is State.STANDBY
