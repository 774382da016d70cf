"""Generate docs/reference/python.md, on the public names of `trimtab`, from their docstrings and signatures.

`python docs/generators/api.py FILE` writes it. A test compares the page with the code.
"""

from __future__ import annotations

import builtins
import dataclasses
import inspect
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import trimtab as tt
from trimtab.host.base.errors import TrimtabError
from trimtab.host.log import (
    Battery,
    Control,
    Estimate,
    HostControl,
    LinkHealth,
    Mocap,
    Observer,
    RecordedImu,
    RecordedInputs,
    Status,
)
from trimtab.host.trace.result import Named, Value

_HEAD = """# Python

<!-- Made by `make docs` from the docstrings; change them there. -->

These are the names of `import trimtab as tt`. [From Python](../guide/python.md) shows how to use them. The
verbs of the command line call the same functions.

- World is NED, body is FRD, quaternions are Hamilton with w first. Units are SI and radians; another unit is
  part of a name: `t_us` is in microseconds.
- Names of vehicles, routes, effects and controllers are looked up in the workspace first, then among the
  shipped ones. The workspace is the current folder, unless `workspace` names another one.
- Results have `to_dict()`: plain data for JSON, the object that `--json` prints where a verb exists (keys are
  in [JSON](json.md)). In a notebook, a result is shown as a card with its figures.
- All errors are `TrimtabError`. The text says in one line what is wrong and what to do, in the words of the
  command line: its `--at` is `at_s` here.
"""

_ARRAYS = (
    Mocap, Estimate, Control, Observer, Status, LinkHealth, HostControl, RecordedInputs, RecordedImu, Battery
)  # fmt: skip
_ORDER = (
    "open_workspace", "load_vehicle", "load_route", "load_effects", "plan", "write_plan", "read_reference",
    "sample", "fly", "import_log", "read_flight", "trace", "write_trace", "predict", "learn", "read_model",
    "write_model",
)  # fmt: skip
"""Functions in the order of the work."""

Sections = dict[str, list[tuple[str, str]]]


class DocstringError(ValueError):
    """A docstring does not describe its object completely."""


def page() -> str:
    """Return the page as Markdown. Raises DocstringError where a docstring misses something."""
    public = {name: getattr(tt, name) for name in tt.__all__}
    functions = {name: value for name, value in public.items() if inspect.isfunction(value)}
    classes = {name: value for name, value in public.items() if inspect.isclass(value)}
    errors = {name: value for name, value in classes.items() if issubclass(value, Exception)}
    results = {name: value for name, value in classes.items() if name not in errors}
    if sorted(functions) != sorted(_ORDER):
        raise DocstringError(f"_ORDER names other functions than {sorted(functions)}")
    index = [f"| [`{name}`](#{name.lower()}) | {_summary(functions[name])} |" for name in _ORDER]
    return "\n".join(
        [
            _HEAD,
            "## Functions",
            "",
            "| function | |",
            "|---|---|",
            *index,
            "",
            *(line for name in _ORDER for line in function_lines(name, functions[name])),
            "## Results",
            "",
            *(line for name, value in sorted(results.items()) for line in _class(name, value)),
            "## Parts of results",
            "",
            "An effect of a trace, and a value with its uncertainty:",
            "",
            *(line for value in (Named, Value) for line in _class(value.__name__, value)),
            "## Arrays of a flight",
            "",
            "Each is an attribute of a `Flight`, or None where the log lacks it. All arrays of one object "
            "have the same first dimension. Times never decrease.",
            "",
            *(line for value in _ARRAYS for line in _class(value.__name__, value)),
            "## Errors",
            "",
            "| error | exit code | meaning |",
            "|---|---|---|",
            *(_error(name, value) for name, value in sorted(errors.items())),
            "",
        ]
    )


def function_lines(name: str, function: Callable[..., Any]) -> Iterator[str]:
    """Yield the lines of a function: its signature and its docstring. Raises DocstringError."""
    signature = inspect.signature(function)
    text, sections = parse_docstring(function)
    given = sections.get("Parameters", [])
    documented = [each for names, _ in given for each in names.split(", ")]
    if sorted(documented) != sorted(signature.parameters):
        raise DocstringError(f"{name}: documents {documented}, takes {list(signature.parameters)}")
    if not {"Returns", "Raises"} <= sections.keys():
        raise DocstringError(f"{name}: says not what it returns or raises")
    yield from (f"### {name}", "", "```python", *_signature(name, signature), "```", "", text, "")
    for names, meaning in given:
        yield f"- {_code(names)}: {meaning}"
    yield ""
    for what, meaning in sections["Returns"]:
        yield f"Returns `{what}`. {meaning}"
    yield ""
    for what, meaning in sections["Raises"]:
        unknown = [
            each for each in what.split(", ") if each not in tt.__all__ and not hasattr(builtins, each)
        ]
        if unknown:
            raise DocstringError(f"{name}: raises {unknown}, which `trimtab` does not offer")
        yield f"- Raises {_code(what)} {meaning[0].lower()}{meaning[1:]}"
    yield ""


