"""`trimtab export`: a plan in a form that other vehicles and programs read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from trimtab.host.verbs.options import Force, Json, Output

Format = Literal["csv", "px4-csv", "json", "crazyflie", "ros2"]
SUFFIXES: dict[Format, str] = {
    "csv": ".csv",
    "px4-csv": ".px4.csv",
    "json": ".samples.json",
    "crazyflie": ".crazyflie.csv",
    "ros2": ".bag",
}
RATE_MAX_HZ = 1000.0


def command(
    reference: Path,
    *,
    format: Annotated[Format, Parameter(name="--format")],
    rate: float = 50.0,
    error_scale: float = 1.0,
    output: Output = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Export a plan for vehicles and programs that know nothing of Trimtab.

    Parameters
    ----------
    reference
        Reference to export, a .ref file.
    format
        csv and json: samples in NED. px4-csv: the same with the field names of PX4's TrajectorySetpoint.
        crazyflie: polynomials for the high-level commander, x north, y west, z up. ros2: a bag of setpoints
        in ENU.
    rate
        Samples a second, above 0 and up to 1000; the end is always a sample. Not for crazyflie.
    error_scale
        For crazyflie: the errors allowed, in units of 1 mm, 0.02 m/s, 0.01 rad and 0.1 rad/s.
    output
        File to write; for ros2 the bag's folder. Default: NAME with an ending for the format.
    """
    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit, say
    from trimtab.host.link.blob_files import read_reference

    if not 0.0 < rate <= RATE_MAX_HZ:
        raise UsageError(f"--rate {rate:g}: give a number above 0, and at most {RATE_MAX_HZ:g}")
    if not 0.0 < error_scale < float("inf"):
        raise UsageError(f"--error-scale {error_scale:g}: give a number above 0")
    blob = read_reference(reference)
    target = output or reference.with_name(reference.stem + SUFFIXES[format])
    facts: dict[str, object] = {"file": str(target), "format": format, "reference": blob.id}
    if format == "ros2":
        from trimtab.host.export.ros2 import TOPICS, write_bag

        count = write_bag(blob, rate, target)
        say(f"{target}: {count} setpoints on {', '.join(TOPICS)}")
        emit({**facts, "samples": count}, json)
        return
    artefacts.check_output(target, force)
    if format == "crazyflie":
        from trimtab.host.export.crazyflie import polynomials

        found = polynomials(blob, error_scale=error_scale)
        artefacts.write_atomic(target, found.to_csv(), force)
        pieces = len(found.durations_s)
        say(
            f"{target}: {pieces} pieces; as the firmware evaluates them, within "
            f"{1e3 * found.position_error_m:.2f} mm and {found.velocity_error_m_s:.4f} m/s of the reference"
        )
        errors = {"position_m": found.position_error_m, "velocity_m_s": found.velocity_error_m_s}
        emit({**facts, "pieces": pieces, "greatest_error": errors}, json)
        return
    from trimtab.host.export import tables

    made = {"csv": tables.csv_table, "px4-csv": tables.px4_table, "json": tables.json_table}[format]
    artefacts.write_atomic(target, made(blob, rate), force)
    say(f"{target}: {rate:g} samples a second for {blob.duration_us * 1e-6:.2f} s")
    emit({**facts, "rate_hz": rate}, json)
