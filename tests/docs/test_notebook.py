"""The notebook of the guide runs from its first cell to its last, and its verdict is right."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

NOTEBOOK = Path(__file__).parents[2] / "docs" / "guide" / "notebook.ipynb"
CONTENT: dict[str, Any] = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
ASKED = """
import json

print(json.dumps({
    "verdict": str(trace.verdict),
    "effects": {
        each.name: {key: [value.value, value.sd] for key, value in each.parameters.items()}
        for each in trace.effects
    },
    "errors_m": [flown[1].tracking_rmse_m, again.tracking_rmse_m],
    "durations_s": [
        1e-6 * tt.read_reference(f"{name}.ref").duration_us for name in ("sprint", "sprint-again")
    ],
}))
"""
"""A cell that the test adds."""


def test_notebook_in_the_repository_is_small_and_has_no_outputs() -> None:
    assert NOTEBOOK.stat().st_size < 20_000
    for cell in CONTENT["cells"]:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None
    text = NOTEBOOK.read_text(encoding="utf-8")
    assert not [word for word in ("/home", "/root", "/tmp", "/work", "C:") if word in text]


@pytest.mark.full
@pytest.mark.long
@pytest.mark.timeout(900)
def test_notebook_runs_and_its_verdict_is_the_effect_of_its_world(tmp_path: Path) -> None:
    nbclient = pytest.importorskip("nbclient", reason="requirements-all.lock installs nbclient")
    pytest.importorskip("ipykernel", reason="requirements-all.lock installs ipykernel")
    import nbformat

    notebook: Any = nbformat.reads(NOTEBOOK.read_text(encoding="utf-8"), as_version=4)
    notebook.cells.append(nbformat.v4.new_code_cell(ASKED))
    client = nbclient.NotebookClient(notebook, timeout=800, resources={"metadata": {"path": str(tmp_path)}})
    client.execute()
    outputs = {cell.id: cell.outputs for cell in notebook.cells if cell.cell_type == "code"}
    assert [out for every in outputs.values() for out in every if out.get("name") == "stderr"] == []
    answer = json.loads(outputs[notebook.cells[-1].id][0].text)
    assert answer["verdict"] == "traced"
    assert set(answer["effects"]) == {"linear-drag"}
    for key, true in (("dx", 0.5), ("dy", 0.45), ("dz", 0.25)):
        value, sd = answer["effects"]["linear-drag"][key]
        assert abs(value - true) < min(3.0 * sd, 0.1), key
    before_m, after_m = answer["errors_m"]
    assert after_m < 0.8 * before_m
    assert answer["durations_s"] == pytest.approx([9.5, 9.5])
    cards = [
        out.data["text/html"]
        for every in outputs.values()
        for out in every
        if "text/html" in out.get("data", {})
    ]
    assert len(cards) == 7
    assert sum("simulated" in card for card in cards) == 2  # the flights, not what was imported
    nbformat.write(notebook, tmp_path / "executed.ipynb")
