"""Reader of ArduPilot DataFlash logs (.bin) by pymavlink's DFReader.

The world is NED, the body FRD, angles are in degrees, times in us since boot. Poses come from the estimator.
"""

from __future__ import annotations

from array import array
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.host.base.bounds import DATAFLASH_JUNK, DATAFLASH_MESSAGES
from trimtab.host.base.extras import quiet
from trimtab.host.imports.contents import Contents
from trimtab.host.imports.formats.ulog import UNKNOWN
from trimtab.host.imports.frames import turn_from_euler
from trimtab.host.imports.recording import Corner, ImportFormatError, Recording, check_readable, corner_of
from trimtab.host.imports.topics import Sensors, Source, Topic, TopicLog, finite_numbers
from trimtab.host.imports.tracks import Track, command_shares
from trimtab.host.vehicle.dumps import ARDUPILOT_QUADS

MARK = b"\xa3\x95\x80"
"""Head of the first message, which defines the format of the messages that define formats."""

_BLOCK_BYTES = 1 << 24
_LONGEST_BYTES = 255

DEG = np.pi / 180.0
POSITION = tuple(Source(topic=name, fields=("PN", "PE", "PD")) for name in ("XKF1", "NKF1", "EKF1"))
ATTITUDE = (Source(topic="ATT", fields=("Roll", "Pitch", "Yaw"), factor=DEG),)
SENSORS = Sensors(
    rate=(Source(topic="IMU", fields=("GyrX", "GyrY", "GyrZ")),),
    force=(Source(topic="IMU", fields=("AccX", "AccY", "AccZ")),),
    voltage=(Source(topic="BAT", fields=("Volt",)), Source(topic="CURR", fields=("Volt",))),
)
PULSES = (Source(topic="RCOU", fields=("C1", "C2", "C3", "C4")),)
INSTANCES = ("I", "Instance", "C")
"""Fields that number sensors or estimators; the first of each is read."""

FRAME_TYPES = (1, 12, 13, 14)
"""X, Betaflight's X, DJI's X and clockwise X: the frames that can be imported."""

QUADROTOR = 1
PWM_MIN_US, PWM_MAX_US = 1000.0, 2000.0
"""Pulse widths of no and full command unless MOT_PWM_MIN and MOT_PWM_MAX give others."""


def recognises(path: Path, head: bytes) -> bool:
    """Return whether the file begins as a DataFlash log."""
    return head.startswith(MARK)


def contents(path: Path) -> Contents:
    """Return the messages that hold quantities, with their rates. Raises ImportFormatError."""
    return _log(path).contents()


def read(path: Path | str) -> Recording:
    """Return the flight of a DataFlash log. Raises ImportFormatError with file, problem and remedy."""
    path = Path(path)
    log = _log(path)
    position, attitude = log.first(POSITION), log.first(ATTITUDE)
    if position is None:
        raise log.missing(POSITION)
    if attitude is None:
        raise log.missing(ATTITUDE)
    motors = _motors(log)
    return log.recording(
        position=position,
        attitude_us=attitude.t_us,
        turn=turn_from_euler(attitude.values),
        motors=motors,
        corners=None if motors is None else _corners(log),
        sensors=SENSORS,
        unknown=UNKNOWN,
    )


def _motors(log: TopicLog) -> Track | None:
    """Return the motor commands in 0..1; None without any."""
    pulses = log.first(PULSES)
    if pulses is None:
        return None
    low = log.parameters.get("MOT_PWM_MIN", PWM_MIN_US) or PWM_MIN_US
    high = log.parameters.get("MOT_PWM_MAX", PWM_MAX_US) or PWM_MAX_US
    if not low < high:
        raise ImportFormatError(
            f"{log.name}: MOT_PWM_MIN {low:g} is not below MOT_PWM_MAX {high:g}; correct it"
        )
    return Track(t_us=pulses.t_us, values=command_shares(pulses.values, low, high))


