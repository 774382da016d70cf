"""The `trimtab` command: verbs found by name and imported only when run; errors are one line and a code."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from trimtab.host.base import output
from trimtab.host.base.errors import BUG, INTERRUPTED, TrimtabError

if TYPE_CHECKING:
    from cyclopts import App


@dataclass(frozen=True, kw_only=True)
class Verb:
    """A verb: its name, its module in trimtab.host.verbs, and its line in the help."""

    name: str
    module: str
    help: str


VERBS = (
    Verb(
        name="demo",
        module="demo",
        help="Plan, fly, trace what is missing, plan again; one report at the end.",
    ),
    Verb(name="plan", module="plan", help="Make a checked reference for a route."),
    Verb(name="sitl", module="sitl", help="Play a simulated vehicle and its camera system at a port."),
    Verb(name="upload", module="upload", help="Send a reference or feed-forward to a vehicle and commit it."),
    Verb(
        name="poses",
        module="poses",
        help="Forward a camera system's poses for somebody else's ground station.",
    ),
    Verb(name="download", module="download", help="Read what is on board of a vehicle back into a file."),
    Verb(name="fly", module="fly", help="Fly a reference, simulated or at a port, and write its log."),
    Verb(name="learn", module="learn", help="Train a residual model on flight logs."),
    Verb(name="trace", module="trace", help="Name the missing effects behind flight logs."),
    Verb(name="import", module="import_", help="Turn somebody else's flight log into one of ours."),
    Verb(name="log", module="log", help="Look into a flight log, recover or export it."),
    Verb(name="study", module="study", help="Run a study over many sealed worlds."),
    Verb(name="bench", module="bench", help="Measure speed on this machine."),
)


def _version() -> str:
    """Trimtab's version, as installed."""
    from trimtab.host.base.artefacts import version

    return version()


def build_app() -> App:
    """Return the cyclopts application; no verb's module is imported."""
    from cyclopts import App, Parameter

    app = App(
        name="trimtab",
        help="Close the gap between a quadrotor's model and its flights.",
        version=_version,
        help_format="markdown",
        result_action="return_value",
        suppress_keyboard_interrupt=False,
        default_parameter=Parameter(negative=""),
    )
    for verb in VERBS:
        app.command(f"trimtab.host.verbs.{verb.module}:command", name=verb.name, help=verb.help)
    return app


def main(argv: Sequence[str] | None = None) -> int:
    """Return the exit code of one run. Errors are one line each on stderr; for a bug it names a file.

    Without `argv` it is the process's: what is slow is imported where Ctrl-C is one line already, and once
    the run has ended Ctrl-C is ignored.
    """
    own = argv is None
    words = list(sys.argv[1:] if argv is None else argv)
    # Thousands of small matrices: threads cost more than they bring, and sums would depend on their number.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        output.prepare()
        code = _run(words)
        sys.stdout.flush()
        return code
    except KeyboardInterrupt as error:
        if own:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        return _fail(words, "; ".join(["interrupted", *map(str, error.args)]), INTERRUPTED)
    except BrokenPipeError:
        # Whoever read our output has gone, as in `trimtab ls | head`: leave quietly.
        _silence_stdout()
        return 0
    except TrimtabError as error:
        return _fail(words, str(error) or type(error).__name__, error.exit_code, error.details)
    except Exception as error:
        if isinstance(error, OSError) and error.filename is not None:
            return _fail(words, f"{error.filename}: {error.strerror}, check the file and its folder", 2)
        from trimtab.host.base.artefacts import NO_ROOM

        if isinstance(error, OSError) and error.errno in NO_ROOM:
            return _fail(words, f"nothing more can be written: {error.strerror}, make room", 2)
        saved = _save_traceback(words)
        what = f"{type(error).__name__}: {error}".splitlines()[0]
        return _fail(words, f"a bug of ours: {what}; its traceback is in {saved}, please report it", BUG)
    finally:
        if own:
            signal.signal(signal.SIGINT, signal.SIG_IGN)


def _run(words: list[str]) -> int:
    """Return the exit code of the verb that `words` name."""
    from cyclopts import CycloptsError

    try:
        result = build_app()(words, exit_on_error=False, print_error=False)
    except SystemExit as end:
        if isinstance(end.__context__, BrokenPipeError):  # the help's reader has gone
            return 0
        raise
    except CycloptsError as error:
        text = " ".join(str(error).split())
        return _fail(words, f"{text} Try: trimtab {_verb_of(words)}--help", 2)
    return result if isinstance(result, int) and not isinstance(result, bool) else 0


def _verb_of(words: Sequence[str]) -> str:
    """Return the verb in `words` with a blank behind it, or nothing."""
    known = {verb.name for verb in VERBS}
    return f"{words[0]} " if words and words[0] in known else ""


def _fail(words: Sequence[str], message: str, code: int, details: Mapping[str, Any] | None = None) -> int:
    """Return `code` after the message went to stderr and, with `--json`, with `details` to stdout."""
    for line in message.splitlines():
        output.warn(line)
    try:
        if "--json" in words and not output.emitted():
            output.emit({"error": message, "exit_code": code, **(details or {})}, True)
        sys.stdout.flush()
    except OSError:  # it is stdout that takes nothing
        _silence_stdout()
    return code


def _silence_stdout() -> None:
    """Send what stdout still holds nowhere, so that the interpreter's end does not stumble over it."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _save_traceback(words: Sequence[str]) -> str:
    """Name of a new file with the current exception's traceback and what was run."""
    import tempfile
    import traceback

    python = sys.version.split()[0]
    text = f"trimtab {_version()} on Python {python}\narguments: {words}\n\n{traceback.format_exc()}"
    try:
        handle, name = tempfile.mkstemp(prefix="trimtab-bug-", suffix=".txt")
    except OSError:
        sys.stderr.write(text)
        return "the lines above"
    with contextlib.suppress(OSError), os.fdopen(handle, "w", encoding="utf-8") as file:
        file.write(text)
    return name


if __name__ == "__main__":
    sys.exit(main())
