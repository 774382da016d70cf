"""A simulated vehicle, wired, in lock-step, under several stations, checked at every update.

Stations speak MAVLink over the serial line. The checker takes the plant's own motion, and the state on board.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from random import Random

from trimtab.firmware_model.flight.course import Course
from trimtab.firmware_model.flight.failsafe import Action
from trimtab.firmware_model.flight.flight import UPDATE_TICKS, Flight
from trimtab.firmware_model.flight.invariants import (
    CONTACT_M,
    INVARIANTS,
    OVERTURNED_DEG,
    Moment,
    Transition,
    excess,
)
from trimtab.firmware_model.flight.supervisor import FLYING, Event, State
from trimtab.host.vehicle import Vehicle, load_vehicle
from trimtab.protocol import messages as m
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import HOST, Message, Station
from trimtab.protocol.stream import message_id, split
from trimtab.protocol.telemetry import TICK_US
from trimtab.protocol.upload import UploadSender
from trimtab.sitl.studies.policy.faults import Cameras, Link
from trimtab.sitl.vehicle import SimulatedVehicle

STEP_US = UPDATE_TICKS * TICK_US
FLIGHT = 1
"""Flight index, from which noise and turbulence are drawn."""
STATIONS: tuple[Station, ...] = (HOST, (253, 190), (42, 191))
_RELEASES = (Event.KILL, Event.TILTED, Event.IMU_STUCK)
_ANSWERS = (m.UploadStatus.id, m.UploadVerdict.id)
_COS_OVERTURNED = math.cos(math.radians(OVERTURNED_DEG))
_WRONG_BEFORE_US = 1_000_000
"""Time before arming in which a wrong pose spoils the estimate."""


@dataclass(frozen=True, kw_only=True)
class Breach:
    """A broken invariant: its name, time since power-up, and by how much it exceeds its bound."""

    name: str
    t_s: float
    value: float
    bound: float


@dataclass(kw_only=True)
class Tally:
    """How often an invariant applied in a sequence, and the value nearest to its bound, or past it."""

    moments: int = 0
    excess: float = -math.inf
    value: float = 0.0


class RecordedCourse(Course):
    """Course of a flight that records its transitions until they are taken."""

    def __init__(self, flight: Flight) -> None:
        super().__init__()
        self._flight = flight
        self.transitions: list[Transition] = []
        self.now_us = 0

    def enter(self, state: State, event: Event, by: Station | None) -> None:
        """Record a transition."""
        flight = self._flight
        failing = len(flight.arming_reasons(self.now_us)) if event is Event.ARM else 0
        self.transitions.append(Transition(flight.state, event, state, by, self.owner, failing))
        super().enter(state, event, by)


@dataclass(kw_only=True)
class _History:
    """What a moment needs of the past."""

    state: State = State.BOOT
    action: Action = Action.NONE
    rotors_on: bool = False
    height_m: float = 0.0
    v: tuple[float, float, float] = (0.0, 0.0, 0.0)
    entered_by: Event | None = None
    vector: object = None
    values: dict[str, float] = field(default_factory=dict)
    poses_true: bool = True
    attitude: bool = False
    released: bool = False
    blind: bool = False
    overturned: bool = False


class Rig:
    """The vehicle `research` on the floor of a world.

    Attributes
    ----------
    flight
        Flight logic on board.
    link, cameras
        Ways of messages and poses, with their faults.
    breaches
        First breach of each invariant.
    tallies
        By name of the invariant.
    """

    def __init__(self, world: str, world_seed: int, rng: Random) -> None:
        self.vehicle: Vehicle = load_vehicle("research")
        self._simulated = SimulatedVehicle.create(
            self.vehicle, world=world, world_seed=world_seed, flight=FLIGHT, radio={"wired": True}
        )
        self.now_us = 0
        self.flight = self._simulated.flight
        self._course = self.flight.course = RecordedCourse(self.flight)
        self.link, self.cameras = Link(rng), Cameras(rng=rng)
        self.breaches: dict[str, Breach] = {}
        self.tallies = {row.name: Tally() for row in INVARIANTS}
        self.upload: UploadSender | None = None
        self._uploader = HOST
        self._heard_us: dict[Station, int] = {}
        self._setpoint_us: dict[Station, int] = {}
        self._attitude_us: dict[Station, int] = {}
        self._hears = Codec(*HOST)
        self._pose_senders: set[Station] = set()
        self._history = _History(vector=self.flight.parameters.vector, values=dict(self.flight.parameters))

    @property
    def height_m(self) -> float:
        """True height above the floor."""
        return self._history.height_m

    def send(self, station: Station, message: Message) -> None:
        """Send a message of a station."""
        self.link.send(station, message, self.now_us)

    def begin_upload(self, station: Station, sender: UploadSender) -> None:
        """Begin an upload; it replaces an earlier one."""
        self.upload, self._uploader = sender, station

    def step(self) -> Moment:
        """Advance by one update, check the invariants, and return the moment."""
        end_us, simulated = self.now_us + STEP_US, self._simulated
        while simulated.now_us < end_us:
            self._transmit(simulated.now_us)
            simulated.run_until(end_us)
            for pose in simulated.mocap_read():
                self.cameras.take(pose, simulated.now_us, self.height_m)
            data = simulated.serial_read()
            if data and self.upload is not None:
                self._hear(data)
        self.now_us = self._course.now_us = simulated.now_us
        moment = self._moment()
        for row in INVARIANTS:
            over = excess(row, moment)
            if over is not None:
                self._record(row.name, over, row.bound(moment.parameters))
        return moment

    # The line.

    def _transmit(self, now_us: int) -> None:
        write = self._simulated.serial_write
        if self.upload is not None:
            self.upload.advance(now_us)
            for message in self.upload.send(now_us):
                self.link.send(self._uploader, message, now_us)
        for delivery in self.link.due(now_us):
            station, message, data = delivery
            self._note(station, message, now_us)
            write(data)
        for pose in self.cameras.due(now_us):
            write(pose)

    def _note(self, station: Station, message: Message, now_us: int) -> None:
        if isinstance(message, m.AttPosMocap):
            self._pose_senders.add(station)
            return
        self._heard_us[station] = now_us
        if isinstance(message, m.SetPositionTarget | m.SetAttitudeTarget):
            self._setpoint_us[station] = now_us
            if isinstance(message, m.SetAttitudeTarget):
                self._attitude_us[station] = now_us

    def _hear(self, data: bytes) -> None:
        assert self.upload is not None
        for raw in split(data):
            if message_id(raw) in _ANSWERS:
                for message in self._hears.decode(raw):
                    self.upload.receive(message, self.now_us)

    # The check.

    def _moment(self) -> Moment:
        flight, last, simulated = self.flight, self._history, self._simulated
        p, v = simulated.true_motion()
        command = simulated.motor_command
        transitions, self._course.transitions = tuple(self._course.transitions), []
        self._follow(transitions)
        changed = 0
        if flight.parameters.vector is not last.vector:
            last.vector, values = flight.parameters.vector, dict(flight.parameters)
            changed = sum(values[name] != last.values[name] for name in values)
            last.values = values
        height_m = -p[2]
        touched = last.height_m > CONTACT_M >= height_m
        owner = flight.course.owner
        heard = [self._heard_us.get(station, 0) for station in (owner, *self._pose_senders) if station]
        moment = Moment(
            parameters=last.values,
            p=p,
            v=v,
            before=last.state,
            state=flight.state,
            action_before=last.action,
            action=flight.action,
            rotors_on_before=last.rotors_on,
            rotors_on=any(command),
            transitions=transitions,
            changed_parameters=changed,
            not_finite=self._not_finite(command),
            silent_s=self._since_s(max(heard, default=self.now_us)),
            pose_s=self._since_s(self.cameras.pose_us),
            setpoint_s=0.0 if owner is None else self._since_s(self._setpoint_us.get(owner, 0)),
            state_s=self._since_s(flight.state_us),
            entered_by=last.entered_by,
            poses_true=last.poses_true,
            attitude=last.attitude,
            released=last.released,
            blind=last.blind,
            overturned=last.overturned,
            impact_m_s=math.hypot(*last.v) if touched else None,
            sinking_m_s=abs(last.v[2]) if touched else 0.0,
        )
        last.state, last.action, last.rotors_on = moment.state, moment.action, moment.rotors_on
        last.height_m, last.v = height_m, v
        return moment

    def _follow(self, transitions: tuple[Transition, ...]) -> None:
        """Update what is remembered of the flight."""
        flight, last, cameras = self.flight, self._history, self.cameras
        for each in transitions:
            last.entered_by = each.event
            if each.event is Event.ARM:
                wrong_us = max(cameras.wrong_us, cameras.misplaced_us)
                last.poses_true = self.now_us - wrong_us > _WRONG_BEFORE_US
                last.released = last.blind = last.overturned = last.attitude = False
            elif each.event in _RELEASES and each.before in FLYING:
                last.released = True
        if cameras.offset is not None and self.now_us - cameras.wrong_us < _WRONG_BEFORE_US:
            last.poses_true = False
        last.blind |= flight.action is Action.LEVEL_DESCENT
        last.overturned |= flight.outputs["cos_tilt"][0] < _COS_OVERTURNED
        last.released |= flight.action is Action.MOTORS_OFF
        owner = flight.course.owner
        if owner in self._attitude_us:
            last.attitude |= self._since_s(self._attitude_us[owner]) <= flight.parameters["FS_OFFB_S"] + 1.0

    def _not_finite(self, command: tuple[float, ...]) -> int:
        values = (*command, *self.flight.outputs["reference"])
        return sum(not math.isfinite(value) for value in values) + sum(not 0.0 <= u <= 1.0 for u in command)

    def _since_s(self, at_us: int) -> float:
        return 1e-6 * (self.now_us - at_us)

    def _record(self, name: str, over: float, bound: float) -> None:
        tally = self.tallies[name]
        tally.moments += 1
        if over > tally.excess:
            tally.excess, tally.value = over, over + bound
        if over > 0.0 and name not in self.breaches:
            self.breaches[name] = Breach(name=name, t_s=1e-6 * self.now_us, value=over + bound, bound=bound)
