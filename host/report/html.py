"""Rendering of the templates in this folder to escaped, self-contained pages."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from jinja2 import Environment, FunctionLoader, StrictUndefined, select_autoescape
from markupsafe import Markup

from trimtab.host.base.output import json_text
from trimtab.host.base.text import escaped

VERDICTS = {
    "traced": "traced",
    "nothing-missing": "nothing missing",
    "undecided": "undecided",
    "outside-library": "outside the library",
    "learned": "learned",
    None: "none stated",
}
"""Words for the verdict of a trace or model."""


def render(template: str, **values: Any) -> str:
    """Return the HTML of a template with these values. Raises jinja2's error if one is missing."""
    environment = Environment(
        loader=FunctionLoader(
            lambda name: files("trimtab.host.report").joinpath(name).read_text(encoding="utf-8")
        ),
        autoescape=select_autoescape(default_for_string=True, default=True),
        undefined=StrictUndefined,
        finalize=_visible,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(**values)


def script_data(answer: Mapping[str, Any]) -> str:
    """Return JSON that is safe inside a script element, with texts that are safe to show."""
    plain = json.loads(json_text(answer), object_pairs_hook=_visible_object)
    return json_text(plain).replace("</", "<\\/")


def _visible(value: Any) -> Any:
    """Return what a template shows for a value: markup of ours as it is, texts with what cannot be seen."""
    return escaped(value, lines=True) if isinstance(value, str) and not isinstance(value, Markup) else value


def _visible_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    return {_visible(key): _visible_value(value) for key, value in pairs}


def _visible_value(value: Any) -> Any:
    return [_visible_value(item) for item in value] if isinstance(value, list) else _visible(value)
