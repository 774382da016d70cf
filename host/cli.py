"""The `trimtab` command. It imports only the verb that runs, and reports an error as one line and a code."""

from __future__ import annotations

import contextlib
import gc
import os
import shutil
import signal
import sys
import textwrap
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trimtab.host.base import output
from trimtab.host.base.errors import BUG, INTERRUPTED, TrimtabError
from trimtab.host.base.failures import check_address_space, failure_message
from trimtab.host.base.text import ESCAPE

if TYPE_CHECKING:
    from cyclopts import App


DOCS = Path(__file__).resolve().parents[1] / "docs"
"""Documentation: of the checkout, or inside the package where a wheel is installed."""
_HELP_FLAGS = ("--help", "-h")
_GARBAGE_THRESHOLD = 50_000
"""New objects between two searches for garbage. Imports make many that stay; by default, 700, a search would
go through them again and again."""
_HELP_WIDTH_MIN = 20
"""Columns of a verb's line of help, at least."""


@dataclass(frozen=True, kw_only=True)
class Verb:
    """A verb: its name, its module in trimtab.host.verbs, its page in `DOCS`, and its line in the help."""

    name: str
    module: str
    page: str
    help: str


VERBS = (
    Verb(
        name="demo",
        module="demo",
        page="guide/demo.md",
        help="Plan, fly, trace the missing effects and plan again, then write a report.",
    ),
    Verb(
        name="init",
        module="init",
        page="guide/workspace.md",
        help="Make a workspace: folders for your own files.",
    ),
    Verb(
        name="plan",
        module="plan",
        page="guide/planning.md",
        help="Plan a reference for a route and check it.",
    ),
    Verb(
        name="export",
        module="export",
        page="guide/export.md",
        help="Export a plan for other vehicles and programs.",
    ),
    Verb(
        name="sitl",
        module="sitl",
        page="guide/first-flight.md",
        help="Simulate a vehicle and its camera system at a port.",
    ),
    Verb(
        name="upload",
        module="upload",
        page="guide/first-flight.md",
        help="Send a reference or feed-forward to a vehicle and commit it.",
    ),
    Verb(
        name="poses",
        module="poses",
        page="guide/clients.md",
        help="Forward a camera system's poses while another ground station flies.",
    ),
    Verb(
        name="download",
        module="download",
        page="concepts/link.md",
        help="Download a reference or feed-forward from a vehicle.",
    ),
    Verb(
        name="key",
        module="key",
        page="guide/signing.md",
        help="Make a key of message signing; install or revoke it on a vehicle.",
    ),
    Verb(
        name="fly",
        module="fly",
        page="guide/first-flight.md",
        help="Fly a reference, simulated or at a port, and write its log.",
    ),
    Verb(
        name="learn",
        module="learn",
        page="guide/learning.md",
        help="Learn effects and a residual network from flight logs.",
    ),
    Verb(
        name="trace",
        module="trace",
        page="guide/tracing.md",
        help="Name the effects that a model lacks, from flight logs.",
    ),
    Verb(
        name="correct",
        module="correct",
        page="guide/correction.md",
        help="Make a feed-forward that compensates a model's effects and network on board.",
    ),
    Verb(
        name="import",
        module="import_",
        page="guide/imports.md",
        help="Say what a foreign flight log holds, or convert it to a Trimtab log.",
    ),
    Verb(
        name="vehicle",
        module="vehicle",
        page="guide/vehicle.md",
        help="Write a vehicle file from a few facts, or check one against a flight.",
    ),
    Verb(
        name="log",
        module="log",
        page="reference/flight-log.md",
        help="Describe, recover, export or view a flight log.",
    ),
    Verb(
        name="watch",
        module="watch",
        page="guide/foxglove.md",
        help="Show a flight while it is flown.",
    ),
    Verb(
        name="predict",
        module="predict",
        page="guide/compare.md",
        help="Tell how well a model predicts flights.",
    ),
    Verb(
        name="compare",
        module="compare",
        page="guide/compare.md",
        help="Compare two logs, models, plans or folders of them.",
    ),
    Verb(
        name="show",
        module="show",
        page="guide/show.md",
        help="Show flights, plans and models on one interactive page.",
    ),
    Verb(
        name="lineage",
        module="lineage",
        page="guide/workspace.md",
        help="Tell what a file came from and what came from it.",
    ),
    Verb(
        name="doctor",
        module="doctor",
        page="guide/workspace.md",
        help="Check that Trimtab works on this machine and in this workspace.",
    ),
    Verb(
        name="completion",
        module="completion",
        page="guide/first-flight.md",
        help="Complete verbs, options and files in bash, zsh or fish.",
    ),
    Verb(
        name="study",
        module="study",
        page="studies/studies.md",
        help="Run a study over many worlds or the paper's set-ups.",
    ),
    Verb(
        name="bench",
        module="bench",
        page="performance.md",
        help="Measure speed on this machine.",
    ),
)


_SUMMARY = "Close the gap between a quadrotor's model and its flights."


def _version() -> str:
    """Return the installed version of Trimtab."""
    from trimtab.host.base.artefacts import version

    return version()


