"""The running program: its version, an id of its source, and the commit of its checkout."""

from __future__ import annotations

import hashlib
import subprocess
from functools import cache
from importlib import metadata
from pathlib import Path

CHANGED = "-dirty"
"""End of `git_state` if files of the checkout differ from its commit."""
_ROOT = Path(__file__).resolve().parents[2]
_PACKAGES = ("firmware_model", "host", "protocol", "sitl")
_SUFFIXES = frozenset({".c", ".h", ".proto", ".py", ".toml", ".xml"})


def version() -> str:
    """Return the installed version of Trimtab."""
    return metadata.version("trimtab")


@cache
def program_id() -> str:
    """Return the first 12 hex digits of the SHA-256 of the program's source files.

    A checkout and the package that is made from it have the same; any change of the code gives another one.
    """
    digest = hashlib.sha256()
    for package in _PACKAGES:
        for path in sorted((_ROOT / package).rglob("*")):
            if path.suffix in _SUFFIXES and path.is_file():
                content = path.read_bytes()
                digest.update(f"{path.relative_to(_ROOT).as_posix()} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:12]


def git_state() -> str | None:
    """Return the commit of the checkout of this code, with CHANGED for changes.

    None outside a checkout or without git. A checkout of another user is asked too: its code is running.
    """
    if not (_ROOT / ".git").exists():
        return None
    describe = ("describe", "--always", f"--dirty={CHANGED}", "--abbrev=12", "--exclude=*")
    command = ["git", "-c", f"safe.directory={_ROOT}", "-C", str(_ROOT), *describe]
    try:
        answer = subprocess.run(command, capture_output=True, check=False, timeout=10)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return answer.stdout.decode(errors="replace").strip() or None
