"""Status on a real router, with agents that are well, gone, hanging, holding, and sent what they cannot read."""

import contextlib
import json
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from agents.configuration.rig import (
    PerceptionSection,
    PlannerSection,
    RigConfig,
    RouterSection,
    simulated_rig,
)
from agents.diagnostics.status.judgement import judge
from agents.diagnostics.status.watch import StatusWatch
from agents.launch.builders import build
from agents.operator.operator import hold
from agents.planner.agent import Planner
from schemas.topics import EXECUTION, THREAD, key
from shared.runtime.agent import Agent, Input
from shared.runtime.attachment import Attachment, encoding_of, pack
from shared.runtime.connection import connected
from shared.runtime.delivery import declare_publisher
from shared.runtime.session import free_local_endpoint, open_router

SCRIPT = Path(sys.executable).with_name("suturegrasp")
RIG = "test"


def rig_at(settings, **sections):
    return RigConfig(
        rig=RIG, router=RouterSection(endpoint=settings.endpoint), **(sections or {"planner": PlannerSection()})
    )


@pytest.fixture
def watching():
    """What is wrong with a rig, or worth knowing, as it is found while it is watched; what of it is grave."""

    @contextlib.contextmanager
    def watch(rig):
        with connected(rig.session, 60.0) as connection, contextlib.closing(StatusWatch(connection, rig)) as status:
            status.start()

            def wrongs():
                return {(wrong.code, wrong.about): wrong for wrong in judge(status.gathered())}

            def well():
                heard = all(fare.health is not None for fare in status.gathered().fares)
                return heard and not any(wrong.grave for wrong in wrongs().values())

            yield wrongs, well, connection

    return watch


def config_of(rig, folder):
    path = folder / "rig.toml"
    sections = "".join(f"[{name}]\n" for name in ("planner", "perception") if getattr(rig, name) is not None)
    path.write_text(f'rig = "{rig.rig}"\n[router]\nendpoint = "{rig.router_endpoint}"\nstart = false\n{sections}')
    return path


@pytest.mark.slow
def test_status_looks_once_and_its_exit_status_tells_whether_all_is_well(
    settings, running, suturegrasp, tmp_path, until
):
    running(Planner())
    rig = rig_at(settings)
    with connected(rig.session, 60.0) as connection:
        until(connection.facts)
    well = suturegrasp("status", "--once", "--config", config_of(rig, tmp_path))
    assert (well.status, well.err) == (0, ""), well.out
    assert re.search(r"^planner +well", well.out, flags=re.M)
    assert well.out.endswith("all is well\n")
    both = rig.model_copy(update={"perception": PerceptionSection()})
    ill = suturegrasp("status", "--once", "--json", "--config", config_of(both, tmp_path))
    told = json.loads(ill.out)
    assert (ill.status, told["well"], told["router"]["answers"]) == (1, False, True)
    assert told["wrong"] == [{"code": "absent", "about": "perception", "text": told["wrong"][0]["text"]}]
    agents = {agent["name"]: agent for agent in told["agents"]}
    assert (agents["perception"]["state"], agents["perception"]["health"]) == ("absent", None)
    assert agents["planner"]["health"]["resident_bytes"] > 0
    assert agents["planner"]["facts"]["schemas_hash"]
    assert [host["agents"] for host in told["hosts"]] == [["planner"]]


@pytest.mark.slow
def test_status_says_that_no_router_answers(suturegrasp, tmp_path):
    config = tmp_path / "rig.toml"
    config.write_text(f'[router]\nendpoint = "{free_local_endpoint()}"\n[planner]\n')
    ended = suturegrasp("status", "--once", "--json", "--config", config)
    told = json.loads(ended.out)
    assert (ended.status, [wrong["code"] for wrong in told["wrong"]]) == (1, ["router"])


@pytest.mark.slow
def test_status_tells_a_document_a_second_until_it_is_stopped_or_nobody_reads_it(settings, running, tmp_path):
    running(Planner())
    arguments = [str(SCRIPT), "status", "--json", "--config", str(config_of(rig_at(settings), tmp_path))]
    for stopped in (True, False):
        with subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None and process.stderr is not None
            first, second = (json.loads(process.stdout.readline()) for _ in range(2))
            assert first["at_ns"] < second["at_ns"]
            assert [agent["name"] for agent in second["agents"]] == ["planner"]
            if stopped:
                process.send_signal(signal.SIGINT)
            else:
                process.stdout.close()
            try:
                assert process.wait(60) == 0
            finally:
                process.kill()
            assert process.stderr.read() == ""


