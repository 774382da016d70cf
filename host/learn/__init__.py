"""Learning the residual of a flight's closed loop from its trajectories (paper section IV-B)."""

from trimtab.host.learn.condensed import CondensedSettings
from trimtab.host.learn.learn import DEFAULT_FORMS, learn
from trimtab.host.learn.result import Judged, Learned
from trimtab.host.learn.supervised import learn_supervised
from trimtab.host.learn.train import Settings

__all__ = ["DEFAULT_FORMS", "CondensedSettings", "Judged", "Learned", "Settings", "learn", "learn_supervised"]
