"""A simulated vehicle in real time on a pty, TCP or UDP port, its camera system on a UDP port.

The server is locked to the wall clock and never skips a tick: a machine that falls behind stretches simulated
time, and every such lateness is counted.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import time
import tty
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol
from urllib.parse import urlsplit

_READ_BYTES = 4096
_BACKLOG_BYTES = 65536  # towards a client that does not read; older bytes are then dropped, as by a full UART
_STEP_US = 2000
_PEER_US = 10_000_000  # a ground station says something every second; one silent for so long has gone
_PEERS = 16
_LATE_US = 20_000  # behind by more than this counts as an overrun and moves the clock


class ServeError(RuntimeError):
    """A port or URL cannot be served."""

    exit_code = 2


class Served(Protocol):
    """What the server needs of a vehicle."""

    now_us: int

    def run_until(self, t_us: int) -> int: ...
    def serial_read(self) -> bytes: ...
    def serial_write(self, data: bytes) -> None: ...
    def mocap_read(self) -> list[bytes]: ...


@dataclass
class ServeStatistics:
    """How the serving went: simulated time, times the machine was late, and by how much in all."""

    simulated_us: int = 0
    overruns: int = 0
    stretched_us: int = 0


class Port(Protocol):
    """A byte stream to a client, over UDP to several. `address` is what a client opens."""

    address: str

    def fileno(self) -> int: ...
    def read(self) -> bytes: ...
    def write(self, data: bytes) -> None: ...
    def close(self) -> None: ...


def serve(
    vehicle: Served,
    *,
    port: str,
    stop: Callable[[], bool],
    mocap: str | None = None,
    realtime: bool = True,
    ready: Callable[[str], None] | None = None,
) -> ServeStatistics:
    """Statistics once `stop` turned true: the vehicle ran against the wall clock, bytes through the port.

    Args:
        port: "pty", "tcp:HOST:PORT" (listens) or "udp:HOST:PORT" (listens, answers everybody who speaks).
        stop: asked every few milliseconds.
        mocap: udp://HOST:PORT that gets one datagram a pose; None: nobody gets them.
        realtime: False runs as fast as the machine allows.
        ready: called once with the address to open.

    Raises ServeError where port or mocap cannot be opened.
    """
    with contextlib.ExitStack() as stack:
        camera = stack.enter_context(contextlib.closing(_Datagrams(mocap)))
        line = stack.enter_context(contextlib.closing(open_port(port)))
        if ready is not None:
            ready(line.address)
        return _loop(vehicle, line, camera, stop, realtime)


def _loop(
    vehicle: Served, line: Port, camera: _Datagrams, stop: Callable[[], bool], realtime: bool
) -> ServeStatistics:
    statistics = ServeStatistics()
    first_us = vehicle.now_us
    origin_us = _wall_us() - first_us
    while not stop():
        ahead_us = vehicle.now_us - (_wall_us() - origin_us) if realtime else 0
        if ahead_us < -_LATE_US:
            statistics.overruns += 1
            statistics.stretched_us -= ahead_us
            origin_us -= ahead_us
        readable, _, _ = select.select([line], [], [], max(0, ahead_us) * 1e-6)
        if readable and (data := line.read()):
            vehicle.serial_write(data)
        if realtime and vehicle.now_us > _wall_us() - origin_us:
            continue
        vehicle.run_until(vehicle.now_us + _STEP_US)
        line.write(vehicle.serial_read())
        for datagram in vehicle.mocap_read():
            camera.send(datagram)
        statistics.simulated_us = vehicle.now_us - first_us
    return statistics


def open_port(spec: str) -> Port:
    """The port a specification names. Raises ServeError where it is malformed or taken."""
    if spec == "pty":
        return _Pty()
    scheme, _, rest = spec.partition(":")
    if scheme not in ("tcp", "udp"):
        raise ServeError(f"port {spec}: choose pty, tcp:HOST:PORT or udp:HOST:PORT")
    host, number = _host_port(rest.removeprefix("//"), spec)
    try:
        return _Tcp(host, number) if scheme == "tcp" else _Udp(host, number)
    except OSError as error:
        raise ServeError(f"port {spec}: {_remedy(error)}") from None


class _Pty:
    """A pseudo terminal. Its slave stays open here, so that a client may come and go."""

    def __init__(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.address = os.ttyname(self._slave)
        self._backlog = bytearray()

    def fileno(self) -> int:
        return self._master

    def read(self) -> bytes:
        try:
            return os.read(self._master, _READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            if error.errno == errno.EIO:  # no client has the slave open
                return b""
            raise

    def write(self, data: bytes) -> None:
        self._backlog += data
        del self._backlog[:-_BACKLOG_BYTES]
        if not self._backlog:
            return
        try:
            del self._backlog[: os.write(self._master, self._backlog)]
        except BlockingIOError:
            return
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            self._backlog.clear()

    def close(self) -> None:
        os.close(self._master)
        os.close(self._slave)


class _Tcp:
    """A listening socket that serves one client at a time; the newest takes over."""

    def __init__(self, host: str, port: int) -> None:
        self._listener = socket.create_server((host, port))
        self._listener.setblocking(False)
        self.address = "tcp:{}:{}".format(*self._listener.getsockname()[:2])
        self._client: socket.socket | None = None
        self._backlog = bytearray()

    def fileno(self) -> int:
        return (self._client or self._listener).fileno()

    def read(self) -> bytes:
        self._accept()
        if self._client is None:
            return b""
        try:
            data = self._client.recv(_READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._drop()
        return data

    def write(self, data: bytes) -> None:
        self._accept()
        if self._client is None:
            return
        self._backlog += data
        del self._backlog[:-_BACKLOG_BYTES]
        if not self._backlog:
            return
        try:
            del self._backlog[: self._client.send(self._backlog)]
        except BlockingIOError:
            return
        except OSError:
            self._drop()

    def close(self) -> None:
        self._drop()
        self._listener.close()

    def _accept(self) -> None:
        try:
            client, _ = self._listener.accept()
        except BlockingIOError:
            return
        self._drop()
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._client = client

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None
            self._backlog.clear()


class _Udp:
    """A bound socket that many may use at once: each hears everything, until it is silent for _PEER_US."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(_family(host), socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind((host, port))
        self.address = "udp:{}:{}".format(*self._socket.getsockname()[:2])
        self._peers: dict[tuple[str, int], int] = {}  # the one that spoke last at the end

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self) -> bytes:
        try:
            data, peer = self._socket.recvfrom(_READ_BYTES)
        except (BlockingIOError, ConnectionError):
            return b""
        self._peers.pop(peer, None)
        self._peers[peer] = _wall_us()
        if len(self._peers) > _PEERS:
            del self._peers[next(iter(self._peers))]
        return data

    def write(self, data: bytes) -> None:
        if not data or not self._peers:
            return
        least_us = _wall_us() - _PEER_US
        self._peers = {peer: heard_us for peer, heard_us in self._peers.items() if heard_us > least_us}
        for peer in self._peers:
            with contextlib.suppress(BlockingIOError, ConnectionError):
                self._socket.sendto(data, peer)

    def close(self) -> None:
        self._socket.close()


