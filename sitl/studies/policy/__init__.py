"""The policy study: random sequences of commands, setpoints and faults against the table of invariants."""

from trimtab.sitl.studies.policy.run import PolicyReport, fly_sequence, run_policy

__all__ = ["PolicyReport", "fly_sequence", "run_policy"]
