"""Status on a real router: agents that are well, gone, holding, replayed, and sent what they cannot read."""

import contextlib
import json
import re
import signal
import subprocess
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agents.configuration.hosts import HostSection
from agents.configuration.rig import CameraSection, PlannerSection, RigConfig, RouterSection, simulated_rig
from agents.diagnostics.status.gathered import Gathered, expected_rates, placed_agents, placed_beside
from agents.diagnostics.status.health_watch import HealthWatch
from agents.diagnostics.status.judgement import judge
from agents.diagnostics.status.watch import StatusWatch
from agents.launch.builders import build
from agents.operator.operator import hold
from agents.planner.agent import Planner
from schemas.codec import encode
from schemas.messages import Judgement, ReplayClock, Severity
from schemas.topics import EXECUTION, HEALTH, REPLAY_CLOCK, THREAD, key
from shared.runtime.attachment import Attachment, encoding_of, pack
from shared.runtime.config import load_config
from shared.runtime.connection import connected
from shared.runtime.delivery import declare_publisher
from shared.runtime.session import free_local_endpoint, open_router
from shared.runtime.taps import Tapped
from tests.agents.cli.conftest import REPOSITORY, SCRIPT
from tests.agents.cli.heard import NOW_NS, health

RIG = "test"


def rig_at(endpoint, **sections):
    told = sections or {"planner": PlannerSection()}
    return RigConfig.model_validate({"rig": RIG, "router": RouterSection(endpoint=endpoint), **told})


@contextlib.contextmanager
def watching(rig):
    """What is wrong with a rig, or worth knowing, as it is found while it is watched; whether none of it is grave."""
    with connected(rig.session, 60.0) as connection, contextlib.closing(StatusWatch(connection, rig)) as status:
        status.start()

        def wrongs():
            return {(wrong.code, wrong.about): wrong for wrong in judge(status.gathered())}

        def well():
            heard = all(fare.health is not None for fare in status.gathered().fares)
            return heard and not any(wrong.grave for wrong in wrongs().values())

        yield wrongs, well, connection


@pytest.mark.slow
def test_status_looks_once_and_its_exit_status_tells_whether_all_is_well(
    settings, running, suturegrasp, rig_file, until, tmp_path
):
    running(Planner())
    with connected(settings, 60.0) as connection:
        until(connection.facts)
    well = suturegrasp("status", "--once", "--config", rig_file("[planner]"))
    assert (well.status, well.err) == (0, ""), well.out
    assert re.search(r"^planner +well", well.out, flags=re.M)
    assert well.out.endswith("all is well\n")
    ill = suturegrasp("status", "--once", "--json", "--config", rig_file("[planner]\n[perception]"))
    told = json.loads(ill.out)
    assert (ill.status, told["well"], told["router"]["answers"]) == (1, False, True)
    assert [(wrong["code"], wrong["about"]) for wrong in told["wrong"]] == [("absent", "perception")]
    agents = {agent["name"]: agent for agent in told["agents"]}
    assert (agents["perception"]["state"], agents["perception"]["health"]) == ("absent", None)
    assert agents["planner"]["health"]["resident_bytes"] > 0
    assert agents["planner"]["facts"]["schemas_hash"]
    assert [host["agents"] for host in told["hosts"]] == [["planner"]]
    config = tmp_path / "alone.toml"
    config.write_text(f'[router]\nendpoint = "{free_local_endpoint()}"\n[planner]\n')
    ended = suturegrasp("status", "--once", "--json", "--config", config)
    assert (ended.status, [wrong["code"] for wrong in json.loads(ended.out)["wrong"]]) == (1, ["router"])


@pytest.mark.slow
def test_status_tells_a_document_a_second_until_it_is_stopped_or_nobody_reads_it(running, rig_file):
    running(Planner())
    arguments = [SCRIPT, "status", "--json", "--config", str(rig_file("[planner]"))]
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


@pytest.mark.slow
def test_a_router_that_goes_is_all_that_is_told_until_it_is_back_and_an_agent_that_ends_is_gone(in_threads, until):
    endpoint = free_local_endpoint()
    rig = rig_at(endpoint)
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
def test_an_arm_that_holds_because_it_was_told_to_is_a_note(settings, running, until):
    arm = simulated_rig()
    running(build(arm, "robot_bridge", "psm1"))
    with watching(rig_at(settings.endpoint, robot=arm.robot)) as (wrongs, well, connection):
        until(well, "the arm to be well")
        hold(connection, "psm1")
        held = until(lambda: wrongs().get(("held", "psm1")), "the arm to hold")
    assert held.grave is False


@pytest.mark.slow
def test_what_an_agent_cannot_read_is_told(settings, session, running, until):
    running(Planner())
    publisher = declare_publisher(session, key(RIG, THREAD), THREAD)
    with watching(rig_at(settings.endpoint)) as (wrongs, _, _):

        def refused():
            publisher.put(b"\xff", attachment=pack(Attachment(1, 0, 0, 0.0)))
            return wrongs().get(("refused", "planner"))

        told = until(refused, "the planner to refuse it")
        assert f"of {THREAD} since it started" in told.text
        assert until(lambda: wrongs().get(("warning", "planner")), "its log to say so").grave is False
    publisher.undeclare()


