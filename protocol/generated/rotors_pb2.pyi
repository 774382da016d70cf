from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable
from typing import ClassVar as _ClassVar, Optional as _Optional

DESCRIPTOR: _descriptor.FileDescriptor

class Rotors(_message.Message):
    __slots__ = ("source_us", "speed")
    SOURCE_US_FIELD_NUMBER: _ClassVar[int]
    SPEED_FIELD_NUMBER: _ClassVar[int]
    source_us: int
    speed: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, source_us: _Optional[int] = ..., speed: _Optional[_Iterable[float]] = ...) -> None: ...