def _corners(log: TopicLog) -> tuple[Corner, Corner, Corner, Corner]:
    """Return the corners of the motors. Raises ImportFormatError for a frame that is no quadrotor in X."""
    kind, order = log.parameters.get("FRAME_CLASS", QUADROTOR), log.parameters.get("FRAME_TYPE", 1.0)
    if int(kind) != QUADROTOR or int(order) not in FRAME_TYPES:
        raise ImportFormatError(
            f"{log.name}: FRAME_CLASS {kind:g} with FRAME_TYPE {order:g} is no known quadrotor in X; "
            "only those can be imported"
        )
    _, angles_deg, _ = ARDUPILOT_QUADS[int(order)]
    angles = np.radians(angles_deg)
    corners: list[Corner] = [corner_of(x, y) for x, y in zip(np.cos(angles), np.sin(angles), strict=True)]
    return corners[0], corners[1], corners[2], corners[3]


def _log(path: Path) -> TopicLog:
    """Return the messages with quantities, and the parameters."""
    check_readable(path)
    _check_amounts(path)
    quantities = (POSITION, ATTITUDE, SENSORS.rate, SENSORS.force, SENSORS.voltage, PULSES)
    wanted = dict.fromkeys(source.topic for sources in quantities for source in sources)
    rows: dict[str, tuple[tuple[str, ...], array[int], array[float]]] = {}
    parameters: dict[str, float] = {}
    try:
        with quiet():
            _read(path, [*wanted, "PARM"], rows, parameters)
    except Exception as error:
        if not any(len(times) for _, times, _ in rows.values()):
            # DFReader reports damage by whatever exception its parser ran into.
            raise ImportFormatError(
                f"{path.name}: not a whole DataFlash log ({type(error).__name__}); download it again"
            ) from None
    topics = {
        name: Topic(
            t_us=np.array(times, dtype=np.int64),
            columns=dict(zip(fields, np.array(values).reshape(len(times), len(fields)).T, strict=True)),
        )
        for name, (fields, times, values) in rows.items()
        if len(times)
    }
    if not topics:
        raise ImportFormatError(f"{path.name}: none of the messages {', '.join(wanted)}; set LOG_BITMASK")
    start_us = min(int(topic.t_us.min()) for topic in topics.values())
    end_us = max(int(topic.t_us.max()) for topic in topics.values())
    return TopicLog(
        name=path.name,
        topics=topics,
        start_us=start_us,
        duration_s=(end_us - start_us) * 1e-6,
        parameters=finite_numbers(parameters),
    )


def _check_amounts(path: Path) -> None:
    """Raise ImportFormatError for more messages, or more bytes between them, than bounds allow.

    DFReader goes through both in steps before it returns anything. A message has at most 255 bytes.
    """
    limit, read, messages = DATAFLASH_MESSAGES.limit_of(path.stat().st_size), 0, 0
    with path.open("rb") as stream:
        while block := stream.read(_BLOCK_BYTES):
            read, messages = read + len(block), messages + block.count(MARK[:2])
            if messages > limit:
                raise ImportFormatError(f"{path.name}: {DATAFLASH_MESSAGES.problem(limit=limit)}")
            if read - _LONGEST_BYTES * messages > DATAFLASH_JUNK.limit:
                raise ImportFormatError(f"{path.name}: {DATAFLASH_JUNK.problem()}")


def _read(
    path: Path,
    names: list[str],
    rows: dict[str, tuple[tuple[str, ...], array[int], array[float]]],
    parameters: dict[str, float],
) -> None:
    """Fill the rows of the named messages, numbers only, and the parameters."""
    from pymavlink.DFReader import DFReader_binary

    class Forwards(DFReader_binary):
        """DFReader that stops at a message of no length, and closes its file if it cannot be read."""

        def __init__(self, name: str) -> None:
            try:
                super().__init__(name)
            except BaseException:
                self.filehandle.close()
                raise

        def _parse_next(self) -> Any:
            begin = self.offset
            message = super()._parse_next()
            if message is not None and self.offset <= begin:
                raise EOFError
            return message

    reader: Any = Forwards(str(path))
    with closing(reader.filehandle):
        while (message := reader.recv_match(type=names)) is not None:
            kind, held = message.get_type(), message.to_dict()
            if kind == "PARM":
                parameters[str(held["Name"])] = float(held["Value"])
                continue
            if any(held.get(field) for field in INSTANCES):
                continue
            numbers = {k: float(v) for k, v in held.items() if isinstance(v, int | float) and k != "TimeUS"}
            fields, times, values = rows.setdefault(kind, (tuple(numbers), array("q"), array("d")))
            if tuple(numbers) == fields:
                times.append(int(held["TimeUS"]))
                values.extend(numbers.values())