@pytest.mark.rig
@pytest.mark.parametrize("name", ["viewer", "operator", "recorder"])
def test_what_only_looks_on_tells_how_it_fares_and_what_it_refused(settings, session, until, tmp_path, rig_file, name):
    words = {
        "viewer": "view --show file --output {}",
        "operator": "page --no-open --port 0",
        "recorder": "record --output {}",
    }
    command = [SCRIPT, *words[name].format(tmp_path / "session.out").split(), "--config", str(rig_file())]
    foreign = encoding_of(EXECUTION.message, key(RIG, EXECUTION, "psm2"))
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stdin=subprocess.DEVNULL) as process:
        try:
            with watching(rig_at(settings.endpoint, recorder=None)) as (wrongs, _, connection):
                until(lambda: connection.facts().get(f"{name}/main"), f"the {name} to tell of itself")

                def refused():
                    session.put(key(RIG, EXECUTION, "psm1"), b"of another arm", encoding=foreign)
                    return wrongs().get(("refused", name))

                told = until(refused, "what it refused to be told")
        finally:
            process.terminate()
    assert "of robot_bridge/execution since it started" in told.text


def test_agents_are_expected_where_the_rig_places_them_and_as_often_as_the_camera_films():
    rates = expected_rates(RigConfig(camera=CameraSection(rate_hz=25)))
    assert [rates[t] for t in ("camera/frames", "reconstruction/thread", "robot_bridge/state")] == [25, 25, 5]
    assert "perception/surface" not in rates
    assert set(placed_agents(simulated_rig())) == {
        "camera", "perception", "reconstruction", "planner", "simulator", "robot_bridge psm1", "recorder",
    }  # fmt: skip
    hosts = {
        "video": HostSection(address="10.0.0.1", runs=("camera", "recorder")),
        "desk": HostSection(address="10.0.0.2", runs=("robot_bridge psm1", "operator", "viewer")),
    }
    rig = simulated_rig().model_copy(update={"hosts": hosts})
    assert placed_agents(rig) == {"camera": "video", "recorder video": "video", "robot_bridge psm1": "desk"}
    # a guard is expected where something is sent to the arm
    for dry_run, expected in ((False, {"robot_bridge psm1", "guard psm1"}), (True, {"robot_bridge psm1"})):
        dvrk = {"endpoint": "tcp/127.0.0.1:7448", "dry_run": dry_run}
        arm = {"backend": "dvrk", "dvrk": dvrk, "T_camera_base": np.eye(4).tolist()}
        assert set(placed_agents(RigConfig.model_validate({"robot": {"psm1": arm}}))) == expected


@pytest.fixture
def watch():
    """Watches two agents and viewers of the lab; and what it hears."""
    lab = load_config(REPOSITORY / "deploy" / "lab.toml", RigConfig)
    deaf: Any = SimpleNamespace(listen=lambda *_: None)
    watch = HealthWatch(deaf, ["camera"], {"camera": "video"} | placed_beside(lab))

    def hear(topic, agent, message, epoch=6, instance="main"):
        beside = Attachment(epoch, 0, 0, 0.0)
        watch._take(Tapped(topic, key("lab", topic, instance, agent), encode(message), beside))

    return watch, hear


def test_a_viewer_that_nobody_expects_is_shown_on_its_host(watch):
    watch, hear = watch
    hear(HEALTH, "viewer", health("viewer", "desk"), instance="desk")
    fares = {one.name: (one.placed, one.expected) for one in watch.fares()}
    assert fares == {"camera": ("video", True), "viewer desk": ("desk", False)}


def test_what_a_replay_tells_for_agents_is_not_judged(watch):
    watch, hear = watch
    hear(REPLAY_CLOCK, "replay", ReplayClock(NOW_NS, 1.0), 5)
    hear(HEALTH, "camera", health(version="0.1.0"), 5)
    hear(HEALTH, "planner", health("planner"), 6)
    hear(HEALTH, "perception", health("perception"), 5)
    watch.note_present(["camera/main", "planner/main", "perception/main"])
    assert [one.state for one in watch.fares()] == ["replayed", "well", "replayed"]
    swapped = Judgement("swapped", Severity.FAULT, "the eyes look exchanged", "exchange them")
    (wrong,) = judge(Gathered(NOW_NS, RIG, "", fares=tuple(watch.fares()), faults=(swapped,)))
    assert not wrong.grave
    assert wrong.text.startswith("a recording is replayed into this rig and stands for camera and perception")
    # once it has ended, whoever it stood for is not there
    watch._newest["camera"] = replace(watch._newest["camera"], silent_s=-9.0)
    watch.note_present(["planner/main"])
    assert "camera" in [
        w.about for w in judge(Gathered(NOW_NS, RIG, "", fares=tuple(watch.fares()))) if w.code == "absent"
    ]
