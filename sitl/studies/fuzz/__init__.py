"""A fuzzer of everything that takes bytes from outside: vehicle, radios, host, files.

It looks for exceptions that no caller expects and for changes of state without a valid message. How each is
noticed stands in `vehicle`, `host` and `files`; `run` holds the kinds of inputs and their shares.
"""

from trimtab.sitl.studies.fuzz.run import KINDS, Crash, FuzzReport, replay, run_fuzz

__all__ = ["KINDS", "Crash", "FuzzReport", "replay", "run_fuzz"]
