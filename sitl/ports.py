"""Ports of a simulated vehicle: a pty, TCP or UDP."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import time
import tty
from collections.abc import Callable
from typing import Protocol

from trimtab.host.base.errors import TrimtabError
from trimtab.protocol.stream import MAGIC
from trimtab.sitl.fair_share import ACTIVE_US, READ_BYTES, FairShare, message_bytes

_CLIENTS_MAX = 8
_DATAGRAMS_MAX = 64  # read at once
_PEER_US = 10_000_000  # a UDP peer that has been silent for longer gets no more data
_BACKLOG_BYTES = 65536  # for a client that does not read; older bytes are then dropped, as by a full UART


class ServeError(TrimtabError, RuntimeError):
    """A port or URL cannot be served."""

    exit_code = 2


class Port(Protocol):
    """A byte stream to the connected clients. `address` is what a client opens.

    `receive` takes in what has arrived; `read` returns about `room` bytes of it. If there may be several
    clients, their data is read in complete messages, in turn.
    """

    address: str

    def waits_on(self) -> list[int | socket.socket]: ...
    def receive(self) -> None: ...
    def read(self, room: int) -> bytes: ...
    def write(self, data: bytes) -> None: ...
    def close(self) -> None: ...


def open_port(spec: str) -> Port:
    """Open the port that a specification names. Raises ServeError if it is malformed or in use."""
    if spec == "pty":
        return _Pty()
    scheme, _, location = spec.partition(":")
    if scheme not in ("tcp", "udp"):
        raise ServeError(f"port {spec}: give pty, tcp:HOST:PORT or udp:HOST:PORT")
    host, number = host_port(location.removeprefix("//"), spec)
    try:
        return _Tcp(host, number) if scheme == "tcp" else _Udp(host, number)
    except OSError as error:
        raise ServeError(f"port {spec}: {remedy(error)}") from None


class _Pty:
    """A pseudo-terminal. Its slave side stays open, so that clients can connect and disconnect."""

    def __init__(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.address = os.ttyname(self._slave)
        self._backlog = bytearray()
        self._received = b""

    def waits_on(self) -> list[int | socket.socket]:
        return [] if self._received else [self._master]

    def receive(self) -> None:
        if self._received:
            return
        try:
            self._received = os.read(self._master, READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            if error.errno != errno.EIO:  # EIO: no client has the slave open
                raise

    def read(self, room: int) -> bytes:
        data, self._received = self._received[:room], self._received[room:]
        return data

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


class _Client:
    """One TCP client, with the incomplete message that it sends and the data that it has not read.

    Attributes
    ----------
    gone
        Whether it has disconnected.
    heard_us
        When it last sent something; None before that.
    """

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.socket = connection
        self.gone = False
        self.heard_us: int | None = None
        self._begun = b""
        self._backlog = bytearray()

    def read(self) -> bytes:
        """Return complete messages, and bytes that do not belong to a message."""
        try:
            data = self.socket.recv(READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if data:
            self.heard_us = wall_us()
        else:
            self.gone = True
        whole = whole_bytes(data := self._begun + data)
        self._begun = data[whole:]
        return data[:whole]

    def write(self, data: bytes) -> None:
        self._backlog += data
        del self._backlog[:-_BACKLOG_BYTES]
        if not self._backlog:
            return
        try:
            del self._backlog[: self.socket.send(self._backlog)]
        except BlockingIOError:
            return
        except OSError:
            self.gone = True


class _Tcp:
    """A listening socket for up to `_CLIENTS_MAX` clients. A further client replaces the most silent one.

    Clients that have sent nothing go first, in the order in which they connected. Clients that have sent
    something within ACTIVE_US stay, so a flying host does; if all have, the further client is refused.
    """

    def __init__(self, host: str, port: int) -> None:
        self._listener = socket.create_server((host, port))
        self._listener.setblocking(False)
        self.address = "tcp:{}:{}".format(*self._listener.getsockname()[:2])
        self._clients: list[_Client] = []
        self._share = FairShare()

    def waits_on(self) -> list[int | socket.socket]:
        readable = [client.socket for client in self._clients if self._share.has_room(client)]
        return [self._listener, *readable]

    def receive(self) -> None:
        self._accept()
        for client in self._clients:
            if self._share.has_room(client):
                self._share.offer(client, client.read(), wall_us())
        self._drop(lambda client: client.gone)

    def read(self, room: int) -> bytes:
        return self._share.take(room, wall_us())

    def write(self, data: bytes) -> None:
        self._accept()
        for client in self._clients:
            client.write(data)
        self._drop(lambda client: client.gone)

    def close(self) -> None:
        self._drop(lambda client: True)
        self._listener.close()

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except BlockingIOError:
            return
        if len(self._clients) >= _CLIENTS_MAX:
            silent = min(self._clients, key=lambda client: client.heard_us or 0)
            if silent.heard_us is not None and wall_us() - silent.heard_us < ACTIVE_US:
                connection.close()
                return
            self._drop(lambda client: client is silent)
        self._clients.append(_Client(connection))

    def _drop(self, which: Callable[[_Client], bool]) -> None:
        for client in [client for client in self._clients if which(client)]:
            client.socket.close()
            self._clients.remove(client)


class _Udp:
    """A bound socket that sends to every peer that it has received from recently.

    It has up to `_CLIENTS_MAX` peers. A further one is ignored until one of them has been silent for
    `_PEER_US`: datagrams from many addresses must not push out the flying host.
    """

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(address_family(host), socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind((host, port))
        self.address = "udp:{}:{}".format(*self._socket.getsockname()[:2])
        self._heard_us: dict[tuple[str, int], int] = {}
        self._share = FairShare()

    def waits_on(self) -> list[int | socket.socket]:
        return [self._socket]

    def receive(self) -> None:
        for _ in range(_DATAGRAMS_MAX):
            try:
                data, peer = self._socket.recvfrom(READ_BYTES)
            except BlockingIOError:
                return
            except ConnectionError:  # a peer has closed its socket
                continue
            if self._admits(peer):
                self._share.offer(peer, data[: whole_bytes(data)], wall_us())

    def read(self, room: int) -> bytes:
        return self._share.take(room, wall_us())

    def _admits(self, peer: tuple[str, int]) -> bool:
        now_us, heard_us = wall_us(), self._heard_us
        if peer not in heard_us and len(heard_us) >= _CLIENTS_MAX:
            oldest = next(iter(heard_us))
            if now_us - heard_us[oldest] < _PEER_US:
                return False
            del heard_us[oldest]
        heard_us.pop(peer, None)
        heard_us[peer] = now_us
        return True

    def write(self, data: bytes) -> None:
        if not data:
            return
        last_us = wall_us() - _PEER_US
        for peer, heard_us in list(self._heard_us.items()):
            # The newest peer gets data even after a long silence, because it may only be listening.
            if heard_us < last_us and len(self._heard_us) > 1:
                del self._heard_us[peer]
                continue
            with contextlib.suppress(BlockingIOError, ConnectionError):
                self._socket.sendto(data, peer)

    def close(self) -> None:
        self._socket.close()


def whole_bytes(data: bytes) -> int:
    """Return the number of bytes before an incomplete MAVLink 2 message at the end of `data`."""
    at = data.find(MAGIC)
    while 0 <= at < len(data):
        after = at + message_bytes(data, at)
        if after > len(data):
            return at
        at = data.find(MAGIC, after)
    return len(data)


def remedy(error: OSError) -> str:
    """Return why an address cannot be used and what to do about it."""
    if error.errno == errno.EADDRINUSE:
        return "in use by another program; close that program or choose another port number"
    if error.errno == errno.EADDRNOTAVAIL or isinstance(error, socket.gaierror):
        return "not an address of this machine; give 127.0.0.1, or 0.0.0.0 for all its addresses"
    if error.errno == errno.EACCES:
        return "permission denied; choose a port number from 1024 on"
    return f"{os.strerror(error.errno or 0)}; choose another address"


def host_port(text: str, spec: str, lowest: int = 0) -> tuple[str, int]:
    """Return host and port number, where 0 stands for any free port. Raises ServeError."""
    host, colon, number = text.rpartition(":")
    host = host.strip("[]")  # an empty host would stand for every address of the machine
    whole = number.isascii() and number.isdigit()
    if not colon or not host or not whole or not lowest <= int(number) <= 65535:
        raise ServeError(f"{spec}: needs HOST:PORT with a port number of {lowest} to 65535")
    return host, int(number)


def address_family(host: str) -> socket.AddressFamily:
    """Return the address family of a host."""
    return socket.AF_INET6 if ":" in host else socket.AF_INET


def wall_us() -> int:
    """Return the time of the wall clock, us."""
    return time.monotonic_ns() // 1000
