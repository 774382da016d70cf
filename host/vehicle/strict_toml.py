"""Strict reader for users' TOML files: unknown keys are refused, and all problems are reported at once.

One problem is one line, `file: key.path: problem; remedy`. Vehicles, routes and worlds are read here.
"""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Iterator, Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from trimtab.host.base.bounds import TOML_BYTES, TOML_DEPTH
from trimtab.host.base.errors import TrimtabError


class ConfigurationError(TrimtabError, ValueError):
    """A user's file is invalid; `problems` holds one line for each problem."""

    exit_code = 2

    def __init__(self, problems: Sequence[str]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(self.problems))

    @property
    def lines(self) -> tuple[str, ...]:
        """One line for each problem."""
        return self.problems

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the type and arguments that rebuild the error, for pickle."""
        return type(self), (self.problems,)


class Strict(BaseModel):
    """Base class of users' TOML files: frozen, no unknown keys, no coercion, finite numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)


ModelT = TypeVar("ModelT", bound=BaseModel)
_DEEP_KEY = re.compile(
    rf"""(?<![\w-])(?:(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){{{TOML_DEPTH.limit}}}""", re.ASCII
)
"""A key of more parts than allowed, wherever it stands."""


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """Return the plain data of a TOML text.

    Raises ConfigurationError with `source`, line and column, or with the keys of integers beyond 64 bits,
    which TOML does not guarantee and no field needs.
    """
    if len(text) > TOML_BYTES.limit:
        raise ConfigurationError([f"{source}: {TOML_BYTES.problem(len(text))}"])
    if _DEEP_KEY.search(text):  # the parser's work grows with the square of the parts
        raise ConfigurationError([f"{source}: not valid TOML: {TOML_DEPTH.problem()}"])
    try:
        data = tomllib.loads(text)
    except ValueError as error:  # a TOMLDecodeError, or an integer of thousands of digits
        raise ConfigurationError([f"{source}: not valid TOML: {error}; correct the syntax"]) from None
    except RecursionError:
        raise ConfigurationError([f"{source}: not valid TOML: {TOML_DEPTH.problem()}"]) from None
    if _depth(data) > TOML_DEPTH.limit:
        raise ConfigurationError([f"{source}: {TOML_DEPTH.problem(_depth(data))}"])
    too_large = [
        f"{source}: {path}: a whole number beyond 64 bits; write a smaller one"
        for path, value in _leaves(data)
        if isinstance(value, int) and not -(1 << 63) <= value < 1 << 63
    ]
    if too_large:
        raise ConfigurationError(too_large)
    return data


def _depth(data: dict[str, Any]) -> int:
    """Return how many tables and lists are inside each other in plain data."""
    depth, level = 0, [*data.values()]
    while level := [value for value in level if isinstance(value, dict | list)]:
        depth += 1
        level = [item for each in level for item in (each.values() if isinstance(each, dict) else each)]
    return depth


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (key path, value) of everything in plain data that is neither a table nor a list."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _leaves(item, f"{path}.{key}" if path else key)
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from _leaves(item, f"{path}[{index}]")
    else:
        yield path, value


def validate(data: dict[str, Any], source: str, model: type[ModelT]) -> ModelT:
    """Return `data` as a checked `model`. Raises ConfigurationError with one line for each problem."""
    try:
        return model.model_validate(_tuples(data))
    except ValidationError as error:
        known = sorted(set(_field_names(model)))
        lines = [
            f"{source}: {_problem(details, data, known)}"
            for details in error.errors(include_url=False)
            if not _only_short_of_bad_entries(details)
        ]
        raise ConfigurationError(list(dict.fromkeys(lines))) from None


def read_strict(text: str, source: str, model: type[ModelT]) -> ModelT:
    """Return the `model` in the TOML `text`. Raises ConfigurationError with every problem."""
    return validate(parse_toml(text, source), source, model)


def _tuples(value: Any) -> Any:
    """Return the data with tuples instead of lists, so that the validated model is immutable."""
    if isinstance(value, list):
        return tuple(_tuples(item) for item in value)
    if isinstance(value, dict):
        return {key: _tuples(item) for key, item in value.items()}
    return value


