from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Optional as _Optional

DESCRIPTOR: _descriptor.FileDescriptor

class Timing(_message.Message):
    __slots__ = ("poses", "late_poses", "pose_late_us", "runs_late", "clock_steps")
    POSES_FIELD_NUMBER: _ClassVar[int]
    LATE_POSES_FIELD_NUMBER: _ClassVar[int]
    POSE_LATE_US_FIELD_NUMBER: _ClassVar[int]
    RUNS_LATE_FIELD_NUMBER: _ClassVar[int]
    CLOCK_STEPS_FIELD_NUMBER: _ClassVar[int]
    poses: int
    late_poses: int
    pose_late_us: int
    runs_late: bool
    clock_steps: int
    def __init__(self, poses: _Optional[int] = ..., late_poses: _Optional[int] = ..., pose_late_us: _Optional[int] = ..., runs_late: _Optional[bool] = ..., clock_steps: _Optional[int] = ...) -> None: ...
