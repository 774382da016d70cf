"""`trimtab doctor`: check that Trimtab works on this machine and in this workspace."""

from __future__ import annotations

from trimtab.host.verbs.options import Json, Trust, WorkspaceFolder


def command(*, workspace: WorkspaceFolder = None, trust: Trust = False, json: Json = False) -> None:
    """Check that Trimtab works here: packages, compiled code, files of the workspace, and ports.

    Nothing is sent over the network. The exit code is 1 if a part of Trimtab does not work.
    """
    from dataclasses import asdict

    from trimtab.host.apps.doctor.run import all_checks
    from trimtab.host.base.errors import GateMissed
    from trimtab.host.base.output import emit, say

    checks = all_checks(workspace, trusted=trust)
    problems = [check for check in checks if check.status == "problem"]
    say(*(check.to_line() for check in checks))
    emit({"works": not problems, "checks": [asdict(check) for check in checks]}, json)
    if problems:
        raise GateMissed(f"{len(problems)} of {len(checks)} checks found a problem; see their lines")