def _field_names(model: type[BaseModel]) -> Iterator[str]:
    """Yield every key that a file of this model may contain, including nested tables."""
    schema = model.model_json_schema()
    for part in (schema, *schema.get("$defs", {}).values()):
        yield from part.get("properties", {})


def key_path(location: Sequence[int | str], data: Any) -> str:
    """Return `rotors[1].spin` for ("rotors", 1, "spin"), without the tags that pydantic adds for unions."""
    path = ""
    for position, item in enumerate(location):
        if isinstance(item, int):
            path += f"[{item}]"
            data = data[item] if isinstance(data, list | tuple) and item < len(data) else None
            continue
        if item == "[key]":  # pydantic's marker for a problem with the key itself
            continue
        last = position == len(location) - 1
        if isinstance(data, dict) and item not in data and not last:
            continue
        path += f".{item}" if path else item
        data = data.get(item) if isinstance(data, dict) else None
    return path


def value_at(data: Any, location: Sequence[int | str]) -> Any:
    """Return the value at a location in plain data, or None if there is none."""
    for item in location:
        try:
            data = data[item]
        except (LookupError, TypeError):
            return None
    return data


def number(value: Any) -> float | None:
    """Return the value as a float, or None if it is not a number or too large for a float."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value)
    except OverflowError:
        return None


_KINDS = {
    "float_type": "a number",
    "int_type": "a whole number",
    "string_type": "a text in quotes",
    "bool_type": "true or false",
    "tuple_type": "a list",
    "model_type": "a table",
    "mapping_type": "a table",
    "dict_type": "a table",
    "finite_number": "a finite number",
}


def _only_short_of_bad_entries(details: ErrorDetails) -> bool:
    """Return whether a list counts as too short only because pydantic does not count its invalid entries."""
    minimum = details.get("ctx", {}).get("min_length", 0)
    return details["type"] == "too_short" and len(details["input"]) >= minimum


def _problem(details: ErrorDetails, data: dict[str, Any], known: Sequence[str]) -> str:
    """Return one line with problem and remedy for one of pydantic's error records."""
    kind, location, context = details["type"], details["loc"], details.get("ctx", {})
    path = key_path(location, data)
    name = str(location[-1]) if location else ""
    given = _shown(details.get("input"))
    if kind == "missing":
        return f"{path}: missing; add it"
    if kind == "extra_forbidden":
        near = difflib.get_close_matches(name, [key for key in known if key != name], n=1)
        return f"{path}: unknown key; " + (f"did you mean {near[0]}?" if near else "remove it")
    if kind in _KINDS:
        return f"{path}: {given} is not {_KINDS[kind]}; write {_KINDS[kind]}"
    if kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal"):
        words = {"greater_than": "above", "greater_than_equal": "at least", "less_than": "below"}
        word, bound = words.get(kind, "at most"), next(iter(context.values()))
        return f"{path}: {given} is out of range; give a value {word} {bound:g}"
    if kind in ("too_long", "too_short"):
        count = context.get("max_length", context.get("min_length"))
        word = "at most" if kind == "too_long" else "at least"
        return f"{path}: {context.get('actual_length')} entries; give {word} {count}"
    if kind in ("literal_error", "enum"):
        return f"{path}: {given} is not possible; choose {context.get('expected')}"
    if kind in ("union_tag_not_found", "union_tag_invalid"):
        field = str(context.get("discriminator", "kind")).strip("'")
        expected = context.get("expected_tags")
        return f"{path}.{field}: " + (f"unknown; choose {expected}" if expected else "missing; add it")
    if kind == "string_pattern_mismatch":
        return f"{path}: {given} is not valid; it must match {context.get('pattern')}"
    message = details["msg"].removeprefix("Value error, ")
    return (f"{path}: " if path else "") + message


def _shown(value: Any) -> str:
    """Return the value as the user wrote it, shortened."""
    text = repr(list(value)) if isinstance(value, tuple) else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
