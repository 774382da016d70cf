"""The real-time server: bytes through every kind of port, clients that come and go, lateness counted.

Nothing here asserts how long anything takes; a hang is ended by the test timeout.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import tty
from collections.abc import Callable, Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.host.vehicle import load_vehicle
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import (
    CAMERAS,
    HOST,
    AttPosMocap,
    CommandLong,
    FcStatus,
    Heartbeat,
    ParamRequestList,
    ParamValue,
    host_heartbeat,
    is_vehicle,
    mavlink,
)
from trimtab.protocol.parameters import PARAMETERS
from trimtab.sitl import ports
from trimtab.sitl import serve as server
from trimtab.sitl.fair_share import BULK_RATE, PIECE_BYTES, FairShare, pieces
from trimtab.sitl.vehicle import SimulatedVehicle


class Echo:
    """A vehicle that sends back what it gets and takes a pose a step."""

    def __init__(self) -> None:
        self.now_us = 0
        self.waiting = b""

    def run_until(self, t_us: int) -> int:
        self.now_us = t_us
        return t_us

    def serial_read(self) -> bytes:
        waiting, self.waiting = self.waiting, b""
        return waiting

    def serial_write(self, data: bytes) -> None:
        self.waiting += data

    def serial_room(self) -> int:
        return 4096

    def mocap_read(self) -> list[bytes]:
        return [b"pose"]


@contextlib.contextmanager
def served(
    vehicle: server.Served, port: str, *, mocap: str | None = None, realtime: bool = True
) -> Iterator[tuple[str, Callable[[], None]]]:
    """Address of a server in a thread, and what stops it; its exceptions come out here."""
    stop, up = threading.Event(), threading.Event()
    found: list[str] = []
    failed: list[BaseException] = []

    def ready(address: str) -> None:
        found.append(address)
        up.set()

    def run() -> None:
        try:
            server.serve(vehicle, port=port, stop=stop.is_set, mocap=mocap, realtime=realtime, ready=ready)
        except BaseException as error:
            failed.append(error)
            up.set()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    up.wait()
    try:
        if failed:
            raise failed[0]
        yield found[0], stop.set
    finally:
        stop.set()
        thread.join()
    if failed:
        raise failed[0]


def read_exactly(fd: int, size: int) -> bytes:
    data = b""
    while len(data) < size:
        select.select([fd], [], [])
        data += os.read(fd, size - len(data))
    return data


def open_tty(path: str) -> int:
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd)
    return fd


def test_pty_serves_clients_that_come_and_go() -> None:
    with served(Echo(), "pty") as (path, _):
        for message in (b"first client", b"second client"):
            fd = open_tty(path)
            os.write(fd, message)
            assert read_exactly(fd, len(message)) == message
            os.close(fd)


def test_pty_without_a_reader_drops_old_bytes_and_goes_on() -> None:
    class Chatty(Echo):
        said = 0

        def serial_read(self) -> bytes:
            self.said += 1
            return b"x" * 4096

    vehicle = Chatty()
    with served(vehicle, "pty", realtime=False) as (path, _):
        fd = open_tty(path)
        while vehicle.said < 200:
            select.select([], [], [], 0.001)
        assert read_exactly(fd, 1000) == b"x" * 1000
        os.close(fd)


def beat(system: int) -> bytes:
    return Codec(system, 190).encode(host_heartbeat())


def test_tcp_serves_several_clients_and_every_one_hears_all() -> None:
    with served(Echo(), "tcp:127.0.0.1:0") as (address, _):
        host, port = address.removeprefix("tcp:").split(":")
        first = socket.create_connection((host, int(port)))
        with socket.create_connection((host, int(port))) as second:
            second.sendall(beat(2))
            assert read_exactly(second.fileno(), len(beat(2))) == beat(2)
            assert read_exactly(first.fileno(), len(beat(2))) == beat(2)
        first.sendall(beat(3))
        assert read_exactly(first.fileno(), len(beat(3))) == beat(3)
        first.close()
        with socket.create_connection((host, int(port))) as third:
            third.sendall(b"third")
            assert read_exactly(third.fileno(), 5) == b"third"


def test_tcp_does_not_mix_the_messages_of_two_clients() -> None:
    with served(Echo(), "tcp:127.0.0.1:0") as (address, _):
        host, port = address.removeprefix("tcp:").split(":")
        with (
            socket.create_connection((host, int(port))) as slow,
            socket.create_connection((host, int(port))) as quick,
        ):
            slow.sendall(beat(2)[:7])
            quick.sendall(beat(3))
            size = len(beat(2))
            assert read_exactly(quick.fileno(), size) == beat(3)
            slow.sendall(beat(2)[7:])
            assert read_exactly(quick.fileno(), size) == beat(2)
            assert read_exactly(slow.fileno(), 2 * size) == beat(3) + beat(2)


def test_ninth_tcp_client_replaces_the_most_silent_one_and_not_one_that_sends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wall_us = [1]
    monkeypatch.setattr(ports, "wall_us", lambda: wall_us[0])
    line = ports.open_port("tcp:127.0.0.1:0")
    with contextlib.closing(line), contextlib.ExitStack() as stack:
        host, number = line.address.removeprefix("tcp:").split(":")

        def client() -> socket.socket:
            connected = stack.enter_context(socket.create_connection((host, int(number))))
            line.receive()
            return connected

        def send(sender: socket.socket, system: int) -> None:
            sender.sendall(beat(system))
            while line.read(4096) != beat(system):
                line.receive()

        def is_gone(each: socket.socket) -> bool:
            each.settimeout(0.2)
            try:
                return each.recv(1) == b""
            except TimeoutError:
                return False

        flying = client()
        send(flying, 1)
        others = [client() for _ in range(7)]
        send(others[0], 2)
        ninth = client()  # others[1] has sent nothing, and connected first of those
        assert [is_gone(each) for each in (flying, *others[:3], ninth)] == [False, False, True, False, False]
        for sender in (*others[2:], ninth):
            send(sender, 3)
        assert is_gone(client())  # all have just sent something
        wall_us[0] += 2_000_000
        for sender in (flying, *others[2:], ninth):
            send(sender, 4)
        tenth = client()
        assert [is_gone(each) for each in (flying, others[0], ninth, tenth)] == [False, True, False, False]


@given(st.lists(st.one_of(st.binary(max_size=9), st.just(beat(9))), max_size=9), st.integers(0, 200))
def test_whole_bytes_never_cut_a_message(parts: list[bytes], cut: int) -> None:
    data = b"".join(parts)[:cut]
    whole = ports.whole_bytes(data)
    assert 0 <= whole <= len(data)
    rest = data[whole:]
    assert rest == b"" or (rest[0] == 0xFD and len(rest) < 280)
    assert ports.whole_bytes(data[:whole]) == whole


def say(line: ports.Port, client: socket.socket, data: bytes) -> bytes:
    """What the UDP port reads after a client has sent a datagram."""
    host, number = line.address.removeprefix("udp:").split(":")
    client.sendto(data, (host, int(number)))
    select.select(line.waits_on(), [], [])
    line.receive()
    return line.read(4096)


def test_udp_answers_everybody_who_spoke_lately(monkeypatch: pytest.MonkeyPatch) -> None:
    wall_us = [0]
    monkeypatch.setattr(ports, "wall_us", lambda: wall_us[0])
    line = ports.open_port("udp:127.0.0.1:0")
    with contextlib.closing(line), contextlib.ExitStack() as stack:
        one, two = (stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2))
        assert say(line, one, b"first") == b"first"
        line.write(b"to one")
        assert one.recv(100) == b"to one"
        assert say(line, two, b"second") == b"second"
        line.write(b"to both")
        assert one.recv(100) == two.recv(100) == b"to both"
        wall_us[0] = 9_000_000
        assert say(line, two, b"still here") == b"still here"
        wall_us[0] = 11_000_000
        line.write(b"to two")
        assert two.recv(100) == b"to two"
        one.setblocking(False)
        with pytest.raises(BlockingIOError):
            one.recv(100)
        wall_us[0] = 60_000_000
        line.write(b"to the last one")
        assert two.recv(100) == b"to the last one"


def test_udp_peers_that_speak_are_not_pushed_out_by_datagrams_from_many_addresses(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wall_us = [0]
    monkeypatch.setattr(ports, "wall_us", lambda: wall_us[0])
    line = ports.open_port("udp:127.0.0.1:0")
    with contextlib.closing(line), contextlib.ExitStack() as stack:
        peers = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(100)]
        assert say(line, peers[0], beat(1)) == beat(1)
        heard = [say(line, peer, beat(2)) == beat(2) for peer in peers[1:]]
        assert heard == [True] * 7 + [False] * 92
        assert say(line, peers[0], beat(3)) == beat(3)
        line.write(b"to all peers")
        assert peers[0].recv(100) == b"to all peers"
        wall_us[0] = 10_000_000
        assert say(line, peers[99], beat(4)) == beat(4)


@given(st.lists(st.one_of(st.binary(max_size=400), st.just(beat(9))), max_size=9))
def test_pieces_are_the_data_again_and_never_longer_than_a_message(parts: list[bytes]) -> None:
    data = b"".join(parts)
    found = list(pieces(data))
    assert b"".join(found) == data
    assert all(0 < len(piece) <= PIECE_BYTES for piece in found)


def test_client_that_floods_goes_behind_one_with_little_data() -> None:
    share, size = FairShare(), len(beat(1))
    share.offer("flood", beat(7) * 1000, 0)
    assert not share.has_room("flood")
    share.offer("host", beat(1) + beat(2), 0)
    assert share.take(2 * size, 0) == beat(1) + beat(2)
    second = [share.take(4096, now_us) for now_us in range(0, 1_000_000, 2_000)]
    assert len(b"".join(second)) == pytest.approx(BULK_RATE, rel=0.05)
    assert max(map(len, second)) <= PIECE_BYTES + size
    assert len(share.take(4096, 2_000_000)) > 4000  # the host sends nothing any more


def test_clients_with_little_data_are_served_in_turn() -> None:
    share, size = FairShare(), len(beat(1))
    share.offer("one", beat(1) * 3, 0)
    share.offer("two", beat(2) * 2, 0)
    assert share.take(5 * size, 0) == beat(1) + beat(2) + beat(1) + beat(2) + beat(1)


def test_simulated_vehicle_in_real_time_sends_heartbeats_and_poses() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as camera:
        camera.bind(("127.0.0.1", 0))
        url = f"udp://127.0.0.1:{camera.getsockname()[1]}"
        vehicle = SimulatedVehicle.create(load_vehicle("research"), world="quiet")
        with served(vehicle, "pty", mocap=url) as (path, _):
            fd, codec, met = open_tty(path), Codec(*HOST), False
            while not met:
                select.select([fd], [], [])
                messages = codec.decode(os.read(fd, 4096))
                met = any(isinstance(m, Heartbeat) and is_vehicle(m) for m in messages)
            poses = Codec(*CAMERAS).decode(camera.recv(1000))
            os.close(fd)
    assert isinstance(poses[0], AttPosMocap)
    assert poses[0].z == pytest.approx(0.0, abs=0.01)


def test_two_stations_read_all_parameters_at_the_same_time() -> None:
    clean = {"loss": 0.0, "corrupt": 0.0}
    vehicle = SimulatedVehicle.create(load_vehicle("research"), world="quiet", radio=clean)
    with served(vehicle, "udp:127.0.0.1:0") as (address, _), contextlib.ExitStack() as stack:
        host, port = address.removeprefix("udp:").split(":")
        stations = {
            stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)): Codec(system, 190)
            for system in (245, 255)
        }
        found: dict[socket.socket, set[int]] = {client: set() for client in stations}

        def listen(client: socket.socket) -> None:
            for message in stations[client].decode(client.recv(4096)):
                if isinstance(message, ParamValue):
                    found[client].add(message.param_index)

        first, second = stations
        first.sendto(stations[first].encode(ParamRequestList(1, 1)), (host, int(port)))
        while not found[first]:
            listen(first)
        # The first list is under way when the second is asked for.
        second.sendto(stations[second].encode(ParamRequestList(1, 1)), (host, int(port)))
        while any(len(indices) < len(PARAMETERS) for indices in found.values()):
            for client in select.select(list(stations), [], [])[0]:
                listen(client)


def test_reboot_keeps_the_port_and_its_station() -> None:
    clean = {"loss": 0.0, "corrupt": 0.0}
    vehicle = SimulatedVehicle.create(load_vehicle("research"), world="quiet", radio=clean)
    with (
        served(vehicle, "udp:127.0.0.1:0", realtime=False) as (address, _),
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station,
    ):
        host, port = address.removeprefix("udp:").split(":")
        station.connect((host, int(port)))
        codec, ticks = Codec(*HOST), [-1]
        reboot = CommandLong(1, 1, mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 0, 1.0, *(0.0,) * 6)
        station.send(codec.encode(host_heartbeat()))
        while ticks[-1] < 1000:
            ticks += [m.tick for m in codec.decode(station.recv(4096)) if isinstance(m, FcStatus)]
        station.send(codec.encode(reboot))
        while ticks[-1] >= ticks[-2]:
            station.send(codec.encode(host_heartbeat()))
            ticks += [m.tick for m in codec.decode(station.recv(4096)) if isinstance(m, FcStatus)]
        assert ticks[-1] < 1000
    assert vehicle.now_us > 1_000_000


def test_late_machine_stretches_time_and_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wall clock that jumps by a tenth of a second every tenth look: no tick is skipped or caught up."""
    looks = 0

    def wall_us() -> int:
        nonlocal looks
        looks += 1
        return looks * 500 + looks // 10 * 100_000

    class Steps(Echo):
        targets: list[int]

        def __init__(self) -> None:
            super().__init__()
            self.targets = []

        def run_until(self, t_us: int) -> int:
            self.targets.append(t_us)
            return super().run_until(t_us)

    vehicle = Steps()
    monkeypatch.setattr(server, "wall_us", wall_us)
    lines: list[str] = []
    statistics = server.serve(
        vehicle, port="pty", stop=lambda: len(vehicle.targets) >= 100, on_late=lines.append
    )
    assert lines[0].startswith("simulated time runs up to 98 ms late: ")
    assert statistics.late_us > 90_000
    assert vehicle.targets == [2000 * k for k in range(1, 101)]
    assert statistics.overruns > 5
    assert statistics.stretched_us > 500_000
    assert statistics.simulated_us == 200_000


