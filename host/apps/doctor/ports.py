"""Serial ports, pseudo-terminals, and datagrams within the machine."""

from __future__ import annotations

import os
import socket
import tty
from pathlib import Path

from trimtab.host.apps.doctor.check import Check
from trimtab.host.base.errors import LinkError
from trimtab.host.link.ports import open_port, serial_devices

_BYTES = bytes(range(256))
_WAIT_S = 0.5


def serial_ports() -> list[Check]:
    """Return a check for each serial device, or one that there is none."""
    devices = serial_devices()
    if not devices:
        return [Check(name="serial ports", status="ok", text="none connected")]
    return [_permission(device) for device in devices]


def _permission(device: str) -> Check:
    """Return whether this user may open a device."""
    name = "serial port"
    if os.access(device, os.R_OK | os.W_OK):
        return Check(name=name, status="ok", text=device)
    remedy = f"run sudo usermod -aG {_group(device)} $USER, log out and log in again"
    return Check(name=name, status="note", text=f"{device}: permission denied", remedy=remedy)


def _group(device: str) -> str:
    """Return the group that owns a device; dialout, as on most systems, if that cannot be told."""
    try:
        return Path(device).group()
    except (OSError, KeyError, NotImplementedError):
        return "dialout"


def pseudo_terminal() -> Check:
    """Return whether bytes pass a pseudo-terminal, opened like a vehicle's port."""
    name = "pseudo-terminal"
    try:
        passed = _through_pty()
    except (OSError, LinkError) as error:
        passed, reason = b"", f": {error}"
    else:
        reason = ""
    if passed == _BYTES:
        return Check(name=name, status="ok", text="passes bytes unchanged")
    remedy = "run sudo mount -t devpts devpts /dev/pts; until then, use sitl --port tcp:127.0.0.1:47300"
    text = f"none works{reason}: no trimtab demo, and no trimtab sitl --port pty"
    return Check(name=name, status="problem", text=text, remedy=remedy)


def _through_pty() -> bytes:
    """Return what arrives at one end of a pseudo-terminal. Raises OSError or LinkError."""
    master, slave = os.openpty()
    try:
        tty.setraw(slave)
        port = open_port(os.ttyname(slave))
        try:
            port.write(_BYTES)
            return os.read(master, len(_BYTES))
        finally:
            port.close()
    finally:
        os.close(master)
        os.close(slave)


def datagrams() -> Check:
    """Return whether a datagram passes within the machine, as poses of cameras do."""
    name = "datagrams"
    try:
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
        ):
            receiver.settimeout(_WAIT_S)
            receiver.bind(("127.0.0.1", 0))
            sender.sendto(_BYTES, receiver.getsockname())
            receiver.recv(len(_BYTES))
    except OSError as error:
        return Check(
            name=name,
            status="note",
            text=f"UDP does not pass at 127.0.0.1: {error}; no poses for flights at a port",
            remedy="allow it in the firewall",
        )
    return Check(name=name, status="ok", text="UDP passes at 127.0.0.1")
