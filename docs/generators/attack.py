"""Generate docs/studies/attack.md, on attacks on the link, from the study's report.

`python docs/generators/attack.py study-attack-SEED/report.json FILE` writes it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trimtab.host.apps.paper.text import markdown, wrapped
from trimtab.sitl.studies.attack.flights import CRASH_M_S, DEPARTED_M, FLOOD_HZ
from trimtab.sitl.studies.attack.study import summary

_HEAD = """# Attacks on the link

<!-- Made by docs/generators/attack.py from the study's report; change it there. -->

    {command}
    trimtab study attack --quick

A stranger shares the vehicle's port and hears everything, but does not have the key. What can it do to the
vehicle, to its owner and to the port? An interrupted study resumes. `--quick` sends fewer frames and flies
each case once.

Results of seed {seed}, commit {git}.{quick}

"""

_REST = """## What an attacker can still do

- Jam the radio, or fill it with valid frames. The vehicle then lands by the
[failsafe table](../reference/failsafes.md).
- Read everything: positions, parameters, references. Signing hides nothing. Who sends how much and when can
be seen too.
- Without a key on the vehicle: do what its owner can do, under the owner's address. `trimtab fly` reports
commands that it did not give. It cannot report a forced disarm before the vehicle falls.
- Without a key on the vehicle: land it or stop its motors under any address, because `OWN_OTHERS` is 2 by
default. With 1, a stranger can only land it; with 0, it can do neither.
- Without a key on the vehicle: keep it from flying. A stranger can set parameters in standby, or send poses;
`trimtab fly` then refuses to fly, or arming is refused.
- With the key, for example from a copied file: everything. Keep key files readable by their owner only.
- With the vehicle in hand: install another key by cable.
- Deceive the cameras, or the network between cameras and host. The poses of the cameras are not signed on
their way to the host: keep that network closed.

## Method

**Frames.** The verifier and decoder are those of the vehicle's firmware. The owner sends commands,
parameters, poses and setpoints, all signed. Each forged frame is valid in form: header, length and checksum
are right, and all fields but one are those of the owner's next frame. It arrives before that frame, which
must still be accepted (otherwise a lockout is counted). Genuine frames are sent again at once or later, in
random order and twice, 2.5 s late, and after a power cycle. At the end, a second station with the key and a
right clock must be accepted too.

**Weakened verifiers.** The same frames go to verifiers that lack one check. A study that caught none of them
would prove nothing.

**Flights.** In lock-step through firmware and radio. The stranger interferes from 1 s after tracking began;
parameters it sets at any time. A flight counts as changed if another command took effect, if the vehicle hit
the floor faster than {crash:g} m/s, or if its true position departed from the undisturbed flight by more
than {departed:g} m while `fly` reports it as flown. *Owner's address* means that the stranger puts the
owner's MAVLink address into its frames.

**Floods.** {rate:,} valid packets a second of a stranger at the port, next to the host, through the fair
share that a served port gives its clients. The same flight without the flood has the same noise.

**Crowds** join a flight over TCP in real time. **Paths that climb** go to MAVLink FTP.
"""


def page(report: Mapping[str, Any]) -> str:
    """Return the page as Markdown for the JSON of a study's report."""
    head = _HEAD.format(
        command=report["provenance"]["command"],
        seed=report["seed"],
        git=report["provenance"]["git"],
        quick=" These are quick development figures, not for the record." if report["quick"] else "",
    )
    made = summary({key: report[key] for key in ("seed", "quick", "folder")}, report["scores"])
    answer = made["answer"]
    figures = [
        {
            "figure": "forged or repeated frames accepted, of " + f"{answer['trials']:,}",
            "value": answer["accepted"],
        },
        {"figure": "times that a holder of the key was locked out", "value": answer["lockouts"]},
        {
            "figure": "weakened verifiers caught",
            "value": f"{answer['mutants_caught']} of {answer['mutants']}",
        },
        {
            "figure": f"flights changed by a stranger, of {answer['flights']}, beyond what `OWN_OTHERS` "
            "allows and without a false sender",
            "value": answer["takeovers"],
        },
        {"figure": "changed flights that `fly` reported as flown", "value": answer["misreported"]},
        {"figure": "crashes, likewise", "value": answer["crashes"]},
        {"figure": "crashes by a termination that `OWN_OTHERS` allows", "value": answer["terminations"]},
        {
            "figure": "crashes under the owner's address without a key",
            "value": answer["false_sender_crashes"],
        },
        {
            "figure": "tracking error under a flood over without, greatest",
            "value": f"{answer['flood_ratio_max']:.3f}",
        },
    ]
    rows = [{key: str(value) for key, value in row.items()} for row in figures]
    sections = [f"### {title}\n\n{markdown(table)}\n" for title, table in made["tables"].items()]
    rest = _REST.format(crash=CRASH_M_S, departed=DEPARTED_M, rate=FLOOD_HZ)
    return f"{wrapped(head)}{markdown(rows)}\n\n" + "\n".join(sections) + "\n" + wrapped(rest)


if __name__ == "__main__":
    report = json.loads(Path(sys.argv[1]).read_text("utf-8"))
    Path(sys.argv[2]).write_text(page(report), encoding="utf-8")
