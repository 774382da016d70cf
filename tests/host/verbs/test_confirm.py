"""The question before arming, at a real terminal."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator

import pytest

from trimtab.host.verbs.confirm import ask_at_terminal


@pytest.fixture
def type_line(
    monkeypatch: pytest.MonkeyPatch, require: Callable[[str], None]
) -> Iterator[Callable[[str], None]]:
    """Types at the terminal that is stdin."""
    require("pty")
    keyboard, terminal = os.openpty()
    with open(terminal, encoding="utf-8") as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        yield lambda line: (os.write(keyboard, line.encode()), None)[1]
    os.close(keyboard)


def answered(answer: Callable[[], bool | None]) -> bool:
    """The answer, once there is one. The test's time limit ends a wait for ever."""
    while (given := answer()) is None:
        os.sched_yield()
    return given


@pytest.mark.parametrize(
    ("line", "expected"), [("yes\n", True), (" YES \n", True), ("y\n", False), ("\n", False)]
)
def test_only_yes_arms(type_line: Callable[[str], None], line: str, expected: bool) -> None:
    answer = ask_at_terminal(("Ready.",))
    assert answer() is None
    type_line(line)
    assert answered(answer) is expected


def test_line_typed_before_the_question_is_no_answer(
    type_line: Callable[[str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    type_line("yes\n")
    answer = ask_at_terminal(("Ready.",))
    assert capsys.readouterr().err == "Ready.\nType yes and Enter to arm: "
    type_line("no\n")
    assert answered(answer) is False


def test_end_of_the_terminal_is_a_no(type_line: Callable[[str], None]) -> None:
    answer = ask_at_terminal(())
    type_line("\x04")
    assert answered(answer) is False