@pytest.mark.parametrize(
    ("port", "mocap", "told"),
    [
        ("serial:/dev/null", None, "give pty, tcp:HOST:PORT or udp:HOST:PORT"),
        ("tcp:5760", None, "needs HOST:PORT"),
        ("tcp::5760", None, "needs HOST:PORT"),
        ("tcp:[]:5760", None, "needs HOST:PORT"),
        ("udp:[]:5760", None, "needs HOST:PORT"),
        ("tcp:127.0.0.1:\N{SUPERSCRIPT TWO}", None, "needs HOST:PORT"),
        ("udp:127.0.0.1:notaport", None, "needs HOST:PORT"),
        ("pty", "http://127.0.0.1:9", "give it as udp://HOST:PORT"),
        ("pty", "udp://127.0.0.1", "needs HOST:PORT"),
        ("pty", "udp://127.0.0.1:0", "a port number of 1 to 65535"),
        ("pty", "udp://no.such.host.invalid:5", "cannot be reached, .*; check the address"),
        ("tcp:192.0.2.1:0", None, "not an address of this machine; give 127.0.0.1"),
        ("udp:no.such.host.invalid:0", None, "not an address of this machine; give 127.0.0.1"),
        ("pty", "udp://[::1:5", "give it as udp://HOST:PORT"),
    ],
)
def test_port_that_cannot_be_served_is_refused(port: str, mocap: str | None, told: str) -> None:
    with pytest.raises(ports.ServeError, match=told) as caught:
        server.serve(Echo(), port=port, mocap=mocap, stop=lambda: True)
    assert caught.value.exit_code == 2


def test_port_that_is_taken_is_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = f"tcp:127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(ports.ServeError, match="in use by another program; close that program or choose"):
            server.serve(Echo(), port=port, stop=lambda: True)
