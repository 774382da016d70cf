"""Options that verbs share, as annotated types for their parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

Json = Annotated[
    bool, Parameter(name="--json", negative="", help="Print one JSON object as the last line of stdout.")
]

Force = Annotated[bool, Parameter(name="--force", negative="", help="Overwrite the output file.")]

Output = Annotated[Path | None, Parameter(name=["-o", "--output"])]
"""Each verb says in its docstring what it writes, and under which name without this."""

VehicleName = Annotated[str, Parameter(name="--vehicle", help="Vehicle file, by name or path.")]

WorkspaceFolder = Annotated[
    Path | None,
    Parameter(
        name="--workspace", help="Folder with vehicles/, routes/ and effects/; the current one by default."
    ),
]

DEFAULT_VEHICLE = "research"