def _signature(name: str, signature: inspect.Signature) -> Iterator[str]:
    """Yield a signature, a parameter on each line."""
    yield f"tt.{name}("
    keyword_only = False
    for parameter in signature.parameters.values():
        if parameter.kind is parameter.KEYWORD_ONLY and not keyword_only:
            keyword_only = True
            yield "    *,"
        default = "" if parameter.default is parameter.empty else f" = {_default(parameter.default)}"
        yield f"    {parameter.name}: {parameter.annotation}{default},"
    yield f") -> {signature.return_annotation}"


def _default(value: object) -> str:
    """Return a default value as it is written."""
    if callable(value):
        return "..."
    return repr(dict(value)) if isinstance(value, Mapping) else repr(value)


def _class(name: str, value: Any) -> Iterator[str]:
    """Yield the lines of a class of data: its attributes, properties and methods."""
    text, sections = parse_docstring(value)
    fields = {
        field.name: str(field.type) for field in dataclasses.fields(value) if not field.name.startswith("_")
    }
    documented = {
        each: meaning for names, meaning in sections.get("Attributes", []) for each in names.split(", ")
    }
    if documented.keys() != fields.keys() - {"left_out"}:
        raise DocstringError(f"{name}: documents {sorted(documented)}, has {sorted(fields)}")
    yield from (f"### {name}", "", text, "")
    for names, meaning in sections["Attributes"]:
        shapes = list(dict.fromkeys(filter(None, (_shape(fields[each]) for each in names.split(", ")))))
        shown = f", {' and '.join(shapes)}" if shapes else ""
        yield f"- {_code(names)}{shown}: {meaning}"
    for each, member in sorted(vars(value).items()):
        if each.startswith("_") or each in fields:
            continue
        if isinstance(member, property):
            yield f"- `{each}`: {_summary(member)}"
        elif inspect.isfunction(member) and member.__doc__:
            yield f"- `{each}()`: {_summary(member)}"
    yield ""


def _shape(annotation: str) -> str | None:
    """Return the shape in the annotation of an array, as `(samples, 3)`; None for anything else."""
    found = re.search(r"""Annotated\[.*, ["']([^"']*)["']\]""", annotation)
    if found is None:
        return None
    axes = found[1].split()
    return f"({axes[0]},)" if len(axes) == 1 else f"({', '.join(axes)})"


def _error(name: str, error: Any) -> str:
    """Return the row of an error."""
    bases = ", ".join(f"`{base.__name__}`" for base in error.__mro__[1:] if issubclass(base, TrimtabError))
    kind = f" A {bases}." if bases else ""
    return f"| `{name}` | {error.exit_code} | {_paragraphs(inspect.getdoc(error) or '')}{kind} |"


def parse_docstring(value: Any) -> tuple[str, Sections]:
    """Return the text of a docstring, and its numpydoc sections as pairs of name and meaning."""
    lines = (inspect.getdoc(value) or "").splitlines()
    starts = [k - 1 for k, line in enumerate(lines) if k and re.fullmatch("-{3,}", line)]
    text = _paragraphs("\n".join(lines[: starts[0] if starts else None]))
    sections: Sections = {}
    for start, end in zip(starts, [*starts[1:], len(lines)], strict=True):
        entries: list[tuple[str, str]] = []
        for line in lines[start + 2 : end]:
            if line and not line.startswith(" "):
                entries.append((line, ""))
            elif line:
                name, meaning = entries[-1]
                entries[-1] = (name, f"{meaning} {line.strip()}".strip().replace("*", r"\*"))
        sections[lines[start]] = entries
    if not text or any(not meaning for entries in sections.values() for _, meaning in entries):
        raise DocstringError(f"{value}: a docstring without text, or an entry without a meaning")
    return text, sections


def _paragraphs(text: str) -> str:
    """Return a text with one line for each paragraph."""
    return "\n\n".join(" ".join(part.split()) for part in text.strip().split("\n\n"))


def _summary(value: Any) -> str:
    """Return the first paragraph of a docstring."""
    return _paragraphs(inspect.getdoc(value) or "").split("\n\n")[0]


def _code(names: str) -> str:
    """Return names with commas as code."""
    return ", ".join(f"`{name}`" for name in names.split(", "))


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
