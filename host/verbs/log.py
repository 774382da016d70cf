"""`trimtab log`: describe, recover, export or view a flight log."""

from __future__ import annotations

from pathlib import Path

from cyclopts import App

from trimtab.host.verbs.options import Force, Json, Output

command = App(name="log", help="Describe, recover, export or view a flight log.")


@command.command
def info(log: Path, *, json: Json = False) -> None:
    """Describe a log, or list those of a folder.

    Parameters
    ----------
    log
        Flight log to read, or a folder with logs.
    """
    from trimtab.host.base.output import emit, say
    from trimtab.host.log import read_flight, to_lines
    from trimtab.host.log.listing import list_logs, listing_lines
    from trimtab.host.log.unfinished import unfinished_lines, unfinished_logs

    if log.is_dir():
        listing = list_logs(log)
        say(*listing_lines(listing))
        emit(listing, json)
        return
    description = read_flight(log).to_dict()
    say(*to_lines(description), *unfinished_lines(unfinished_logs(log)))
    emit(description, json)


@command.command
def recover(log: Path, *, output: Output = None, force: Force = False, json: Json = False) -> None:
    """Recover a log whose writer was killed or whose file was cut.

    Parameters
    ----------
    log
        The damaged log, or the name that the finished log would have had.
    output
        Flight log to write. Default: LOG.recovered.mcap.
    """
    from trimtab.host.base import artefacts
    from trimtab.host.base.output import emit, say
    from trimtab.host.log import recover as recover_log
    from trimtab.host.log.recover import default_output
    from trimtab.host.log.unfinished import unfinished_lines, unfinished_logs

    target = artefacts.check_output(output or default_output(log), force)
    recovery = recover_log(log, target, force=force)
    if recovery.output is None:
        say(f"{recovery.source} is undamaged, nothing to recover", *unfinished_lines(unfinished_logs(log)))
    else:
        messages = f"{recovery.messages} messages, {recovery.duration_s:.2f} s"
        say(f"{recovery.output}: {messages} ({recovery.damage})")
    emit(recovery.to_json(), json)


@command.command
def export(log: Path, *, output: Output = None, force: Force = False, json: Json = False) -> None:
    """Export a log as tables, one CSV file for each topic.

    Parameters
    ----------
    log
        Flight log to read.
    output
        Folder for the tables, made if missing. Default: LOG.csv.
    """
    from trimtab.host.base import artefacts
    from trimtab.host.base.output import emit, say
    from trimtab.host.log.export import TABLES, csv_tables

    folder = artefacts.check_folder(output or log.with_suffix(".csv"), TABLES, force)
    tables = csv_tables(log)
    folder.mkdir(parents=True, exist_ok=True)
    for name in TABLES:  # with --force, these may belong to another log
        (folder / name).unlink(missing_ok=True)
    for name, (rows, text) in tables.items():
        artefacts.write_atomic(folder / name, text)
        say(f"{folder / name}: {rows} rows")
    emit({"folder": str(folder), "rows": {name: rows for name, (rows, _) in tables.items()}}, json)


@command.command
def layout(*, output: Output = None, force: Force = False, json: Json = False) -> None:
    """Write a layout for Foxglove: a flight in 3D, plots, states and texts.

    Parameters
    ----------
    output
        File to write. Default: trimtab.foxglove.json.
    """
    from trimtab.host.base import artefacts
    from trimtab.host.base.output import emit, say
    from trimtab.host.log.display import FOXGLOVE_LAYOUT

    target = output or Path("trimtab.foxglove.json")
    artefacts.write_atomic(target, FOXGLOVE_LAYOUT.read_bytes(), force)
    say(f"{target}: import it in Foxglove, then open a flight log there")
    emit({"layout": str(target)}, json)
