"""`trimtab download`: save a blob on board of a vehicle to a file."""

from __future__ import annotations

from typing import Literal

from trimtab.host.verbs.options import Force, Json, KeyFile, Output, key_option

Name = Literal["reference", "feedforward", "staged-reference", "staged-feedforward"]


def command(
    name: Name,
    *,
    port: str,
    key: KeyFile = None,
    output: Output = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Download a reference or feed-forward from a vehicle to a file.

    Parameters
    ----------
    name
        Blob to download: a live one, or one that is staged and not committed yet.
    port
        Serial port of the vehicle: a device, tcp:HOST:PORT or udp:HOST:PORT.
    output
        File to write. Default: NAME.ref or NAME.ff.
    """
    from pathlib import Path

    from trimtab.host.base.artefacts import check_output, write_atomic
    from trimtab.host.base.output import emit, say
    from trimtab.host.base.progress import Progress
    from trimtab.host.link.download import NAMES, download_port

    target = check_output(output or Path(name + NAMES[name].suffix), force)
    station = key_option(key)
    with Progress(f"downloading {name}") as bar:
        result = download_port(name, port, lambda phase: bar.advance(1.0, phase), key=station)
    write_atomic(target, result.data, force)
    say(f"{name} {result.id}: {len(result.data)} bytes in {result.seconds:.2f} s, saved as {target}")
    emit({**result.to_json(), "file": str(target)}, json)