def build_app() -> App:
    """Return the cyclopts application, without importing any verb's module."""
    from cyclopts import App, Parameter

    app = App(
        name="trimtab",
        help=_SUMMARY,
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
    """Run the command line and return its exit code. Print an error as one line on stderr.

    For a bug, the line names a file with the traceback. Without `argv`, the run is that of the process:
    Ctrl-C is reported in one line even during slow imports, and is ignored once the run has ended. With
    `argv`, `sys.argv` holds it during the run, because artefacts record the command.
    """
    is_process, outside = argv is None, sys.argv
    words = list(sys.argv[1:] if argv is None else argv)
    sys.argv = [*sys.argv[:1], *words]
    # A plugin of another package must not change how files are checked, and the search for one costs time.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # A roll-out that overflows shows in the result, which says so; stderr has one line for each problem.
    warnings.simplefilter("ignore", RuntimeWarning)
    if is_process:
        warnings.showwarning = _show_warning
        gc.set_threshold(_GARBAGE_THRESHOLD)
    try:
        output.prepare()
        if _verb_of(words):
            check_address_space()
        code = _run(words)
        sys.stdout.flush()
        return code
    except KeyboardInterrupt as error:
        if is_process:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        return _fail(words, ["; ".join(["interrupted", *map(str, error.args)])], INTERRUPTED)
    except BrokenPipeError:
        # The reader of our output has closed it, as in `trimtab log info X | head`.
        _silence_stdout()
        return 0
    except TrimtabError as error:
        return _fail(
            words, error.lines if str(error) else [type(error).__name__], error.exit_code, error.details
        )
    except Exception as error:
        message = failure_message(error, _verb_of(words).strip())
        if message is not None:
            return _fail(words, [message], 2)
        saved = _save_traceback(words)
        summary = f"{type(error).__name__}: {error}".splitlines()[0]
        return _fail(words, [f"a bug in trimtab: {summary}; please report it with {saved}"], BUG)
    finally:
        sys.argv = outside
        if is_process:
            signal.signal(signal.SIGINT, signal.SIG_IGN)


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    output.warn(str(message))


def _run(words: list[str]) -> int:
    """Run the verb that `words` name and return its exit code."""
    if words in ([], *([flag] for flag in _HELP_FLAGS)):
        output.say(*_overview())
        return 0
    from cyclopts import CycloptsError

    try:
        result = build_app()(words, exit_on_error=False, print_error=False)
    except SystemExit as end:
        if isinstance(end.__context__, BrokenPipeError):  # the reader of the help text has closed it
            return 0
        raise
    except CycloptsError as error:
        text = " ".join(str(error).split())
        return _fail(words, [f"{text} Try: trimtab {_verb_of(words)}--help"], 2)
    if any(flag in words for flag in _HELP_FLAGS):
        output.say(*(f"Guide: {DOCS / verb.page}" for verb in VERBS if verb.name == words[0]))
    return result if isinstance(result, int) and not isinstance(result, bool) else 0


def _overview() -> list[str]:
    """Return the list of verbs, as lines. The importing of cyclopts would take most of the time."""
    rows = [(verb.name, verb.help) for verb in VERBS]
    rows += [("--help (-h)", "Display this message and exit."), ("--version", "Display the version.")]
    indent = 2 + max(len(name) for name, _ in rows) + 2
    width = max(shutil.get_terminal_size().columns, indent + _HELP_WIDTH_MIN)
    lines = ["Usage: trimtab COMMAND", "", _SUMMARY, "", "Commands:"]
    for name, text in rows:
        first, *rest = textwrap.wrap(text, width - indent)
        lines += [f"  {name}".ljust(indent) + first, *(" " * indent + line for line in rest)]
    lines += ["", "`trimtab COMMAND --help` describes a command.", f"Documentation: {DOCS / 'README.md'}"]
    return lines


def _verb_of(words: Sequence[str]) -> str:
    """Return the verb in `words` followed by a space, or an empty string."""
    known = {verb.name for verb in VERBS}
    return f"{words[0]} " if words and words[0] in known else ""


def _fail(
    words: Sequence[str], lines: Sequence[str], code: int, details: Mapping[str, Any] | None = None
) -> int:
    """Print the lines to stderr and, with `--json`, the lines and `details` to stdout. Return `code`."""
    for line in lines:
        output.warn(line)
    try:
        if "--json" in words and not output.emitted():
            output.emit({"error": "\n".join(lines), "exit_code": code, **(details or {})}, True)
        sys.stdout.flush()
    except OSError:  # stdout cannot be written
        _silence_stdout()
    return code


def _silence_stdout() -> None:
    """Discard the rest of stdout, so that the interpreter's final flush does not fail."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _save_traceback(words: Sequence[str]) -> str:
    """Write the current exception's traceback and the arguments to a new file, and return its name."""
    import tempfile
    import traceback

    python = sys.version.split()[0]
    text = f"trimtab {_version()} on Python {python}\narguments: {words}\n\n{traceback.format_exc()}"
    try:
        handle, name = tempfile.mkstemp(prefix="trimtab-bug-", suffix=".txt")
    except OSError:
        sys.stderr.write(text)
        return "the traceback above"
    with contextlib.suppress(OSError), os.fdopen(handle, "w", encoding="utf-8", errors=ESCAPE) as file:
        file.write(text)
    return name


if __name__ == "__main__":
    sys.exit(main())
