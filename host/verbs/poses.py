"""`trimtab poses`: forward poses to a vehicle that another ground station flies."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trimtab.host.verbs.fly import CAMERA_DELAY_MS
from trimtab.host.verbs.options import Json, KeyFile, key_option

if TYPE_CHECKING:
    from trimtab.host.link.session import Session


def command(
    *,
    port: str,
    mocap: str,
    mocap_delay_ms: float = CAMERA_DELAY_MS,
    key: KeyFile = None,
    json: Json = False,
) -> None:
    """Forward a camera system's poses to a vehicle, with stamps on its clock, until interrupted.

    This verb sends no commands. MAVSDK, MAVProxy or another ground station flies through the same UDP port.

    Parameters
    ----------
    port
        Port of the vehicle that others can share: udp:HOST:PORT of `trimtab sitl` or of a MAVLink router.
    mocap
        Address at which the camera system's poses arrive, udp://HOST:PORT.
    mocap_delay_ms
        Minimum time from a camera's exposure to the arrival of its pose, as the manufacturer states it.
    """
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit, say
    from trimtab.host.base.progress import Progress
    from trimtab.host.link.poses import forward_port

    if not 0.0 <= mocap_delay_ms <= 1000.0:
        raise UsageError(f"--mocap-delay-ms {mocap_delay_ms:g} is out of range; give 0 to 1000")
    station = key_option(key)
    with Progress("forwarding poses") as bar:

        def look(session: Session) -> None:
            hint = "" if session.poses else "; do the cameras send to this address?"
            bar.advance(1.0, f"{session.forwarded} so far{hint}")

        delay_us = round(1000 * mocap_delay_ms)
        result = forward_port(
            port,
            mocap,
            delay_us,
            ready=lambda: say(f"forwarding poses from {mocap} to {port}"),
            look=look,
            key=station,
        )
    say(f"{result.forwarded} of {result.poses} poses forwarded in {result.seconds:.1f} s")
    emit(result.to_json(), json)
