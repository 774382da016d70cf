"""Flight logs: write them in flight, read them as arrays, describe and recover them."""

from trimtab.host.log.errors import LogError
from trimtab.host.log.flight import read_flight
from trimtab.host.log.identity import is_same_flight, log_parents
from trimtab.host.log.imported import write_imported
from trimtab.host.log.info import to_lines
from trimtab.host.log.one_flight import Flight
from trimtab.host.log.provenance import Provenance
from trimtab.host.log.rebuilt import Rebuilt
from trimtab.host.log.recover import Recovery, recover
from trimtab.host.log.settings import (
    ChangedSetting,
    Setting,
    changed_between,
    changed_settings,
    settings_json,
    settings_lines,
    settings_of,
)
from trimtab.host.log.topics import FLIGHT_TOPICS, IMPORTED_TOPICS, Topic
from trimtab.host.log.tracks import (
    FAILSAFE_WORDS,
    Battery,
    Control,
    Estimate,
    HostControl,
    LinkHealth,
    Mocap,
    Observer,
    RecordedImu,
    RecordedInputs,
    Status,
    failsafe_name,
)
from trimtab.host.log.writer import LogWriter

__all__ = [
    "FAILSAFE_WORDS",
    "FLIGHT_TOPICS",
    "IMPORTED_TOPICS",
    "Battery",
    "ChangedSetting",
    "Control",
    "Estimate",
    "Flight",
    "HostControl",
    "LinkHealth",
    "LogError",
    "LogWriter",
    "Mocap",
    "Observer",
    "Provenance",
    "Rebuilt",
    "RecordedImu",
    "RecordedInputs",
    "Recovery",
    "Setting",
    "Status",
    "Topic",
    "changed_between",
    "changed_settings",
    "failsafe_name",
    "is_same_flight",
    "log_parents",
    "read_flight",
    "recover",
    "settings_json",
    "settings_lines",
    "settings_of",
    "to_lines",
    "write_imported",
]
