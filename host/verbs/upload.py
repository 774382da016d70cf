"""`trimtab upload`: send a blob to a vehicle, which checks it and makes it live."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from trimtab.host.verbs.options import Json, KeyFile, key_option


def command(
    blob: str,
    *,
    port: str,
    compare: Annotated[bool, Parameter(name="--read-back", negative="")] = False,
    key: KeyFile = None,
    json: Json = False,
) -> None:
    """Send a reference or feed-forward to a vehicle and commit it.

    Parameters
    ----------
    blob
        A .ref or .ff file, or the word `neutral` for a feed-forward without effect, which replaces another.
    port
        Serial port of the vehicle: a device, tcp:HOST:PORT or udp:HOST:PORT.
    compare
        Read the live blob back and compare it byte by byte.
    """
    from pathlib import Path

    from trimtab.host.base.output import emit, say
    from trimtab.host.base.progress import Progress
    from trimtab.host.link.blob_files import read_blob
    from trimtab.host.link.upload import upload_port

    content = None if blob == "neutral" else read_blob(blob)
    station = key_option(key)
    with Progress(f"uploading {Path(blob).name}") as bar:
        result = upload_port(
            content, port, lambda phase: bar.advance(1.0, phase), compare=compare, key=station
        )
    say(
        f"{result.kind} {result.id} is live: {result.frames_sent} frames in {result.seconds:.2f} s, "
        f"{result.frames_repeated} retransmitted" + (", verified by reading back" if result.read_back else "")
    )
    emit(result.to_json(), json)