class Stuck(Agent):
    """An agent whose step does not end before it is let go."""

    kind, instance, tick_hz = "planner", "main", 10.0
    inputs: tuple[Input, ...] = ()
    outputs, commands = (), ()

    def __init__(self):
        self.go_on = threading.Event()
        self.begins = threading.Event()

    def step(self, arrived: Any):
        if self.begins.is_set():
            self.go_on.wait()
        return ()


@pytest.mark.slow
def test_a_loop_that_does_not_turn_hangs_though_its_session_lives(settings, in_threads, watching, until):
    stuck = Stuck()
    with in_threads(settings, stuck), watching(rig_at(settings)) as (wrongs, well, _):
        try:
            until(well, "the agent to be well")
            stuck.begins.set()
            hangs = until(lambda: wrongs().get(("hanging", "planner")), "the agent to hang")
        finally:
            stuck.go_on.set()
        assert "its loop has not turned" in hangs.text
        until(well, "the agent to go on")


@pytest.mark.slow
def test_a_router_that_goes_is_all_that_is_told_until_it_is_back_and_an_agent_that_ends_is_gone(
    in_threads, watching, until
):
    endpoint = free_local_endpoint()
    rig = RigConfig(rig=RIG, router=RouterSection(endpoint=endpoint), planner=PlannerSection())
    with contextlib.ExitStack() as stack, contextlib.ExitStack() as planner:
        with open_router(endpoint):
            planner.enter_context(in_threads(rig.session, Planner()))
            wrongs, well, _ = stack.enter_context(watching(rig))
            until(well, "the planner to be well")
        until(lambda: list(wrongs()) == [("router", "router")], "the router to be missed")
        with open_router(endpoint):
            until(well, "all to be well again")
            planner.close()
            until(lambda: ("gone", "planner") in wrongs(), "the planner to be gone")


@pytest.mark.slow
def test_an_arm_that_holds_because_it_was_told_to_is_a_note(settings, running, watching, until):
    arm = simulated_rig()
    rig = rig_at(settings, robot=arm.robot)
    running(build(arm, "robot_bridge", "psm1"))
    with watching(rig) as (wrongs, well, connection):
        until(well, "the arm to be well")
        hold(connection, "psm1")
        held = until(lambda: wrongs().get(("held", "psm1")), "the arm to hold")
    assert held.grave is False


@pytest.mark.rig
@pytest.mark.parametrize(
    ("command", "name"),
    [
        (("view", "--show", "file", "--output"), "viewer"),
        (("page", "--no-open", "--port", "0"), "operator"),
        (("record", "--output"), "recorder"),
    ],
)
def test_what_only_looks_on_tells_how_it_fares_and_what_it_refused(
    settings, session, watching, until, tmp_path, command, name
):
    config = tmp_path / "rig.toml"
    config.write_text(f'rig = "{RIG}"\n[router]\nendpoint = "{settings.endpoint}"\nstart = false\n')
    output = (str(tmp_path / "session.out"),) if command[-1] == "--output" else ()
    process = subprocess.Popen(
        [SCRIPT, *command, *output, "--config", config], stdout=subprocess.DEVNULL, stdin=subprocess.DEVNULL
    )
    own = key(RIG, EXECUTION, "psm1")
    foreign = encoding_of(EXECUTION.message, key(RIG, EXECUTION, "psm2"))
    try:
        with watching(rig_at(settings, recorder=None)) as (wrongs, _, connection):
            until(lambda: connection.facts().get(f"{name}/main"), f"the {name} to tell of itself")

            def refused():
                session.put(own, b"of another arm", encoding=foreign)
                return wrongs().get(("refused", name))

            told = until(refused, "what it refused to be told")
    finally:
        process.terminate()
        process.wait(60)
    assert "of robot_bridge/execution since it started" in told.text


@pytest.mark.slow
def test_what_an_agent_cannot_read_is_told(settings, session, running, watching, until):
    running(Planner())
    publisher = declare_publisher(session, key(RIG, THREAD), THREAD)
    with watching(rig_at(settings)) as (wrongs, _, _):

        def refused():
            publisher.put(b"\xff", attachment=pack(Attachment(1, 0, 0, 0.0)))
            return wrongs().get(("refused", "planner"))

        told = until(refused, "the planner to refuse it")
        assert f"of {THREAD} since it started" in told.text
        assert until(lambda: wrongs().get(("warning", "planner")), "its log to say so").grave is False
    publisher.undeclare()
