"""Serial, TCP and UDP ports, and the socket that receives poses.

This is the only module that imports pyserial.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import socket
from typing import Protocol
from urllib.parse import urlsplit

import serial

from trimtab.host.base.errors import LinkError, UsageError

BAUD = 921_600
READ_BYTES = 65_536
CONNECT_S = 5.0


class Port(Protocol):
    """A byte stream whose reads never block; messages refer to it by `name`."""

    name: str

    def fileno(self) -> int: ...
    def read(self) -> bytes: ...
    def write(self, data: bytes) -> None: ...
    def close(self) -> None: ...


def open_port(url: str, baud: int = BAUD) -> Port:
    """Open a device path (pty, USB), `tcp:HOST:PORT` or `udp:HOST:PORT`.

    Raises LinkError (exit code 3) if the port cannot be opened, UsageError if the URL is invalid.
    """
    scheme, colon, location = url.partition(":")
    if colon and scheme in ("tcp", "udp"):
        address = _address(location.removeprefix("//"), url)
        return _TcpPort(url, address) if scheme == "tcp" else _UdpPort(url, address)
    return _SerialPort(url, baud)


def serial_devices() -> list[str]:
    """Return the paths of this machine's serial devices, sorted."""
    from serial.tools import list_ports  # it knows fewer systems than pyserial does

    return sorted(port.device for port in list_ports.comports())


class _SerialPort:
    """A device that pyserial opens."""

    def __init__(self, name: str, baud: int) -> None:
        self.name = name
        try:
            self._serial = serial.Serial(name, baud, timeout=0, write_timeout=1.0, exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            raise LinkError(f"{name}: cannot be opened as a serial port, {_remedy(error)}") from error

    def fileno(self) -> int:
        return self._serial.fileno()

    def read(self) -> bytes:
        try:
            return self._serial.read(READ_BYTES)
        except (serial.SerialException, OSError) as error:
            raise self._gone(error) from error

    def write(self, data: bytes) -> None:
        try:
            self._serial.write(data)
        except serial.SerialTimeoutException:
            raise LinkError(
                f"{self.name}: writing timed out, nothing reads from the port; check it"
            ) from None
        except (serial.SerialException, OSError) as error:
            raise self._gone(error) from error

    def _gone(self, error: BaseException) -> LinkError:
        """Return the error for a port that was open, with the system's reason if there is one."""
        reason = "" if _number(error) is None else f" ({_reason(error)})"
        return LinkError(f"{self.name}: the port is gone{reason}; check the device and its cable")

    def close(self) -> None:
        with contextlib.suppress(serial.SerialException, OSError):
            self._serial.close()


class _TcpPort:
    """A connection to a TCP server that stands in for a serial port."""

    def __init__(self, name: str, address: tuple[str, int]) -> None:
        self.name = name
        try:
            self._socket = socket.create_connection(address, timeout=CONNECT_S)
        except OSError as error:
            raise LinkError(f"{name}: cannot be reached ({_reason(error)}), check the address") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(False)

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self) -> bytes:
        try:
            data = self._socket.recv(READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise LinkError(f"{self.name}: the connection broke ({_reason(error)})") from error
        if not data:
            raise LinkError(f"{self.name}: the other side closed the connection")
        return data

    def write(self, data: bytes) -> None:
        self._socket.settimeout(1.0)
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise LinkError(f"{self.name}: the connection broke ({_reason(error)})") from error
        finally:
            self._socket.setblocking(False)

    def close(self) -> None:
        self._socket.close()


class _UdpPort:
    """Datagrams to and from one address. The peer learns our address from the first heartbeat."""

    def __init__(self, name: str, address: tuple[str, int]) -> None:
        self.name = name
        try:
            family, kind, number, _, target = socket.getaddrinfo(*address, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, kind, number)
            self._socket.connect(target)
        except OSError as error:
            raise LinkError(f"{name}: cannot be reached ({_reason(error)}), check the address") from error
        self._socket.setblocking(False)

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self) -> bytes:
        data = bytearray()
        # If the peer does not listen yet, a later read reports the refused datagram. A network that is down
        # for a while must not end a flight: silence is noticed.
        with contextlib.suppress(OSError):
            while len(data) < READ_BYTES:
                data += self._socket.recv(READ_BYTES)
        return bytes(data)

    def write(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            self._socket.send(data)

    def close(self) -> None:
        self._socket.close()


class Cameras:
    """The socket at which a camera system's datagrams arrive."""

    def __init__(self, url: str) -> None:
        """Listen at `udp://HOST:PORT`. Raises UsageError if this is not an address of this machine."""
        try:
            parts = urlsplit(url)
        except ValueError:  # unclosed brackets, or characters that normalise to punctuation
            parts = None
        if parts is None or parts.scheme != "udp":
            raise UsageError(f"mocap {url}: give it as udp://HOST:PORT")
        address = _address(parts.netloc, url)
        try:
            family, kind, number, _, local = socket.getaddrinfo(*address, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, kind, number)
            self._socket.bind(local)
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                problem = "another program uses this port; close it or let the cameras send to another port"
            else:
                problem = f"cannot listen at this address ({_reason(error)}); give one of this machine"
            raise UsageError(f"mocap {url}: {problem}") from error
        self._socket.setblocking(False)

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self) -> list[bytes]:
        """Return the waiting datagrams, oldest first, at most 100."""
        datagrams: list[bytes] = []
        with contextlib.suppress(BlockingIOError, ConnectionError):
            while len(datagrams) < 100:
                datagrams.append(self._socket.recv(READ_BYTES))
        return datagrams

    def close(self) -> None:
        self._socket.close()


def _address(text: str, url: str) -> tuple[str, int]:
    """Return host and port. Raises UsageError if either is missing or invalid."""
    host, colon, number = text.rpartition(":")
    host = host.strip("[]")  # an empty host would stand for every address of the machine
    whole = number.isascii() and number.isdigit()
    if not colon or not host or not whole or not 0 < int(number) <= 65535:
        raise UsageError(f"{url}: needs HOST:PORT with a port number of 1 to 65535")
    return host, int(number)


def _remedy(error: BaseException) -> str:
    """Return why a serial port cannot be opened and what to do about it."""
    number = _number(error)
    if number in (errno.EAGAIN, errno.EBUSY):
        return "it is in use by another program; close that program"
    if number in (errno.EACCES, errno.EPERM):
        return "permission denied; on most systems you must be in the group dialout"
    return f"check its name ({_reason(error)})"


def _reason(error: BaseException) -> str:
    """Return the system's error text, in one line and without error numbers."""
    number = _number(error)
    if isinstance(error, socket.gaierror):  # its numbers are not errno values
        text = error.strerror or "unknown address"
    else:
        text = str(error) or type(error).__name__ if number is None else os.strerror(number)
    return " ".join(text.split()).lower()


def _number(error: BaseException) -> int | None:
    """Return the errno value of an error, or None."""
    number = getattr(error, "errno", None)
    if number is None and (match := re.search(r"\((\d+), ", str(error))):
        return int(match[1])  # pyserial quotes the termios error in its own text
    return number
