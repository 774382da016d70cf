"""Sequence picture of a simulated upload over a lossy link with a cut.

`python -m trimtab.sitl.studies.upload_picture FILE` writes it. Time runs downwards; every line is a radio
frame.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.sax.saxutils import escape

from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import (
    HOST,
    Message,
    UploadBegin,
    UploadChunk,
    UploadCommit,
    UploadResult,
    UploadState,
    UploadStatus,
    UploadVerdict,
)
from trimtab.sitl.radio import Radio
from trimtab.sitl.studies.upload_blob import reference_blob
from trimtab.sitl.studies.upload_rig import UploadRig, begin_us
from trimtab.sitl.studies.uploads import GIVE_UP_US, LATENCY_US
from trimtab.sitl.world import RadioSettings

SEED, NODES, LOSS = 9, 70, 0.15
CUT_AFTER_US, CUT_US = 75_000, 100_000
_WIDTH, _HOST_X, _VEHICLE_X, _TOP = 1200, 330, 870, 70
_PX_PER_MS, _ROW = 5.2, 11.0
_COLOURS = {"chunk": "#1d6f8a", "again": "#c8641b", "word": "#333333", "other": "#c9c9c9"}


@dataclass
class Frame:
    """A radio frame: time sent, time received (None: lost), and messages."""

    up: bool
    data: bytes
    left_us: int
    arrived_us: int | None = None
    messages: list[Message] = field(default_factory=list)


class _Tap:
    """A radio whose frames are recorded."""

    def __init__(self, radio: Radio, up: bool, frames: list[Frame]) -> None:
        self._radio, self._up, self._frames = radio, up, frames

    @property
    def has_frame(self) -> bool:
        return self._radio.has_frame

    @property
    def pose_waits(self) -> bool:
        return self._radio.pose_waits

    def air_send(self, now_us: int) -> bytes | None:
        data = self._radio.air_send(now_us)
        if data is not None:
            self._frames.append(Frame(up=self._up, data=data, left_us=now_us))
        return data

    def air_receive(self, frame: bytes, now_us: int) -> None:
        for sent in self._frames:
            if sent.up != self._up and sent.arrived_us is None and sent.data == frame:
                sent.arrived_us = now_us
                break
        self._radio.air_receive(frame, now_us)


def record(seed: int = SEED) -> tuple[list[Frame], int, tuple[int, int], int]:
    """Return the frames of an upload, its start, the start and end of the cut, and its end (us)."""
    frames: list[Frame] = []
    start_us = begin_us(seed, 0)
    cut_us = (start_us + CUT_AFTER_US, start_us + CUT_AFTER_US + CUT_US)
    radio = RadioSettings(
        loss=LOSS,
        burst_frames=1.0 / (1.0 - LOSS),
        latency_us=LATENCY_US,
        duplicate=0.0,
        corrupt=0.0,
        cuts_s=((cut_us[0] * 1e-6, CUT_US * 1e-6),),
    )
    rig = UploadRig(
        reference_blob("research", 1, NODES),
        old=reference_blob("research", 0, NODES),
        radio=radio,
        seed=seed,
        number=0,
        tap=lambda radio, of_ground: _Tap(radio, of_ground, frames),
    )
    rig.run(GIVE_UP_US)
    shown = [frame for frame in frames if frame.left_us >= start_us]
    for frame in shown:
        frame.messages = list(Codec(*HOST).decode(frame.data))
    return shown, start_us, cut_us, rig.now_us


def picture(seed: int = SEED) -> str:
    """Return the picture as SVG."""
    frames, start_us, cut_us, end_us = record(seed)

    def y(t_us: int) -> float:
        return _TOP + (t_us - start_us) * 1e-3 * _PX_PER_MS

    height = round(y(end_us)) + 60
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height}" '
        f'font-family="sans-serif" font-size="11">',
        f'<rect width="{_WIDTH}" height="{height}" fill="white"/>',
        _text(_WIDTH / 2, 18, f"Upload of {NODES} nodes in 38 chunks: {100 * LOSS:.0f} % of the frames are "
              f"lost, and the link is cut for {CUT_US // 1000} ms", "middle", size=14),
        f'<rect x="{_HOST_X}" y="{y(cut_us[0]):.1f}" width="{_VEHICLE_X - _HOST_X}" '
        f'height="{y(cut_us[1]) - y(cut_us[0]):.1f}" fill="#f3d9d9"/>',
        _text(_WIDTH / 2, y(cut_us[1]) - 60, "link cut", "middle", "#a33", 14),
        *(
            f'<line x1="{x}" y1="{_TOP - 14}" x2="{x}" y2="{height - 30}" stroke="#333" stroke-width="1.5"/>'
            for x in (_HOST_X, _VEHICLE_X)
        ),
        _text(_HOST_X, _TOP - 22, "host and ground radio", "middle", size=13),
        _text(_WIDTH / 2, _TOP - 22, "air", "middle", size=13),
        _text(_VEHICLE_X, _TOP - 22, "vehicle", "middle", size=13),
        *_scale(y, start_us, end_us),
    ]  # fmt: skip
    sent_before: set[int] = set()
    labels: dict[bool, list[tuple[float, str, str]]] = {True: [], False: []}
    for frame in frames:
        kind, label = _described(frame, sent_before)
        at = y(frame.left_us)
        parts += _line(frame, kind, at, None if frame.arrived_us is None else y(frame.arrived_us))
        if label:
            labels[frame.up].append((at, label, _COLOURS[kind]))
    parts += _labels(labels[True], _HOST_X - 12, "end")
    parts += _labels(labels[False], _VEHICLE_X + 12, "start")
    parts += [*_legend(height), "</svg>"]
    return "\n".join(parts) + "\n"


def _described(frame: Frame, sent_before: set[int]) -> tuple[str, str]:
    """Return kind and label of a frame; chunks that are sent again are marked."""
    words, kind = [], "other"
    for message in frame.messages:
        if isinstance(message, UploadChunk):
            again = message.index in sent_before
            sent_before.add(message.index)
            kind = "again" if again else "chunk"
            words.append(f"chunk {message.index}{' again' if again else ''}")
        elif isinstance(message, UploadStatus):
            words.append(_status(message))
        elif isinstance(message, UploadVerdict):
            words.append("VERDICT accepted" if message.ok else "VERDICT refused")
        elif isinstance(message, UploadBegin | UploadCommit):
            words.append("BEGIN" if isinstance(message, UploadBegin) else "COMMIT")
    if words and kind == "other":
        kind = "word"
    return kind, ", ".join(words)


def _status(status: UploadStatus) -> str:
    state, result = UploadState(status.state), UploadResult(status.result)
    if state is UploadState.RECEIVING:
        return f"STATUS {status.held} held"
    return f"STATUS {state.name}" if result is UploadResult.OK else f"STATUS {state.name} {result.name}"


def _line(frame: Frame, kind: str, y0: float, y1: float | None) -> Iterator[str]:
    """Yield the frame's line, to its far end or to a cross half-way."""
    x0, x1 = (_HOST_X, _VEHICLE_X) if frame.up else (_VEHICLE_X, _HOST_X)
    colour, width = _COLOURS[kind], 0.7 if kind == "other" else 1.2
    dash = "" if frame.up else ' stroke-dasharray="5 3"'
    if y1 is None:
        x1, y1 = (x0 + x1) / 2, y0 + 0.5 * _PX_PER_MS * (2.0 + LATENCY_US * 1e-3)
        yield (
            f'<path d="M{x1 - 4:.1f} {y1 - 4:.1f}l8 8m0 -8l-8 8" stroke="#c22" stroke-width="1.6" '
            'fill="none"/>'
        )
    yield (
        f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" stroke="{colour}" '
        f'stroke-width="{width}"{dash}/>'
    )