class _Datagrams:
    """Where poses go: a UDP address, or nowhere."""

    def __init__(self, url: str | None) -> None:
        self._socket: socket.socket | None = None
        if url is None:
            return
        try:
            parts = urlsplit(url)
        except ValueError:  # brackets without an end, letters that stand for punctuation
            parts = None
        if parts is None or parts.scheme != "udp" or not parts.hostname:
            raise ServeError(f"mocap {url}: give it as udp://HOST:PORT")
        host, number = _host_port(parts.netloc, url, least=1)
        self._socket = socket.socket(_family(host), socket.SOCK_DGRAM)
        try:
            self._socket.connect((host, number))
        except OSError as error:
            self._socket.close()
            raise ServeError(f"mocap {url}: cannot be reached, {error.strerror}; check the address") from None
        self._socket.setblocking(False)

    def send(self, datagram: bytes) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):  # nobody listens, no way there just now: it is lost, as on air
                self._socket.send(datagram)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()


def _remedy(error: OSError) -> str:
    """Why nothing can be served at an address and what to do."""
    if error.errno == errno.EADDRINUSE:
        return "in use by another program, close that or choose another number"
    if error.errno == errno.EADDRNOTAVAIL or isinstance(error, socket.gaierror):
        return "no address of this machine, give 127.0.0.1, or 0.0.0.0 for every one it has"
    if error.errno == errno.EACCES:
        return "not allowed, choose a number from 1024 on"
    return f"{os.strerror(error.errno or 0)}, choose another address"


def _host_port(text: str, spec: str, least: int = 0) -> tuple[str, int]:
    """Host and port number, where 0 means any that is free. Raises ServeError."""
    host, colon, number = text.rpartition(":")
    whole = number.isascii() and number.isdigit()
    if not colon or not host or not whole or not least <= int(number) <= 65535:
        raise ServeError(f"{spec}: needs HOST:PORT with a port number of {least} to 65535")
    return host.strip("[]"), int(number)


def _family(host: str) -> socket.AddressFamily:
    return socket.AF_INET6 if ":" in host else socket.AF_INET


def _wall_us() -> int:
    return time.monotonic_ns() // 1000
