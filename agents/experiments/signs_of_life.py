"""Signs of life of trials that several processes share, so that a lost process's trial is tried again.

A database keeps Optuna's heartbeats. A journal and the proxy have none: there a trial's process counts
up an attribute of the trial, and others watch by their own clocks whether it still does.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import Any, cast
from weakref import WeakKeyDictionary

HEARTBEAT = 30  # [s] between two signs of life of a trial
GRACE = 120  # [s] without one, after which another process tries the trial again
RETRIES = 3  # of a trial whose processes were lost
PULSE = "pulse"  # attribute that is counted up

# Of each study the pulse of a trial, and when it was seen first.
_seen: WeakKeyDictionary[Any, dict[int, tuple[Any, float]]] = WeakKeyDictionary()


def heartbeat_options() -> dict[str, Any]:
    """Return the options of a database's storage."""
    import optuna

    new = hasattr(optuna.storages, "RetryHeartbeatStaleTrialCallback")  # its name since Optuna 4.9
    name = "heartbeat_stale_trial_callback" if new else "failed_trial_callback"
    return {"heartbeat_interval": HEARTBEAT, "grace_period": GRACE, name: _retry()}


def _retry() -> Any:
    """Return what queues a lost trial again, with its attributes."""
    from optuna import storages

    if hasattr(storages, "RetryHeartbeatStaleTrialCallback"):
        return storages.RetryHeartbeatStaleTrialCallback(RETRIES)
    return storages.RetryFailedTrialCallback(RETRIES)


def sign_of_life(study: Any, trial: Any) -> AbstractContextManager[Any]:
    """Return what reports that a trial runs; in a file of one process nothing does."""
    from optuna.storages._heartbeat import get_heartbeat_thread, is_heartbeat_enabled

    if is_heartbeat_enabled(study._storage):
        # The first heartbeat is here and not the thread's: a process that is lost before it would leave
        # a trial that never counts as stale. The attribute tells others that there was one.
        study._storage.record_heartbeat(trial._trial_id)
        study._storage.set_trial_user_attr(trial._trial_id, PULSE, 0)
        return cast("AbstractContextManager[Any]", get_heartbeat_thread(trial._trial_id, study._storage))
    return pulse(study, trial)


@contextmanager
def pulse(study: Any, trial: Any) -> Iterator[None]:
    """Count up an attribute of a trial while it runs, where others have no other sign of it."""
    storage, number = study._storage, trial._trial_id
    if not has_pulse(storage):
        yield
        return
    over = threading.Event()
    storage.set_trial_user_attr(number, PULSE, 0)

    def count() -> None:
        beats = 0
        while not over.wait(HEARTBEAT):
            beats += 1
            # A storage that is away for a while misses signs; the trial itself tells of its failure.
            with suppress(Exception):
                storage.set_trial_user_attr(number, PULSE, beats)

    thread = threading.Thread(target=count, name="shake-pulse", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def has_pulse(storage: Any) -> bool:
    """Return whether a storage is shared and has no heartbeats of its own."""
    import optuna

    return isinstance(storage, optuna.storages.JournalStorage | optuna.storages.GrpcStorageProxy)


def retry_lost_trials(study: Any) -> None:
    """Queue again the trials of a study whose processes give no sign of life any more."""
    import optuna
    from optuna.storages._heartbeat import is_heartbeat_enabled

    beating = is_heartbeat_enabled(study._storage)
    if beating:
        optuna.storages.fail_stale_trials(study)
    elif not has_pulse(study._storage):
        return
    seen, now = _seen.setdefault(study, {}), time.monotonic()
    for trial in study.get_trials(deepcopy=False, states=(optuna.trial.TrialState.RUNNING,)):
        beats = trial.user_attrs.get(PULSE)
        if beating and beats is not None:
            continue  # the database's heartbeats tell
        if trial.number not in seen or seen[trial.number][0] != beats:
            seen[trial.number] = beats, now
        elif now - seen[trial.number][1] > GRACE:
            queue_again(study, trial)


def queue_again(study: Any, trial: Any) -> None:
    """Give up a running trial of a shared study, as the study has it, and queue its values again."""
    import optuna

    try:
        study.tell(trial.number, state=optuna.trial.TrialState.FAIL)
    except (ValueError, RuntimeError):  # another process has told
        return
    _retry()(study, trial)
