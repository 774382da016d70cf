"""A session, without I/O: it runs a script of tasks and forwards poses at the same time.

A driver (trimtab.host.link.drivers) carries bytes and datagrams in and out, and passes the time in.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from typing import Any, Protocol

from trimtab.host.link.client import NEVER_US, Client
from trimtab.host.link.clock import CameraClock
from trimtab.host.link.keys import StationKey
from trimtab.host.link.pose_timing import PoseTiming
from trimtab.host.link.tasks import Task
from trimtab.protocol import messages as m
from trimtab.protocol.codec import decode_message
from trimtab.protocol.messages import Message
from trimtab.protocol.stream import StreamSplitter

Forward = Callable[[m.AttPosMocap, int, int | None], Message | None]
"""Returns the message that forwards a pose, or None.

It receives the pose and its time of exposure in us: on the host's clock, and on the vehicle's (None if that
is not known).
"""
Script = Generator[Task, Any, Any]
"""A generator that yields tasks, receives their results or errors, and returns the session's result."""


class Listener(Protocol):
    """An observer of all messages and poses, for instance a Recorder."""

    @property
    def deadline_us(self) -> int: ...
    def receive(self, messages: Sequence[Message], now_us: int) -> None: ...
    def pose(self, message: m.AttPosMocap, vehicle_us: int, now_us: int) -> None: ...
    def link(self, now_us: int) -> None: ...


