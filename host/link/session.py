"""One connection from its first byte to its end, without I/O: a script of tasks, poses forwarded meanwhile.

A driver (trimtab.host.link.drivers) carries bytes and datagrams between a session and the world, and passes
the time.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from typing import Any, Protocol

from trimtab.host.link.client import NEVER_US, Client
from trimtab.host.link.clock import CameraClock
from trimtab.host.link.tasks import Task
from trimtab.protocol import messages as m
from trimtab.protocol.codec import decode_message
from trimtab.protocol.messages import Message
from trimtab.protocol.stream import split

Script = Generator[Task, Any, Any]
"""Yields tasks, gets back their results, returns the session's result; errors of a task are raised in it."""


class Listener(Protocol):
    """Who sees everything that passes, for instance a Recorder."""

    @property
    def deadline_us(self) -> int: ...
    def receive(self, messages: Sequence[Message], now_us: int) -> None: ...
    def pose(self, message: m.AttPosMocap, vehicle_us: int, now_us: int) -> None: ...
    def link(self, now_us: int) -> None: ...


class Session:
    """Runs a script over a Client.

    Parameters
    ----------
    script
        called once with the session, when the first `step` tells the time.
    camera
        the camera system's clock; its poses are forwarded with stamps on the vehicle's clock.

    Attributes
    ----------
    done
        whether the script has ended. result: what it returned. error: what it raised instead.
    now_us
        the time of the step under way.
    poses
        poses that have arrived. forwarded: how many went on to the vehicle.
    listener
        who sees what passes, None for nobody. One that raises sees no more, and what it raised is
        raised in the script.
    """

    def __init__(self, script: Callable[[Session], Script], camera: CameraClock | None = None) -> None:
        self.client = Client()
        self.camera = camera or CameraClock(None)
        self.listener: Listener | None = None
        self.done = False
        self.result: Any = None
        self.error: BaseException | None = None
        self.now_us = 0
        self.poses = 0
        self.forwarded = 0
        self._make_script = script
        self._script: Script | None = None
        self._task: Task | None = None
        self._steps = 0

    @property
    def next_deadline_us(self) -> int:
        """When `step` must be called at the latest."""
        task, listener = self._task, self.listener
        deadline_us = self.client.next_deadline_us
        if task is not None and task.deadline_us < deadline_us:
            deadline_us = task.deadline_us
        if listener is not None and listener.deadline_us < deadline_us:
            deadline_us = listener.deadline_us
        return deadline_us if not self.done else NEVER_US

    def step(self, now_us: int, data: bytes = b"", datagrams: Sequence[bytes] = ()) -> bytes:
        """Bytes for the port: takes what has arrived there and from the cameras, and the time."""
        self.now_us = now_us
        client = self.client
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
            self._tell(listener.link, now_us)
        task = self._task
        if task is not None and now_us >= task.deadline_us:
            self._guard(task.advance, client, now_us)
        return client.take()

    def outcome(self) -> Any:
        """Return what the script returned, once the session is done. Raises what it raised instead."""
        if self.error is not None:
            raise self.error
        return self.result

    def fail(self, error: BaseException) -> None:
        """End the script by raising `error` in it; it may yield another task instead and go on."""
        if not self.done and self._script is not None:
            self._task = None
            self._resume(error)
        elif not self.done:
            self.done, self.error = True, error

    def _dispatch(self, messages: Sequence[Message], now_us: int) -> None:
        if self.listener is not None:
            self._tell(self.listener.receive, messages, now_us)
        for message in messages:
            task = self._task
            if task is not None and type(message) in task.wants:
                self._guard(task.receive, self.client, message, now_us)

    def _tell(self, act: Callable[..., None], *arguments: Any) -> None:
        """Tells the listener; where it raises, the script decides how to go on without it."""
        try:
            act(*arguments)
        except Exception as error:
            self.listener = None
            self.fail(error)

    def _guard(self, act: Callable[..., None], *arguments: Any) -> None:
        """Lets the task act; where it ends or raises, the script goes on."""
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
        """Run the script up to its next task that is not done at once."""
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
        """Forward the poses in a datagram; one whose stamp the camera clock does not believe is dropped."""
        clock, camera = self.client.clock, self.camera
        for message in map(decode_message, split(datagram)):
            if type(message) is not m.AttPosMocap:
                continue
            if clock.steps != self._steps:
                self._steps = clock.steps
                camera.clear()
            if not camera.pose(message.time_usec, now_us):
                continue
            self.poses += 1
            vehicle_us = 0
            if clock.exchanges:
                vehicle_us = max(0, round(message.time_usec - camera.offset_us + clock.offset_us))
                forwarded = m.AttPosMocap(vehicle_us, message.q, message.x, message.y, message.z)
                self.client.send(forwarded)
                self.forwarded += 1
            if self.listener is not None:
                self._tell(self.listener.pose, message, vehicle_us, now_us)
