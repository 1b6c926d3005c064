"""The Zenoh of a robot's computer, as its file says: who gets in, and what each may say, by trying."""

import contextlib
import datetime
import json
import queue
import re

import pytest
import zenoh

from agents.configuration.rig import RigConfig
from agents.configuration.sections import ArmSection, DvrkSection
from agents.deployment.certificates import issue
from agents.deployment.layout import Host, Layout, Process
from agents.deployment.robot_zenoh import ROBOT_ZENOH, ReachedArm, robot_zenoh
from agents.launch.guard_process import document_of
from agents.robot_bridge.dvrk.psm import DvrkPsm
from shared.clock import now_ns
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.ros.guarded import CHALLENGE, GUARDED, SET_POINT, key_of
from shared.ros.link import RosLink
from shared.ros.naming import RmwZenoh, Ros2dds
from shared.ros.types import JOINT_STATE
from shared.runtime.connection import NoRouterError, open_when_there
from shared.runtime.identity import identity_in
from shared.runtime.session import RouterError, SessionSettings, free_local_endpoint, open_from

BRIDGE, GUARD, ANOTHER = "robot_bridge.psm1", "guard.psm1", "camera.main"
SERVO, PASSED, ASKED = "PSM1/servo_jp", key_of("PSM1", SET_POINT), key_of("PSM1", CHALLENGE)
MAY_SAY = {BRIDGE: {PASSED}, GUARD: {SERVO, ASKED}}


@pytest.mark.slow
@pytest.mark.parametrize("codec", ["ros2dds", "rmw_zenoh"])
def test_only_an_arms_bridge_and_guard_get_in_and_each_says_what_is_its_own(tmp_path, codec):
    processes = tuple(Process(*name.split(".")) for name in (BRIDGE, GUARD, ANOTHER, f"{ROBOT_ZENOH}.robot"))
    layout = Layout("lab", "tls/127.0.0.1:1", (Host("robot", "127.0.0.1", processes),), 30, 3650)
    issue(layout, tmp_path, datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC))
    certificates, endpoint = tmp_path / "robot" / "certificates", free_local_endpoint().replace("tcp", "tls")
    arms = (ReachedArm("psm1", "PSM1", endpoint, codec, 3),)
    file = tmp_path / "zenoh.json5"
    file.write_text(json.dumps(robot_zenoh(arms, identity_in(certificates, f"{ROBOT_ZENOH}.robot"))))
    naming, heard = Ros2dds() if codec == "ros2dds" else RmwZenoh(3), queue.Queue()
    overheard: list[str] = []

    def overhear(sample: zenoh.Sample) -> None:
        overheard.append(sample.payload.to_string())

    with contextlib.ExitStack() as stack:
        robot = stack.enter_context(open_from(file))
        if codec == "ros2dds":
            # without a certificate nobody gets in
            with pytest.raises(NoRouterError):
                open_when_there(SessionSettings(endpoint=endpoint), 1.0)
        robot.declare_subscriber("**", lambda sample: heard.put(sample.payload.to_string()))
        for name in (ANOTHER, BRIDGE, GUARD):
            settings = SessionSettings(endpoint=endpoint, identity=identity_in(certificates, name))
            session = stack.enter_context(open_when_there(settings, 20.0))
            if name == ANOTHER:
                session.declare_subscriber("**", overhear, allowed_origin=zenoh.Locality.REMOTE)
            session.put(naming.key(SERVO, JOINT_STATE), f"{name} {SERVO}")
            for topic in (PASSED, ASKED):
                session.put(topic, f"{name} {topic}")
            # each may say this, or nothing at all
            session.put(naming.key("PSM1/hold", "std_msgs/msg/Empty"), f"{name} hold")
        said = [heard.get(timeout=20.0)]
        while f"{GUARD} hold" not in said:
            said.append(heard.get(timeout=20.0))
    assert not overheard
    assert sorted(said) == sorted(f"{name} {topic}" for name, topics in MAY_SAY.items() for topic in (*topics, "hold"))


def test_whatever_bridge_and_guard_hear_and_say_on_the_robots_side_is_let_across(tmp_path):
    arms = (ReachedArm("psm1", "PSM1", "tls/10.0.0.13:7448", "ros2dds", 0),)
    told = robot_zenoh(arms, identity_in(tmp_path, ROBOT_ZENOH))
    backend = DvrkPsm("PSM1", SessionSettings(), Ros2dds(), "", dry_run=False)
    assert isinstance(backend._link, RosLink)
    section = DvrkSection(endpoint="tcp/127.0.0.1:1", pedal="console/operator_present")
    rig = RigConfig(
        robot={"psm1": ArmSection(backend="dvrk", T_camera_base=SIMULATED_T_CAMERA_BASE.tolist(), dvrk=section)}
    )
    guard = document_of(rig, "psm1", section)["robot"]
    rules = {rule["id"]: set(rule["key_exprs"]) for rule in told["access_control"]["rules"]}
    assert set(backend._link._said) == rules[f"speak as {BRIDGE}"]
    assert set(guard["says"].values()) == rules[f"speak as {GUARD}"]
    allow = told["plugins"]["ros2dds"]["allow"]
    heard = {each.topic for each in backend._link._heard} | set(guard["hears"].values())
    said = set(backend._link._said) | set(guard["says"].values())
    for side, topics in (("publishers", heard), ("subscribers", said)):
        # what bridge and guard say to each other reaches no console
        crossing = {topic for topic in topics if not topic.startswith(GUARDED)}
        assert crossing
        missing = [t for t in crossing if not any(re.fullmatch(regex, f"/{t}") for regex in allow[side])]
        assert not missing, side


def test_a_file_that_zenoh_does_not_take_is_told_in_one_sentence(tmp_path):
    (tmp_path / "zenoh.json5").write_text("{ mode: ")
    with pytest.raises(RouterError, match=r"zenoh\.json5 is no configuration that Zenoh takes"):
        open_from(tmp_path / "zenoh.json5")