def _labels(labels: Sequence[tuple[float, str, str]], x: float, anchor: str) -> Iterator[str]:
    """Yield labels below each other. A line connects each label to its position."""
    last = -_ROW
    for at, label, colour in labels:
        y = max(at, last + _ROW)
        last = y
        tie = 9 if anchor == "end" else -9
        yield (
            f'<line x1="{x + tie:.1f}" y1="{at:.1f}" x2="{x:.1f}" y2="{y:.1f}" stroke="{colour}" '
            f'stroke-width="0.6"/>'
        )
        yield _text(x - (2 if anchor == "end" else -2), y + 3.5, label, anchor, colour)


def _scale(y: Callable[[int], float], start_us: int, end_us: int) -> Iterator[str]:
    for t_ms in range(0, (end_us - start_us) // 1000 + 1, 20):
        at = y(start_us + 1000 * t_ms)
        yield f'<line x1="60" y1="{at:.1f}" x2="68" y2="{at:.1f}" stroke="#888"/>'
        yield _text(55, at + 4, f"{t_ms} ms", "end", "#666")


def _legend(height: int) -> Iterator[str]:
    y, x = height - 14, 150
    for kind, word in (
        ("chunk", "chunk"),
        ("again", "chunk sent again"),
        ("word", "BEGIN, COMMIT, STATUS, VERDICT"),
        ("other", "telemetry"),
    ):
        colour = _COLOURS[kind]
        yield f'<line x1="{x}" y1="{y - 4}" x2="{x + 26}" y2="{y - 4}" stroke="{colour}" stroke-width="2"/>'
        yield _text(x + 32, y, word, "start")
        x += 70 + 7 * len(word)
    yield f'<path d="M{x} {y - 8}l8 8m0 -8l-8 8" stroke="#c22" stroke-width="1.6" fill="none"/>'
    yield _text(x + 14, y, "lost", "start")


def _text(x: float, y: float, text: str, anchor: str, colour: str = "#333", size: int = 11) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}" font-size="{size}">'
        f"{escape(text)}</text>"
    )


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(picture(), encoding="utf-8")
