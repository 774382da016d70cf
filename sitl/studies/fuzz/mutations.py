"""Mutations of messages, files and texts."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from random import Random

from trimtab.sitl.studies.fuzz.inputs import REALS

_WORDS = (
    *(b"0", b"-1", b"1e308", b"-1e308", b"1e-320", b"nan", b"inf", b"-inf", b"99999999999999999999"),
    *(b'""', b'"x"', b"[]", b"{}", b"[[1.0]]", b"true", b"1979-05-27", b"0x7fffffffffffffff"),
    *(b"\xff", b"\\u0000", b"\n[a]\n", b"a." * 40, b"[" * 400, b"\x1b[2J", b"\xe2\x80\xae"),
)


def mutated(rng: Random, pieces: Sequence[bytes], most: int) -> bytes:
    """Return a damaged part of a recording, which is a list of consecutive writes."""
    start, size = rng.randrange(len(pieces)), rng.randrange(1, 8)
    chosen = list(pieces[start : start + size])
    for _ in range(rng.randrange(1, 4)):
        act, at = rng.randrange(8), rng.randrange(len(chosen))
        piece = chosen[at]
        if act <= 2 and piece:
            damaged = bytearray(piece)
            for _ in range(rng.choice((1, 1, 2, 8))):
                damaged[rng.randrange(len(damaged))] ^= 1 << rng.randrange(8)
            chosen[at] = bytes(damaged)
        elif act == 3:
            chosen[at] = piece[: rng.randrange(len(piece) + 1)]
        elif act == 4:
            chosen[at] = piece[rng.randrange(len(piece) + 1) :]
        elif act == 5:
            chosen.insert(at, piece)
        elif act == 6:
            rng.shuffle(chosen)
        else:
            chosen.insert(at, rng.randbytes(rng.randrange(1, 40)))
    return b"".join(chosen)[:most]


def mutated_file(rng: Random, content: bytes) -> bytes:
    """Return a damaged binary file: bits, numbers and lengths changed, parts cut, repeated or moved."""
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 4))):
        if not data:
            break
        act, at = rng.randrange(9), rng.randrange(len(data))
        size = rng.choice((1, 2, 4, 8, 52, rng.randrange(1, 1 + len(data))))
        if act <= 1:
            data[at] ^= 1 << rng.randrange(8)
        elif act == 2:
            data[at : at + size] = rng.choice((b"\0", b"\xff", rng.randbytes(1))) * min(size, len(data) - at)
        elif act == 3:
            del data[at:]
        elif act == 4:
            del data[at : at + size]
        elif act == 5:
            data[at:at] = data[at : at + size]
        elif act == 6:
            size = min(size, 8)
            data[at : at + size] = struct.pack("<d", rng.choice(REALS))[:size]
        elif act == 7:
            width = rng.choice((1, 2, 4, 8))
            value = rng.choice((0, 1, len(data), 1 << 8 * width - 1, -1, -2)) % (1 << 8 * width)
            data[at : at + width] = value.to_bytes(width, "little")
        else:
            other = rng.randrange(len(data))
            data[at : at + size] = data[other : other + size]
    return bytes(data)


def mutated_text(rng: Random, content: bytes) -> bytes:
    """Return a TOML file with changed numbers, words and lines, which may be invalid TOML."""
    lines = content.split(b"\n")
    for _ in range(rng.choice((1, 1, 2, 5))):
        act, at = rng.randrange(8), rng.randrange(len(lines))
        line = lines[at]
        if act <= 2 and b"=" in line:
            key, _, value = line.partition(b"=")
            lines[at] = key + b"= " + rng.choice((rng.choice(_WORDS), _other_number(rng, value)))
        elif act == 3:
            lines.insert(rng.randrange(len(lines)), line)
        elif act == 4 and len(lines) > 1:
            del lines[at]
        elif act == 5:
            lines[at] = (
                line.replace(b"_", b"", 1) if rng.random() < 0.5 else line[: rng.randrange(len(line) + 1)]
            )
        elif act == 6:
            cut = rng.randrange(len(line) + 1)
            lines[at] = line[:cut] + rng.choice((rng.choice(_WORDS), rng.randbytes(3))) + line[cut:]
        else:
            cut, many = rng.randrange(len(line) + 1), rng.choice((2, 50, 5000))
            one = line[cut : cut + 1] or rng.choice((b"[", b"{", b"9", b"."))
            lines[at] = line[:cut] + one * many + line[cut:]
    return b"\n".join(lines)


def _other_number(rng: Random, value: bytes) -> bytes:
    """Return the text with one of its digits replaced or repeated."""
    places = [i for i, c in enumerate(value) if c in b"0123456789"]
    if not places:
        return value
    at = rng.choice(places)
    return (
        value[:at]
        + rng.choice(b"0123456789-e.").to_bytes(1, "little") * rng.choice((1, 1, 6))
        + value[at + 1 :]
    )
