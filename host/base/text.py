"""Text with file names that the locale cannot decode.

Python holds each undecodable byte of a file name as a surrogate character (PEP 383). UTF-8 has no surrogates,
so they must not reach an artefact. In the locale C they stand for every letter beyond ASCII.
"""

from __future__ import annotations

import codecs
import os

ESCAPE = "trimtab-escape"
"""Name of an error handler for encoding: a surrogate as its byte, another character as escape sequence."""


def readable(text: str, errors: str = "replace") -> str:
    """Return `text` with the bytes that its surrogates stand for decoded as UTF-8.

    errors: what becomes of bytes that are no UTF-8, as in `bytes.decode`; by default U+FFFD.
    """
    return text.encode("utf-8", "surrogateescape").decode("utf-8", errors)


def file_name(text: str) -> str:
    """Return the name under which the system knows a file that a UTF-8 text names; inverse of `readable`."""
    return os.fsdecode(text.encode("utf-8", "surrogateescape"))


def _escape(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    character = error.object[error.start]
    if "\udc80" <= character <= "\udcff":
        return character.encode("utf-8", "surrogateescape"), error.start + 1
    return character.encode("ascii", "backslashreplace").decode(), error.start + 1


codecs.register_error(ESCAPE, _escape)
