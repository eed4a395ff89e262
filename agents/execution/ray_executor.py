"""Workers of a Ray cluster: one that runs, or one of this machine that is started for the command."""

from __future__ import annotations

import contextlib
import socket
import sys
import time
import weakref
from concurrent.futures import Future
from contextlib import AbstractContextManager
from typing import Any

from agents.execution.executor import Executor
from agents.execution.worker import GIB, THREAD_VARIABLES, Outcome, perform_calls
from shake_env.errors import ParameterError, ShakeError, install_hint

OBJECT_STORE = 200 * 2**20  # [byte] of a cluster that is started here; what travels is small
AHEAD = 2  # submissions for each worker, so that none waits for the next, and a cluster can grow
REFRESH = 2.0  # [s] between two looks at the size of a cluster
ANSWER = 10.0  # [s] in which a cluster answers; Ray itself would ask for minutes
BEGIN = (
    "begin one with ray start --head, correct the address, or leave the option out for a cluster of "
    "this machine alone"
)
MISFIT = (
    "is it Ray, of the same version? A cluster with a token needs RAY_AUTH_MODE=token here as well, and "
    "the same token"
)
START = "end what else uses this machine, or try again"
# What opens HTTP/2, which gRPC and so Ray speaks: the words of RFC 9113, 3.4, and no setting (6.5).
_HELLO = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes((0, 0, 0, 4, 0, 0, 0, 0, 0))


class RayExecutor(Executor):
    """Tasks of Ray, each of one core and a stated memory. `results` repeats those of lost ones.

    Parameters
    ----------
    workers
        Calls at a time; None: as many as the cluster has cores (and memory) for.
    address
        Of a running cluster: ``auto``, ``HOST:6379`` or ``ray://HOST:10001``; None: one is started here.
    memory
        Of a worker [GiB].

    Raises
    ------
    ShakeError
        If Ray is not installed.
    ParameterError
        If no cluster is at the address, or no node of it has room for a worker.
    """

    def __init__(self, workers: int | None, address: str | None = None, memory: float = 4.0) -> None:
        try:
            import ray
        except ImportError:
            raise ShakeError("ray", "missing", install_hint("ray")) from None
        self._ray = ray
        if address is not None and (found := _found(address)) is not None:
            require_answer(found)
        self.on_this_machine = address is None
        options: dict[str, Any] = {"address": address} if address else _own_cluster(workers or 2)
        threads = {"env_vars": dict.fromkeys(THREAD_VARIABLES, "1")}
        try:
            ray.init(logging_level="ERROR", log_to_driver=False, runtime_env=threads, **options)
        except Exception as error:  # Ray raises that itself where a cluster does not start in time
            reason = (str(error) or type(error).__name__).strip().splitlines()[0]
            remedy = f"cannot be used ({reason}): {MISFIT if address else START}"
            raise ParameterError("ray-address", address, remedy) from error
        errors = ray.exceptions
        self.lost = (
            errors.WorkerCrashedError, errors.NodeDiedError, errors.OutOfMemoryError,
            errors.ObjectLostError, errors.LocalRayletDiedError,
        )  # fmt: skip
        self._references: weakref.WeakKeyDictionary[Future[list[Outcome]], Any] = (
            weakref.WeakKeyDictionary()
        )
        self._asked, self._looked, self._room = workers, -1e9, 0
        super().__init__(workers or 1, memory)
        if self.room() < 1:
            ray.shutdown()
            remedy = "no node of the cluster has a core and so much memory: ask for less"
            raise ParameterError("worker-memory", memory, remedy)
        self.workers = workers or self.room()
        self._task = ray.remote(perform_calls).options(
            num_cpus=1, memory=int(memory * GIB), max_retries=0
        )

    def room(self) -> int:
        """Return how many workers the cluster has cores and memory for, now."""
        if time.monotonic() - self._looked > REFRESH:
            need = (self.memory or 0.0) * GIB
            nodes = [node["Resources"] for node in self._ray.nodes() if node["Alive"]]
            rooms = [min(n.get("CPU", 0.0), n.get("memory", 0.0) / max(need, 1.0)) for n in nodes]
            self._room, self._looked = sum(int(each) for each in rooms), time.monotonic()
        return self._room

    @property
    def places(self) -> int:
        """Number of submissions that can run at a time, now."""
        return self._asked or max(1, self.room())

    @property
    def depth(self) -> int:
        """Number of submissions that are out at a time."""
        return self._asked or AHEAD * self.places

    def submit(self, content: bytes) -> Future[list[Outcome]]:
        """Submit a task."""
        reference = self._task.remote(content)
        future: Future[list[Outcome]] = reference.future()
        self._references[future] = reference
        return future

    def waiting(self) -> AbstractContextManager[Any]:
        """Keep standard output for results: Ray prints there what it says of lost workers."""
        return contextlib.redirect_stdout(sys.stderr)

    def cancel(self) -> None:
        """Cancel the tasks; a worker that carries one out ends."""
        for future, reference in self._references.items():
            if not future.done():
                self._ray.cancel(reference, force=True)
        self._references.clear()

    def shutdown(self) -> None:
        """Leave the cluster, which ends this command's tasks; end one that was started here."""
        self._ray.shutdown()


def require_answer(address: str) -> None:
    """Raise `ParameterError` unless a server of gRPC answers at HOST:PORT or ray://HOST:PORT in time."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdecimal():
        raise ParameterError("ray-address", address, "must be auto, HOST:6379 or ray://HOST:10001")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=ANSWER) as connection:
            connection.settimeout(ANSWER)
            connection.sendall(_HELLO)
            answer = connection.recv(9)  # the header of a frame: the server's settings
            if len(answer) < 4 or answer[3] != 4:
                raise ConnectionError("another program")
    except (OSError, OverflowError) as error:
        late = f"no answer in {ANSWER:g} s"
        reason = late if isinstance(error, TimeoutError) else getattr(error, "strerror", None) or error
        raise ParameterError(
            "ray-address", address, f"no cluster is there ({reason}): {BEGIN}"
        ) from error


def _found(address: str) -> str | None:
    """Return the address that ``auto`` stands for, as far as Ray says it."""
    if address != "auto":
        return address
    try:
        from ray._private.services import canonicalize_bootstrap_address

        found: str | None = canonicalize_bootstrap_address(address)
    except ImportError:  # no part of Ray's interface: another version may not have it
        return None
    except ConnectionError as error:
        remedy = f"no cluster is on this machine: {BEGIN}"
        raise ParameterError("ray-address", address, remedy) from error
    return found


def _own_cluster(workers: int) -> dict[str, Any]:
    return {
        "num_cpus": workers,
        "object_store_memory": OBJECT_STORE,
        "include_dashboard": False,
        "address": "local",
    }
