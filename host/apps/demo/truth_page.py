"""The last step of a demo: the truth is opened, and the page that compares it with the verdict is written."""

from __future__ import annotations

import json
from collections.abc import Mapping

from trimtab.host.apps.demo.files import JSON_NAME, TRUTH_PAGE, DemoFiles
from trimtab.host.apps.demo.truth import judge, judgement_words, open_truth
from trimtab.host.base.artefacts import content_id
from trimtab.host.effects import Effect
from trimtab.host.log import Flight
from trimtab.host.report.truth import page


def write_truth_page(files: DemoFiles, flight: Flight, effects: Mapping[str, Effect]) -> str:
    """Write the page from the verdict's file and the truth beside a flight, and return its sentence.

    Raises ValueError if there is no verdict file, or if the truth is that of another log.
    """
    truth = open_truth(files.folder, flight.path.name, flight.id)
    verdict = (files.folder / JSON_NAME).read_bytes()
    answer = json.loads(verdict)
    judgement = judge(answer, truth["effects"], effects)
    before_m, after_m = (answer[key]["position_rmse_m"] for key in ("before", "after"))
    files.write(TRUTH_PAGE, page(judgement, truth, content_id(verdict), before_m, after_m))
    return judgement_words(judgement)
