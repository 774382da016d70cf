"""Python and the packages that Trimtab needs or can use, as its metadata states them."""

from __future__ import annotations

import platform
import re
from importlib import metadata

from trimtab.host.apps.doctor.check import Check
from trimtab.host.base.artefacts import version
from trimtab.host.base.extras import install_command, requirements

EXTRAS = {
    "logs": "no imports of PX4 and ROS logs, and no export of ROS bags",
    "watch": "no live view",
    "clients": "no flights by MAVProxy and MAVSDK",
}
"""Optional parts, and what does not work without each. The compiler has a check of its own."""
_REQUIREMENT = re.compile(r"([\w.-]+)(?:\[[\w,-]+\])?\s*(?:>=\s*([\d.]+))?")


def python() -> Check:
    """Return the check of the version of Python."""
    text = f"{platform.python_version()}, with Trimtab {version()}"
    bound = metadata.metadata("trimtab")["Requires-Python"].removeprefix(">=")
    if is_older(platform.python_version(), bound):
        remedy = f"install Trimtab with Python {bound} or newer"
        return Check(name="python", status="problem", text=text, remedy=remedy)
    return Check(name="python", status="ok", text=text)


def required() -> Check:
    """Return the check of the packages that every installation needs."""
    wrong = missing(None)
    if not wrong:
        return Check(name="packages", status="ok", text="all that Trimtab needs are installed")
    remedy = "install Trimtab again with its dependencies"
    return Check(name="packages", status="problem", text="; ".join(wrong), remedy=remedy)


def extras() -> list[Check]:
    """Return a check for each optional part."""
    checks = []
    for extra, lost in EXTRAS.items():
        wrong, name = missing(extra), f"extra {extra}"
        if wrong:
            text, remedy = f"{'; '.join(wrong)}: {lost}", f"run {install_command(extra)}"
            checks.append(Check(name=name, status="note", text=text, remedy=remedy))
        else:
            checks.append(Check(name=name, status="ok", text="installed"))
    return checks


def missing(extra: str | None) -> list[str]:
    """Return what is wrong with the packages of an extra, or for None with those always needed."""
    wrong = []
    for requirement in requirements(extra):
        match = _REQUIREMENT.match(requirement)
        if match is None:
            continue
        name, bound = match[1], match[2]
        try:
            present = metadata.version(name)
        except metadata.PackageNotFoundError:
            wrong.append(f"{name} is not installed")
            continue
        if bound is not None and is_older(present, bound):
            wrong.append(f"{name} {present} is older than {bound}")
    return wrong


def is_older(present: str, bound: str) -> bool:
    """Return whether a version such as 1.10.2rc1 is below a bound such as 1.9, by its numbers."""
    return _numbers(present) < _numbers(bound)


def _numbers(text: str) -> list[int]:
    """Return the numbers of a version before any letter, without zeros at the end."""
    numbers = [int(part) for part in re.findall(r"\d+", re.split(r"[^\d.]", text)[0])]
    while numbers[-1:] == [0]:
        numbers.pop()
    return numbers