class Session:
    """A script that runs over a Client.

    Parameters
    ----------
    script
        Called once with the session, at the first `step`.
    camera
        Clock of the camera system. Poses are forwarded with stamps on the vehicle's clock.
    key
        Key of message signing; None for a vehicle without one.
    forward
        How poses are forwarded. Default: as a Trimtab vehicle takes them.

    Attributes
    ----------
    done
        Whether the script has ended.
    result
        The script's return value.
    error
        The exception that ended the script, if any.
    now_us
        Time of the current step.
    utc_offset_us
        Time since 1970 (UTC) less the time of the steps, us; None for a simulated vehicle in this process.
    poses
        Number of valid poses received.
    forwarded
        Number of poses sent to the vehicle.
    pose_timing
        Measures how late poses arrive; None for a simulated vehicle in this process.
    listener
        Observer of messages and poses, or None. If it raises, it is removed and the script gets the error.
    """

    def __init__(
        self,
        script: Callable[[Session], Script],
        camera: CameraClock | None = None,
        key: StationKey | None = None,
        forward: Forward | None = None,
    ) -> None:
        self.client = Client(key)
        self._forward = forward or to_trimtab
        self.camera = camera or CameraClock(None)
        self.listener: Listener | None = None
        self.done = False
        self.result: Any = None
        self.error: BaseException | None = None
        self.now_us = 0
        self.utc_offset_us: int | None = None
        self.pose_timing: PoseTiming | None = None
        self.poses = 0
        self.forwarded = 0
        self._make_script = script
        self._script: Script | None = None
        self._task: Task | None = None
        self._steps = 0
        self._datagrams = StreamSplitter()

    @property
    def next_deadline_us(self) -> int:
        """Latest time of the next call of `step`."""
        task, listener = self._task, self.listener
        deadline_us = self.client.next_deadline_us
        if task is not None and task.deadline_us < deadline_us:
            deadline_us = task.deadline_us
        if listener is not None and listener.deadline_us < deadline_us:
            deadline_us = listener.deadline_us
        return deadline_us if not self.done else NEVER_US

    def step(self, now_us: int, data: bytes = b"", datagrams: Sequence[bytes] = ()) -> bytes:
        """Process received bytes, camera datagrams and the time. Return the bytes to write to the port."""
        self.now_us = now_us
        client = self.client
        if client.key is not None:
            client.set_time(now_us)
        if self._script is None:
            self._script = self._make_script(self)
            self._resume(None)
        if data:
            messages = client.receive(data, now_us)
            if messages:
                self._dispatch(messages, now_us)
        for datagram in datagrams:
            self._on_datagram(datagram, now_us)
        if now_us >= client.next_deadline_us:
            client.advance(now_us)
        listener = self.listener
        if listener is not None and now_us >= listener.deadline_us:
            self._notify(listener.link, now_us)
        task = self._task
        if task is not None and now_us >= task.deadline_us:
            self._guard(task.advance, client, now_us)
        return client.take()

    @property
    def utc_us(self) -> int | None:
        """Time since 1970 (UTC), us; None for a simulated vehicle in this process."""
        return None if self.utc_offset_us is None else self.now_us + self.utc_offset_us

    def outcome(self) -> Any:
        """Return the result of the finished script, or raise its error."""
        if self.error is not None:
            raise self.error
        return self.result

    def fail(self, error: BaseException) -> None:
        """Raise `error` in the script. The script may catch it and continue with another task."""
        if not self.done and self._script is not None:
            self._task = None
            self._resume(error)
        elif not self.done:
            self.done, self.error = True, error

    def _dispatch(self, messages: Sequence[Message], now_us: int) -> None:
        if self.listener is not None:
            self._notify(self.listener.receive, messages, now_us)
        for message in messages:
            task = self._task
            if task is not None and type(message) in task.wants:
                self._guard(task.receive, self.client, message, now_us)

    def _notify(self, act: Callable[..., None], *arguments: Any) -> None:
        """Call the listener. If it raises, remove it and pass the error to the script."""
        try:
            act(*arguments)
        except Exception as error:
            self.listener = None
            self.fail(error)

    def _guard(self, act: Callable[..., None], *arguments: Any) -> None:
        """Call the task. If it ends or raises, resume the script."""
        task = self._task
        assert task is not None
        try:
            act(*arguments)
        except Exception as error:
            self._task = None
            self._resume(error)
        else:
            if task.done:
                self._task = None
                self._resume(None, task.result)

    def _resume(self, error: BaseException | None, result: Any = None) -> None:
        """Run the script until it yields a task that does not finish immediately."""
        script = self._script
        assert script is not None
        try:
            while True:
                task = script.send(result) if error is None else script.throw(error)
                error = None
                try:
                    task.begin(self.client, self.now_us)
                except Exception as problem:
                    error = problem
                    continue
                if not task.done:
                    self._task = task
                    return
                result = task.result
        except StopIteration as stop:
            self.done, self.result = True, stop.value
        except BaseException as problem:
            self.done, self.error = True, problem

    def _on_datagram(self, datagram: bytes, now_us: int) -> None:
        """Forward the poses in a datagram; drop those whose stamp the camera clock rejects."""
        clock, camera, timing = self.client.clock, self.camera, self.pose_timing
        for message in map(decode_message, self._datagrams.feed(datagram, last=True)):
            if type(message) is not m.AttPosMocap:
                continue
            if clock.steps != self._steps:
                self._steps = clock.steps
                camera.clear()
                if timing is not None:
                    timing.clear()
            if not camera.pose(message.time_usec, now_us):
                continue
            if timing is not None:
                timing.pose(message.time_usec, now_us)
            self.poses += 1
            host_us = message.time_usec - camera.offset_us
            vehicle_us = max(0, round(host_us + clock.offset_us)) if clock.exchanges else None
            forwarded = self._forward(message, round(host_us), vehicle_us)
            if forwarded is not None:
                self.client.send(forwarded)
                self.forwarded += 1
            if self.listener is not None:
                self._notify(self.listener.pose, message, vehicle_us or 0, now_us)


def to_trimtab(pose: m.AttPosMocap, host_us: int, vehicle_us: int | None) -> Message | None:
    """Return the pose as a Trimtab vehicle takes it, on its own clock."""
    if vehicle_us is None:
        return None
    return m.AttPosMocap(vehicle_us, pose.q, pose.x, pose.y, pose.z)
