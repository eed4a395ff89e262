"""One thread for everything: the matrices are small, and idle threads of a pool stall a busy machine.

No window on the screen. And Ctrl-C ends what the tests begin, which it would not where a shell began the
tests in the background: then they ignore it, and so do the processes that they begin.
"""

import importlib.util
import os
import signal
import tempfile

import pytest

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_sessionstart(session):
    """Compile before the workers of a whole run begin: each would do all of it, at the same time."""
    config = session.config
    workers = getattr(config.option, "numprocesses", None)  # None in a worker, too
    whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS
    if workers and whole and not config.option.collectonly and importlib.util.find_spec("numba"):
        from compile_kernels import compile_all

        compile_all(workers)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Give each worker files in a row, so that what a module's fixture makes is made once."""
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log) if config.getvalue("dist") == "load" else None


@pytest.fixture(autouse=True)
def _a_slow_machine_adds_no_line_to_standard_error(monkeypatch):
    """A command says after half a second that it works; how long it takes here depends on the load."""
    from agents import progress

    monkeypatch.setattr(progress, "FIRST_LINE", 3600.0)


@pytest.fixture(scope="session", autouse=True)
def _bounds_of_the_tests_are_kept_among_their_own_files(tmp_path_factory):
    os.environ["SHAKE_ENV_CACHE"] = str(tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="session", autouse=True)
def _temporary_files_among_the_tests_own(tmp_path_factory):
    """SB3 gives every `learn` without a logger a folder of its own, and never takes it away."""
    tempfile.tempdir = os.environ["TMPDIR"] = str(tmp_path_factory.mktemp("temporary"))
