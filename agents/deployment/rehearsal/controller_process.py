"""The controller of a rehearsal as a process of its own: in Python, or the exported C program."""

from __future__ import annotations

import gc
import multiprocessing
import queue
import socket
import subprocess
import tempfile
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from agents.deployment.channels import current_channel, observation_channels
from agents.deployment.compiled import FLAGS, run_compiler
from agents.deployment.rehearsal.datagram import (
    BEGINS,
    COMMAND,
    ENDS,
    IGNORED_SHIFT,
    MEASUREMENT,
    REFUSED,
    Datagram,
    unpack,
)
from agents.policies.registry import get_controller
from shake_env.controller import Controller, decide
from shake_env.errors import ShakeError
from shake_env.safety.supervisor import Supervised
from shake_env.scenario.scenario import Scenario

LOOPBACK = "127.0.0.1"
PATIENCE = 60.0  # [s] without a datagram, after which a controller ends
START = 120.0  # [s] within which it must have begun
Runs = Literal["python", "c"]


class ControllerProcess(Protocol):
    """A process that answers measurements on a port of the loopback."""

    port: int

    @property
    def pid(self) -> int:
        """Number of the process."""
        ...

    def kill(self) -> None:
        """End it at once, as a crash does."""
        ...

    def restart(self) -> None:
        """Start it again after it was killed; its port may change."""
        ...

    def close(self) -> None:
        """End it and give back what it holds."""
        ...


def start_controller(name: str, scenario: Scenario, runs: Runs, supervised: bool) -> ControllerProcess:
    """Start a controller's process, ready to answer.

    Raises
    ------
    ShakeError
        If it does not come up, or has no C form.
    """
    if runs == "c":
        return CProcess(name, scenario, supervised)
    return PythonProcess(name, scenario, supervised)


class CProcess:
    """The exported C program for UDP, compiled in a temporary folder."""

    def __init__(self, name: str, scenario: Scenario, supervised: bool) -> None:
        from agents.deployment.export import export_c

        self._folder = tempfile.TemporaryDirectory()
        where = Path(self._folder.name)
        try:
            program, _ = export_c(name, scenario, where, supervised=supervised)
            target = where / f"{program.name}_udp"
            sources = [where / f"{program.name}.c", where / f"{program.name}_udp.c"]
            run_compiler([*FLAGS, "-o", target, *sources, "-lm"])
        except BaseException:
            self._folder.cleanup()
            raise
        self._command = str(target)
        self._start()

    def _start(self) -> None:
        self._process = subprocess.Popen([self._command], stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None  # a pipe was asked for
        line = self._process.stdout.readline()
        if not line.strip().isdigit():
            raise ShakeError("controller process", self._command, "did not start")
        self.port = int(line)

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    def restart(self) -> None:
        """Start the program again after it was killed."""
        self.kill()
        self._start()

    def kill(self) -> None:
        """End it at once, as a crash does."""
        self._process.kill()
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def close(self) -> None:
        """End it and remove its folder."""
        self.kill()
        self._folder.cleanup()


class PythonProcess:
    """A controller of the registry in a Python process."""

    def __init__(self, name: str, scenario: Scenario, supervised: bool) -> None:
        self._arguments = (name, scenario, supervised)
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        ports = context.Queue()
        self._process = context.Process(target=_serve, args=(*self._arguments, ports), daemon=True)
        self._process.start()
        try:
            self.port = ports.get(timeout=START)
        except queue.Empty:
            self.kill()
            raise ShakeError("controller process", self._arguments[0], "did not start") from None

    @property
    def pid(self) -> int:
        """Number of the process."""
        assert self._process.pid is not None  # it was started
        return self._process.pid

    def restart(self) -> None:
        """Start the process again after it was killed."""
        self.kill()
        self._start()

    def kill(self) -> None:
        """End it at once, as a crash does."""
        self._process.kill()
        self._process.join()

    def close(self) -> None:
        """End it."""
        self.kill()


def _serve(name: str, scenario: Scenario, supervised: bool, ports: Any) -> None:
    controller: Controller = get_controller(name, scenario)
    if supervised:
        controller = Supervised(controller, scenario)
    decide(controller, np.zeros((1, scenario.observation.size), np.float32))  # compile and load, once
    gc.collect()
    gc.freeze()  # what is there by now is not looked through again
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as endpoint:
        endpoint.bind((LOOPBACK, 0))
        endpoint.settimeout(PATIENCE)
        ports.put(endpoint.getsockname()[1])
        serve(controller, scenario, endpoint)


def serve(controller: Controller, scenario: Scenario, endpoint: socket.socket) -> None:
    """Answer measurements with commands until a datagram says that it is the end.

    One decision a period, from the newest measurement: what is repeated, out of order, corrupt or of a
    test whose start has not come is not answered, and counted in the upper byte of the next command's
    flags.
    """
    scales = np.array([channel.scale for channel in observation_channels(scenario)])
    limit = current_channel(scenario).scale
    memory: tuple[Any, ...] | None = None
    test: int | None = None  # number of the present one
    last = ignored = 0
    fresh = True  # no decision of the present test has been made
    while True:
        try:
            data, peer = endpoint.recvfrom(65536)
        except TimeoutError:
            return
        given = unpack(data)
        if given is None or given.kind != MEASUREMENT or len(given.channels) != len(scales):
            ignored += 1
            continue
        if given.flags & ENDS:
            return
        begins = bool(given.flags & BEGINS) and given.test != test
        if begins:
            test, ignored, fresh = given.test, 0, True
        elif given.test != test or given.sequence <= last:
            ignored += 1
            continue
        last = given.sequence
        observation = (given.channels / scales).astype(np.float32)[None]
        action, flags = 0.0, (ignored & 0xFF) << IGNORED_SHIFT
        if not np.isfinite(observation).all() and not isinstance(controller, Supervised):
            flags |= REFUSED
        else:
            chosen, memory = decide(controller, observation, memory, np.array([fresh]))
            fresh = False
            action = float(chosen[0, 0])
            if not np.isfinite(action):
                action, flags = 0.0, flags | REFUSED
        command = Datagram(
            COMMAND, given.sequence, given.time, np.array([limit * action]), flags, given.test
        )
        endpoint.sendto(command.pack(), peer)
