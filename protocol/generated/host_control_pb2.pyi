from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class HostControl(_message.Message):
    __slots__ = ("source_us", "reference_us", "outcome", "iterations", "estimate_age_us", "act_us", "rate_cmd_rad_s", "collective_n", "late_us")
    class Outcome(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        SOLVED: _ClassVar[HostControl.Outcome]
        BUDGET_SPENT: _ClassVar[HostControl.Outcome]
        INFEASIBLE: _ClassVar[HostControl.Outcome]
    SOLVED: HostControl.Outcome
    BUDGET_SPENT: HostControl.Outcome
    INFEASIBLE: HostControl.Outcome
    SOURCE_US_FIELD_NUMBER: _ClassVar[int]
    REFERENCE_US_FIELD_NUMBER: _ClassVar[int]
    OUTCOME_FIELD_NUMBER: _ClassVar[int]
    ITERATIONS_FIELD_NUMBER: _ClassVar[int]
    ESTIMATE_AGE_US_FIELD_NUMBER: _ClassVar[int]
    ACT_US_FIELD_NUMBER: _ClassVar[int]
    RATE_CMD_RAD_S_FIELD_NUMBER: _ClassVar[int]
    COLLECTIVE_N_FIELD_NUMBER: _ClassVar[int]
    LATE_US_FIELD_NUMBER: _ClassVar[int]
    source_us: int
    reference_us: int
    outcome: HostControl.Outcome
    iterations: int
    estimate_age_us: int
    act_us: int
    rate_cmd_rad_s: _containers.RepeatedScalarFieldContainer[float]
    collective_n: _containers.RepeatedScalarFieldContainer[float]
    late_us: int
    def __init__(self, source_us: _Optional[int] = ..., reference_us: _Optional[int] = ..., outcome: _Optional[_Union[HostControl.Outcome, str]] = ..., iterations: _Optional[int] = ..., estimate_age_us: _Optional[int] = ..., act_us: _Optional[int] = ..., rate_cmd_rad_s: _Optional[_Iterable[float]] = ..., collective_n: _Optional[_Iterable[float]] = ..., late_us: _Optional[int] = ...) -> None: ...
