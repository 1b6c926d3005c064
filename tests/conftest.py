"""A real router, real sessions, and a way to wait for a condition with a deadline.

A test machine may stall for many seconds. So nothing here waits for a fixed time, deadlines are long (who passes
does not wait for them), and whatever is started is ended, or ends with the process.
"""

import contextlib
import faulthandler
import threading

import pytest
from hypothesis import HealthCheck
from hypothesis import settings as hypothesis_settings

from shared.clock import monotonic_s
from shared.runtime.runner import Runner
from shared.runtime.session import RouterError, SessionSettings, free_local_endpoint, open_router, open_session

DEADLINE_S = 60.0
EXIT_S = 60.0
STANDARD_ERROR = 2

# how long an example takes says more about what else the machine does
# the same examples every time, for what a landing depends on must not be drawn by chance; and not more than pays
hypothesis_settings.register_profile(
    "patient", deadline=None, derandomize=True, max_examples=40, suppress_health_check=[HealthCheck.too_slow]
)
hypothesis_settings.load_profile("patient")


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session):
    """A process that cannot end after its tests says where it hangs, and ends with a failure."""
    # a worker waits for the others
    if not hasattr(session.config, "workerinput"):
        faulthandler.dump_traceback_later(EXIT_S, exit=True, file=STANDARD_ERROR)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport():
    """What a test printed may hold half a surrogate pair, which cannot travel between the processes of pytest."""
    report = yield
    report.sections = [(name, text.encode(errors="replace").decode()) for name, text in report.sections]
    return report


def wait_until(condition, what="the condition to come true", deadline_s=DEADLINE_S):
    """Wait until a condition holds and return its value; fail after a deadline, saying what was waited for."""
    end_s, turn = monotonic_s() + deadline_s, threading.Event()
    while not (value := condition()):
        assert monotonic_s() < end_s, f"waited {deadline_s:.0f} s for {what}"
        turn.wait(0.01)
    return value


@contextlib.contextmanager
def open_somewhere():
    """The endpoint of a new router; a port that was free may be taken by the time that it is listened on."""
    endpoint, router = wait_until(_opened, "a router on a free port")
    with router:
        yield endpoint


def _opened():
    endpoint = free_local_endpoint()
    with contextlib.suppress(RouterError):
        return endpoint, open_router(endpoint)
    return None


@contextlib.contextmanager
def run_in_threads(settings, *agents):
    """Agents in threads of their own, each with a session of its own; their runners."""
    with contextlib.ExitStack() as stack:
        runners = []
        for agent in agents:
            runner = Runner(agent, stack.enter_context(open_session(settings)), settings.rig)
            thread = threading.Thread(target=runner.run, name=agent.kind, daemon=True)
            thread.start()
            stack.callback(thread.join, DEADLINE_S)
            stack.callback(runner.stop)
            runners.append(runner)
        yield runners


@pytest.fixture(scope="session")
def until():
    """Wait for a condition."""
    return wait_until


@pytest.fixture(scope="session")
def router():
    """A router on a port of its own, for as long as it is needed."""
    return open_somewhere


@pytest.fixture(scope="session")
def in_threads():
    """Run agents for as long as they are needed."""
    return run_in_threads


@pytest.fixture(scope="session")
def heard_by_others():
    """Wait until a session knows of a subscriber to a key: what is published before may reach nobody."""

    def wait(session, key):
        probe = session.declare_publisher(key)
        wait_until(lambda: probe.matching_status.matching, f"a subscriber to {key}")
        probe.undeclare()

    return wait


@pytest.fixture
def settings(router):
    with router() as endpoint:
        yield SessionSettings(rig="test", endpoint=endpoint)


@pytest.fixture
def session(settings):
    with open_session(settings) as opened:
        yield opened


@pytest.fixture
def running(settings, monkeypatch):
    """Run agents in threads, each with a session of its own, and stop them at the end; their commands may take long."""
    monkeypatch.setattr("shared.runtime.commands.FARTHEST_DEADLINE_S", 2 * DEADLINE_S)
    with contextlib.ExitStack() as stack:

        def run(agent):
            (runner,) = stack.enter_context(run_in_threads(settings, agent))
            return runner

        yield run
