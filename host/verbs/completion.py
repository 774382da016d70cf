"""`trimtab completion`: complete verbs, options and files in a shell."""

from __future__ import annotations

from typing import Literal


def command(shell: Literal["bash", "zsh", "fish"]) -> None:
    """Print a script for a shell, which then completes verbs, options and the names of files.

    Parameters
    ----------
    shell
        Shell that the script is for. Add a line to its start file: `eval "$(trimtab completion bash)"` to
        ~/.bashrc, `eval "$(trimtab completion zsh)"` to ~/.zshrc after compinit, or
        `trimtab completion fish | source` to ~/.config/fish/config.fish.
    """
    import re

    from trimtab.host.base.output import say
    from trimtab.host.cli import build_app

    script = build_app().generate_completion(shell=shell).rstrip()
    if shell == "zsh" and (function := re.search(r"^(_\w+)\(\)", script, flags=re.MULTILINE)):
        script += f"\n\ncompdef {function[1]} trimtab"  # else zsh finds it only as a file with a certain name
    say(*script.split("\n"))
