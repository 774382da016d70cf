"""Learning the residual of a flight's closed loop from its trajectories (paper section IV-B)."""

from host.learn.learn import DEFAULT_FORMS, Judged, Learned, learn
from host.learn.quick import CondensedSettings
from host.learn.train import Settings

__all__ = ["DEFAULT_FORMS", "CondensedSettings", "Judged", "Learned", "Settings", "learn"]
