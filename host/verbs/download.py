"""`trimtab download`: what is on board of the vehicle at a port, byte by byte, into a file."""

from __future__ import annotations

from typing import Literal

from trimtab.host.verbs.options import Force, Json, Output

Name = Literal["reference", "feedforward", "staged-reference", "staged-feedforward"]


def command(
    name: Name, *, port: str, output: Output = None, force: Force = False, json: Json = False
) -> None:
    """Read what is on board of a vehicle into a file.

    Parameters
    ----------
    name
        What to read: what is live, or staged and not committed yet.
    port
        Serial port of the vehicle: a device, tcp:HOST:PORT or udp:HOST:PORT.
    output
        File to write; NAME.ref or NAME.ff by default.
    """
    from pathlib import Path

    from trimtab.host.base.artefacts import check_output, write_atomic
    from trimtab.host.base.output import emit, say
    from trimtab.host.base.progress import Progress
    from trimtab.host.link.download import NAMES, download_port

    target = check_output(output or Path(name + NAMES[name].suffix), force)
    with Progress(f"downloading {name}") as bar:
        result = download_port(name, port, lambda phase: bar.advance(1.0, phase))
    write_atomic(target, result.data, force)
    say(f"{name} {result.id}: {len(result.data)} bytes in {result.seconds:.2f} s, in {target}")
    emit({**result.to_json(), "file": str(target)}, json)
