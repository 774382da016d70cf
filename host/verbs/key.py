"""`trimtab key`: make a key of message signing, and install or revoke it on a vehicle."""

from __future__ import annotations

from pathlib import Path

from cyclopts import App

from trimtab.host.verbs.options import Force, Json

command = App(name="key", help="Make a key of message signing; install or revoke it on a vehicle.")


@command.command
def new(file: Path, *, force: Force = False, json: Json = False) -> None:
    """Make a new random key.

    Parameters
    ----------
    file
        Key file to write. Only you can read it.
    """
    from trimtab.host.base.output import emit, say
    from trimtab.host.link.keys import new_key

    new_key(file, force)
    say(f"{file}: a new key; install it with `trimtab key install {file} --port DEVICE`")
    emit({"file": str(file)}, json)


@command.command
def install(file: Path, *, port: str, json: Json = False) -> None:
    """Install a key on a vehicle that is connected by cable. It replaces the present key.

    From then on, the vehicle obeys only messages that are signed with this key.

    Parameters
    ----------
    file
        Key file.
    port
        Serial port of the vehicle: a device, tcp:HOST:PORT or udp:HOST:PORT.
    """
    from trimtab.host.base.output import emit, say
    from trimtab.host.link.drivers import wall_timestamp
    from trimtab.host.link.key_setup import set_up_key_port
    from trimtab.host.link.keys import use_key

    set_up_key_port(use_key(file, wall_timestamp()), port)
    say(f"the vehicle at {port} obeys only messages signed with {file}")
    emit({"file": str(file), "port": port}, json)


@command.command
def revoke(*, port: str, json: Json = False) -> None:
    """Remove the key of a vehicle that is connected by cable. It then obeys unsigned messages again.

    Parameters
    ----------
    port
        Serial port of the vehicle: a device, tcp:HOST:PORT or udp:HOST:PORT.
    """
    from trimtab.host.base.output import emit, say
    from trimtab.host.link.key_setup import set_up_key_port

    set_up_key_port(None, port)
    say(f"the vehicle at {port} has no key; it obeys unsigned messages")
    emit({"port": port}, json)
