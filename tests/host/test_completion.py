"""The completion that a shell loads, asked in a real bash."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from trimtab.host import cli
from trimtab.host.cli import VERBS

_ASK = """
eval "$SCRIPT"
spec=$(complete -p trimtab)
function=$(sed 's/.*-F \\([^ ]*\\).*/\\1/' <<<"$spec")
COMP_WORDS=("$@")
COMP_CWORD=$(($# - 1))
COMP_LINE="$*" COMP_POINT=${#COMP_LINE}
"$function" trimtab "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD - 1]}"
printf '%s\\n' "${COMPREPLY[@]}"
"""


def script_for(shell: str, capsys: pytest.CaptureFixture[str]) -> str:
    """The script that `trimtab completion` prints."""
    assert cli.main(["completion", shell]) == 0
    return capsys.readouterr().out


def completed(script: str, folder: Path, *words: str) -> list[str]:
    """What bash proposes for the last of these words."""
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("bash: not on PATH")
    done = subprocess.run(
        [bash, "--norc", "-c", _ASK, "bash", "trimtab", *words],
        capture_output=True,
        text=True,
        check=True,
        cwd=folder,
        env={"SCRIPT": script, "PATH": "/usr/bin:/bin"},
    )
    assert done.stderr == ""
    return done.stdout.split()


def test_bash_completes_verbs_options_choices_and_files(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    script = script_for("bash", capsys)
    for name in ("eight.ref", "eight.mcap", "other.txt"):
        (tmp_path / name).touch()
    assert completed(script, tmp_path, "") == [verb.name for verb in VERBS]
    assert completed(script, tmp_path, "tr") == ["trace"]
    assert completed(script, tmp_path, "vehicle", "c") == ["check"]
    assert completed(script, tmp_path, "trace", "--hold") == ["--hold-out"]
    assert completed(script, tmp_path, "completion", "f") == ["fish"]
    assert completed(script, tmp_path, "export", "eight.ref", "--format", "cr") == ["crazyflie"]
    for words in (["fly", "eig"], ["trace", "eig"], ["trace", "eight.mcap", "--hold-out", "eig"]):
        assert sorted(completed(script, tmp_path, *words)) == ["eight.mcap", "eight.ref"], words


@pytest.mark.parametrize(("shell", "first"), [("zsh", "#compdef trimtab"), ("fish", "# Fish completion")])
def test_scripts_for_other_shells_name_every_verb(
    capsys: pytest.CaptureFixture[str], shell: str, first: str
) -> None:
    script = script_for(shell, capsys)
    assert script.startswith(first)
    for verb in VERBS:
        assert verb.name in script
    if shell == "zsh":
        assert re.search(r"^compdef _\w+ trimtab$", script, flags=re.MULTILINE)


def test_other_shell_is_refused_with_the_choices(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["completion", "csh"]) == 2
    assert "fish" in capsys.readouterr().err
