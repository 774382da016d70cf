"""Ports that are there and ports that are not."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial

from trimtab.host.base.errors import LinkError, TrimtabError, UsageError
from trimtab.host.link.ports import Cameras, Port, open_port


def receive(port: Port | Cameras, size: int) -> bytes:
    """At least `size` bytes from a port."""
    found = b""
    while len(found) < size:
        assert select.select([port], [], [], 10.0)[0], "nothing arrives"
        data = port.read()
        found += data if isinstance(data, bytes) else b"".join(data)
    return found


@pytest.fixture
def pty(require: Callable[[str], None]) -> Iterator[tuple[int, str]]:
    """A raw pty: master descriptor, name of the slave."""
    require("pty")
    master, slave = os.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    os.close(master)
    os.close(slave)


def test_serial_port_carries_bytes_both_ways(pty: tuple[int, str]) -> None:
    master, name = pty
    everything = bytes(range(256))
    with contextlib.closing(open_port(name)) as port:
        os.write(master, everything)
        assert receive(port, 256) == everything
        port.write(everything)
        assert os.read(master, 1000) == everything
        assert port.read() == b""


def test_serial_port_in_use_is_a_link_error(pty: tuple[int, str]) -> None:
    with (
        contextlib.closing(open_port(pty[1])),
        pytest.raises(LinkError, match="in use by another program; close"),
    ):
        open_port(pty[1])


def test_serial_port_that_is_gone_says_so_in_our_words(require: Callable[[str], None]) -> None:
    require("pty")
    master, slave = os.openpty()
    tty.setraw(slave)
    name = os.ttyname(slave)
    with contextlib.closing(open_port(name)) as port:
        os.close(slave)
        os.close(master)
        with pytest.raises(LinkError) as caught:
            port.read()
    assert str(caught.value) == f"{name}: the port is gone; check the device and its cable"


def test_serial_port_that_ends_says_so_in_our_words(
    pty: tuple[int, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def ends(of: object, size: int) -> bytes:
        raise serial.SerialException("device reports readiness to read but returned no data")

    with contextlib.closing(open_port(pty[1])) as port:
        monkeypatch.setattr(serial.Serial, "read", ends)
        with pytest.raises(LinkError) as caught:
            port.read()
    assert str(caught.value) == f"{pty[1]}: the port is gone; check the device and its cable"


def test_tcp_port_carries_bytes_and_notices_the_end() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        number = server.getsockname()[1]
        with contextlib.closing(open_port(f"tcp:127.0.0.1:{number}")) as port:
            peer, _ = server.accept()
            port.write(b"up")
            assert peer.recv(10) == b"up"
            peer.sendall(b"down")
            assert receive(port, 4) == b"down"
            peer.close()
            with pytest.raises(LinkError, match="closed"):
                receive(port, 1)


def test_udp_port_carries_bytes() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        with contextlib.closing(open_port(f"udp:127.0.0.1:{server.getsockname()[1]}")) as port:
            port.write(b"up")
            data, peer = server.recvfrom(10)
            assert data == b"up"
            server.sendto(b"down", peer)
            assert receive(port, 4) == b"down"


def test_cameras_keep_datagrams_apart() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        number = probe.getsockname()[1]
    with contextlib.closing(Cameras(f"udp://127.0.0.1:{number}")) as cameras:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(b"one", ("127.0.0.1", number))
            sender.sendto(b"two", ("127.0.0.1", number))
        found: list[bytes] = []
        while len(found) < 2:
            assert select.select([cameras], [], [], 10.0)[0]
            found += cameras.read()
        assert found == [b"one", b"two"]
        with pytest.raises(UsageError, match="another program uses this port; close it or"):
            Cameras(f"udp://127.0.0.1:{number}")


@pytest.mark.parametrize(
    ("url", "kind"),
    [
        ("/dev/null", LinkError),
        ("/dev/tty-of-nobody", LinkError),
        ("tcp:127.0.0.1:1", LinkError),
        ("tcp:127.0.0.1", UsageError),
        ("tcp::5760", UsageError),
        ("udp:127.0.0.1:99999", UsageError),
        ("tcp:127.0.0.1:\N{SUPERSCRIPT TWO}", UsageError),
        ("", LinkError),
    ],
)
def test_open_port_that_is_none_is_one_line(url: str, kind: type[TrimtabError]) -> None:
    with pytest.raises(kind) as caught:
        open_port(url)
    assert "\n" not in str(caught.value)


def test_open_port_on_a_file_is_a_link_error(tmp_path: Path) -> None:
    file = tmp_path / "x.ref"
    file.write_bytes(b"x")
    with pytest.raises(LinkError, match="cannot be opened as a serial port"):
        open_port(str(file))
    assert file.read_bytes() == b"x"


@pytest.mark.parametrize(
    "url",
    [
        "127.0.0.1:5",
        "tcp://127.0.0.1:5",
        "udp://127.0.0.1",
        "udp://nowhere:x",
        "udp://:5",
        "udp://[]:5",
        "udp://nowhere:\N{SUPERSCRIPT TWO}",
        "udp://[::1:5",
    ],
)
def test_cameras_url_that_is_none_is_a_usage_error(url: str) -> None:
    with pytest.raises(UsageError):
        Cameras(url)


@pytest.mark.parametrize(
    ("url", "reason"), [("udp://192.0.2.1:5", "assign"), ("udp://no.such.host.invalid:5", "")]
)
def test_cameras_at_an_address_of_another_machine_say_what_to_give(url: str, reason: str) -> None:
    with pytest.raises(
        UsageError, match=rf"cannot listen at this address \(.*{reason}.*\); give one of this machine"
    ) as caught:
        Cameras(url)
    assert "unknown error" not in str(caught.value)


@pytest.mark.parametrize(
    ("number", "told"),
    [
        (errno.EBUSY, "in use by another program"),
        (errno.EACCES, "the group dialout"),
        (errno.ENOENT, r"check its name \(no such file or directory\)"),
    ],
)
def test_serial_port_that_the_system_refuses_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch, number: int, told: str
) -> None:
    def refuse(*arguments: object, **options: object) -> None:
        raise serial.SerialException(number, f"could not open port: {os.strerror(number)}")

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(LinkError, match=rf"cannot be opened as a serial port, .*{told}"):
        open_port("/dev/ttyUSB9")
