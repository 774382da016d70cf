"""Rendering of the templates in this folder to escaped, self-contained pages."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from jinja2 import Environment, FunctionLoader, StrictUndefined, select_autoescape

from trimtab.host.base.output import json_text

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
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(**values)


def script_data(answer: Mapping[str, Any]) -> str:
    """Return JSON that is safe inside a script element."""
    return json_text(answer).replace("</", "<\\/")
