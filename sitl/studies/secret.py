"""The secret that the worlds of a sealed study come from.

Its SHA-256 is published before the study, and the secret itself in the report. So nobody can choose the
worlds after a look at results, and everybody can draw them again.
"""

from __future__ import annotations

import hashlib
import re
import secrets
from contextlib import suppress
from pathlib import Path

from trimtab.host.base.artefacts import write_atomic
from trimtab.host.base.errors import UsageError
from trimtab.host.base.parts import NameTaken
from trimtab.sitl.studies.files import StudyError

_BYTES = 32


def read_secret(path: Path) -> str:
    """Return the secret in a file, 64 hex digits; make the file with a random one if it does not exist.

    Raises StudyError if the file holds something else, or cannot be read or made.
    """
    try:
        if not path.exists():
            with suppress(NameTaken):  # another process has made it meanwhile
                write_atomic(path, f"{secrets.token_hex(_BYTES)}\n", mode=0o600)
        text = path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError, UsageError) as error:
        raise StudyError(f"--secret {path}: cannot be read or made ({error}); give another file") from None
    if not re.fullmatch(r"[0-9a-f]{64}", text):
        raise StudyError(f"--secret {path}: holds no 64 hex digits; give another file, or a new name")
    return text


def commitment(secret: str) -> str:
    """Return the SHA-256 of a secret's 64 hex digits as ASCII."""
    return hashlib.sha256(secret.encode()).hexdigest()
