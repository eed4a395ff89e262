"""A controller in a process of its own: what it answers to datagrams."""

import os
import shutil
import signal
import socket
import time

import numpy as np
import pytest

from agents.deployment.channels import observation_channels
from agents.deployment.rehearsal.controller_process import start_controller
from agents.deployment.rehearsal.datagram import BEGINS, MEASUREMENT, REFUSED, Datagram, unpack
from shake_env import make_scenario

needs_compiler = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler is installed"
)


@pytest.mark.parametrize("runs", ["c", "python"])
@needs_compiler
def test_a_controller_answers_each_measurement_of_a_begun_test_once(runs):
    scenario = make_scenario("laboratory")
    channels = np.zeros(scenario.observation.size)
    process = start_controller("pid", scenario, runs, supervised=False)
    sent = [  # test, period, flags, and what the answer says of those ignored; None: no answer
        (1, 5, 0, None), (7, 0, BEGINS, 0), (7, 0, BEGINS, None), (7, 1, 0, 1), (7, 1, 0, None),
        (7, 0, BEGINS, None), (8, 2, 0, None), (7, 2, 0, 4), (8, 0, BEGINS, 0), (8, 1, 0, 0),
    ]  # fmt: skip
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as endpoint:
            endpoint.settimeout(20.0)
            for test, period, flags, _ in sent:
                data = Datagram(MEASUREMENT, period, 0.0, channels, flags, test).pack()
                endpoint.sendto(data, ("127.0.0.1", process.port))
            for test, period, _, ignored in sent:
                if ignored is not None:
                    answer = unpack(endpoint.recv(1000))
                    assert (answer.test, answer.sequence, answer.flags) == (test, period, ignored << 8)
    finally:
        process.close()


@pytest.mark.parametrize("runs", ["c", "python"])
@needs_compiler
def test_a_test_whose_first_measurement_is_refused_begins_without_memory(runs):
    scenario = make_scenario("laboratory")
    rng = np.random.default_rng(0)
    shown = np.array([each.scale for each in observation_channels(scenario)])
    shown = shown * rng.normal(0.0, 0.1, (6, len(shown)))
    bad = np.full(len(shown[0]), np.nan)
    sent = [(1, k, BEGINS if k == 0 else 0, row) for k, row in enumerate(shown)]
    sent += [(2, 0, BEGINS, bad), (2, 1, 0, shown[0]), (3, 0, BEGINS, shown[0])]
    process = start_controller("lqg", scenario, runs, supervised=False)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as endpoint:
            endpoint.settimeout(20.0)
            answers = []
            for test, period, flags, channels in sent:
                data = Datagram(MEASUREMENT, period, 0.0, channels, flags, test).pack()
                endpoint.sendto(data, ("127.0.0.1", process.port))
                answers.append(unpack(endpoint.recv(1000)))
    finally:
        process.close()
    refused, after, begun = answers[-3:]
    assert refused.flags & REFUSED and refused.channels[0] == 0.0
    assert after.channels[0] == begun.channels[0] == answers[0].channels[0] != 0.0


@needs_compiler
def test_a_program_that_was_stopped_goes_on():
    """A signal that lets it go on ends its wait for a datagram, not the program."""
    scenario = make_scenario("laboratory")
    process = start_controller("pid", scenario, "c", supervised=False)
    try:
        os.kill(process.pid, signal.SIGSTOP)
        os.kill(process.pid, signal.SIGCONT)
        time.sleep(0.2)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as endpoint:
            endpoint.settimeout(20.0)
            data = Datagram(MEASUREMENT, 0, 0.0, np.zeros(scenario.observation.size), BEGINS, 1).pack()
            endpoint.sendto(data, ("127.0.0.1", process.port))
            assert unpack(endpoint.recv(1000)).sequence == 0
    finally:
        process.close()
