"""A real router, real sessions, and a way to wait for a condition with a deadline."""

import contextlib
import socket
import threading

import pytest

from shared.clock import monotonic_s
from shared.runtime.runner import Runner
from shared.runtime.session import SessionSettings, open_router, open_session

DEADLINE_S = 15.0


def free_endpoint():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def settings():
    endpoint = free_endpoint()
    with open_router(endpoint):
        yield SessionSettings(rig="test", endpoint=endpoint)


@pytest.fixture
def session(settings):
    with open_session(settings) as opened:
        yield opened


@pytest.fixture
def running(settings):
    """Run agents in threads, each with a session of its own, and stop them at the end."""
    with contextlib.ExitStack() as stack:

        def run(agent):
            opened = stack.enter_context(open_session(settings))
            runner = Runner(agent, opened, settings.rig)
            thread = threading.Thread(target=runner.run, name=agent.kind)
            thread.start()
            stack.callback(thread.join, DEADLINE_S)
            stack.callback(runner.stop)
            return runner

        yield run


@pytest.fixture
def until():
    def wait(condition):
        """Wait until a condition holds and return its value; fail after a deadline."""
        deadline_s = monotonic_s() + DEADLINE_S
        turn = threading.Event()
        while not (value := condition()):
            assert monotonic_s() < deadline_s, "the condition did not come true in time"
            turn.wait(0.01)
        return value

    return wait
