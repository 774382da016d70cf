"""Text from outside: file names that the locale cannot decode, and characters that change what is shown.

A name or message may hold characters that a terminal or page obeys instead of showing: control characters,
line breaks, marks that turn the direction of writing, and characters without width. `escaped` makes them
visible. It is applied where text leaves the program: in `output`, `progress` and `live` for the
terminal, `card` and `trimtab.host.report.html` for pages, and the writer of flight logs.

Python holds each undecodable byte of a file name as a surrogate character (PEP 383). UTF-8 has no surrogates,
so they must not reach an artefact. In the locale C they stand for every letter beyond ASCII.
"""

from __future__ import annotations

import codecs
import os
import unicodedata

ESCAPE = "trimtab-escape"
"""Name of an error handler for encoding: a surrogate as its byte, another character as escape sequence."""


def readable(text: str, errors: str = "replace") -> str:
    """Return `text` with the bytes that its surrogates stand for decoded as UTF-8.

    errors: what becomes of bytes that are no UTF-8, as in `bytes.decode`; by default U+FFFD.
    """
    return text.encode("utf-8", "surrogateescape").decode("utf-8", errors)


def escaped(text: str, *, lines: bool = False) -> str:
    r"""Return `text` with every character that cannot be seen as escape sequence, as `\x1b` or `\u202e`.

    Letters, marks, digits, signs and spaces of all scripts stay as they are. lines: so do line feeds.
    """
    if (text.replace("\n", "") if lines else text).isprintable():
        return text
    decoded = text.encode("utf-8", ESCAPE).decode("utf-8", "surrogateescape")
    shown = "".join(
        letter if _is_visible(letter) or (lines and letter == "\n") else _sequence(letter)
        for letter in decoded
    )
    return shown if decoded == text else file_name(shown)


def _is_visible(letter: str) -> bool:
    # A surrogate stands for a byte of a file name; those from 0xa0 on are letters in an old encoding.
    return letter.isprintable() or unicodedata.category(letter) == "Zs" or "\udca0" <= letter <= "\udcff"


def _sequence(letter: str) -> str:
    if "\udc80" <= letter <= "\udcff":
        return f"\\x{ord(letter) - 0xDC00:02x}"
    return letter.encode("unicode_escape").decode("ascii")


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
