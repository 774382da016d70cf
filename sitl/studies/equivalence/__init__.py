"""Record what Trimtab computes at one commit, and compare the records of two commits.

    python -m trimtab.sitl.studies.equivalence freeze BEFORE --command OLD/.venv/bin/trimtab
    python -m trimtab.sitl.studies.equivalence freeze AFTER --inputs BEFORE/inputs
    python -m trimtab.sitl.studies.equivalence compare BEFORE AFTER

A refactoring keeps every record equal. Records are JSON files; logs are compared by their bytes.
"""
