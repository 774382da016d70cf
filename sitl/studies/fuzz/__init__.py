"""Fuzzer of everything that takes bytes from outside: vehicle, radios, host, files.

It looks for undocumented exceptions and for changes of state without a valid message. `vehicle`, `radio`,
`host` and `files` hold the checks, `run` the kinds of inputs and their shares.
"""

from trimtab.sitl.studies.fuzz.run import KINDS, Crash, FuzzReport, replay, run_fuzz

__all__ = ["KINDS", "Crash", "FuzzReport", "replay", "run_fuzz"]
