"""`trimtab log`: looks into a flight log, makes a readable one of a damaged one, or tables of it."""

from __future__ import annotations

from pathlib import Path

from cyclopts import App

from trimtab.host.verbs.options import Force, Json, Output

command = App(name="log", help="Look into a flight log, recover or export it.")


@command.command
def info(log: Path, *, json: Json = False) -> None:
    """Say what a log holds.

    Parameters
    ----------
    log
        A flight log.
    """
    from trimtab.host.base.output import emit, say
    from trimtab.host.log import describe, to_lines

    told = describe(log)
    say(*to_lines(told))
    emit(told, json)


@command.command
def recover(log: Path, *, output: Output = None, force: Force = False, json: Json = False) -> None:
    """Make a readable log of one whose writer was killed or whose file was cut.

    Parameters
    ----------
    log
        The damaged log, or the name it would have had.
    output
        Flight log to write; LOG.recovered.mcap by default.
    """
    from trimtab.host.base import artefacts
    from trimtab.host.base.output import emit, say
    from trimtab.host.log import recover as recover_log
    from trimtab.host.log.recover import default_output

    target = artefacts.check_output(output or default_output(log), force)
    found = recover_log(log, target)
    if found.output is None:
        say(f"{found.source} is whole, nothing to recover")
    else:
        say(f"{found.output}: {found.messages} messages, {found.duration_s:.2f} s ({found.damage})")
    emit(found.to_json(), json)


@command.command
def export(log: Path, *, output: Output = None, force: Force = False, json: Json = False) -> None:
    """Write a log as tables, one CSV file a topic.

    Parameters
    ----------
    log
        A flight log.
    output
        Folder for the tables; LOG.csv by default.
    """
    from trimtab.host.base import artefacts
    from trimtab.host.base.output import emit, say
    from trimtab.host.log.export import TABLES, csv_tables

    folder = artefacts.check_folder(output or log.with_suffix(".csv"), TABLES, force)
    tables = csv_tables(log)
    folder.mkdir(exist_ok=True)
    for name in TABLES:  # of another log, where forced
        (folder / name).unlink(missing_ok=True)
    for name, (rows, text) in tables.items():
        artefacts.write_atomic(folder / name, text)
        say(f"{folder / name}: {rows} rows")
    emit({"folder": str(folder), "rows": {name: rows for name, (rows, _) in tables.items()}}, json)
