"""Rigs: every section becomes its agent, every source of frames is opened, and the example and the page fit."""

import contextlib
import re
from typing import get_args

import cv2
import numpy as np
import pytest
from pydantic import BaseModel

from agents.camera.agent import Camera
from agents.configuration.rig import ArmSection, ReconstructionSection, RigConfig, RouterSection, simulated_rig
from agents.launch.builders import build
from agents.launch.preflight import in_the_way, taken
from agents.reconstruction.method_names import DEFAULT_METHOD
from agents.reconstruction.methods import METHODS
from agents.robot_bridge.agent import RobotBridgeConfig
from agents.robot_bridge.limits import MAXIMUM_PLAN_AGE_S
from schemas.messages import ImageEncoding, StereoCalibration
from schemas.topics import CALIBRATION, FRAMES
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.runtime.agent import Output, Tick
from shared.runtime.config import ConfigError, load_config, parse_config
from shared.runtime.session import SessionSettings, free_local_endpoint, open_router
from tests.agents.cli.conftest import REPOSITORY


def rig(text):
    return parse_config(text, RigConfig, "rig.toml")


def test_every_section_becomes_its_agent_and_what_has_none_is_refused_with_what_there_is():
    simulated = simulated_rig()
    for kind, instance in simulated.agents_here():
        agent = build(simulated, kind, instance)
        assert (agent.kind, agent.instance) == (kind, instance)
    assert rig("").agents_here() == []
    of_two_arms = rig("[robot.psm2]\n[camera]\n[robot.psm1]")
    assert of_two_arms.agents_here() == [("camera", "main"), ("robot_bridge", "psm2"), ("robot_bridge", "psm1")]
    with pytest.raises(ConfigError, match=r"\[planner\]"):
        build(of_two_arms, "planner", "main")
    with pytest.raises(ConfigError, match="psm1"):
        build(of_two_arms, "robot_bridge", "x")
    example = load_config(REPOSITORY / "deploy" / "rig.toml", RigConfig)
    assert example == simulated.model_copy(update={"rig": "lab"}), "the example is the simulated one spelt out"
    assert example.session == SessionSettings("lab", simulated.router.endpoint)


def test_what_is_left_out_is_as_the_method_or_the_agent_needs_it():
    for sections, matches in (
        ("[perception]", False),
        ("[perception]\nmatching = true", True),
        ('[perception]\n[reconstruction]\nmethod = "refined"', False),
        ('[perception]\n[reconstruction]\nmethod = "paper"', True),
    ):
        assert build(rig(sections), "perception", "main").config.matching is matches
    assert ArmSection().maximum_plan_age_s == RobotBridgeConfig().maximum_plan_age_s == MAXIMUM_PLAN_AGE_S
    named = ReconstructionSection.model_fields["method"]
    assert (set(get_args(named.annotation)), named.default) == (set(METHODS), DEFAULT_METHOD)


@pytest.fixture
def section(small):
    """The beginning of a camera's section for the small pair of 320 by 180 pixels."""
    return f'[camera]\ncalibration = "{small / "calibration.json"}"\nencoding = "raw"\nunit = "mm"\n'


@pytest.fixture
def stream(tmp_path):
    """A stream of one side-by-side frame, and the keys of a section that reads it."""
    path = tmp_path / "stream"
    path.write_bytes(bytes(180 * 640 * 3))
    return f'source = "pipe"\nleft = "{path}"\nwidth = 640\nheight = 180\n'


def folders(small, tmp_path):
    for eye in ("left", "right"):
        (tmp_path / eye).mkdir()
        (tmp_path / eye / "0001.png").write_bytes((small / f"{eye}.png").read_bytes())
    return f'source = "images"\nleft = "{tmp_path / "left"}"\nright = "{tmp_path / "right"}"\nloop = false'


def video(_, tmp_path):
    writer = cv2.VideoWriter(str(tmp_path / "pair.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (640, 180))
    for level in (50, 100, 150):
        writer.write(np.full((180, 640, 3), level, np.uint8))
    writer.release()
    return f'source = "video"\nleft = "{tmp_path / "pair.avi"}"'


def sent(camera, at_ns):
    said = [output for output in camera.step(Tick(at_ns)) if isinstance(output, Output)]
    return [o.message for o in said if o.topic is FRAMES], [type(o.message) for o in said if o.topic is CALIBRATION]


@pytest.mark.parametrize("source", [folders, video])
def test_images_in_two_folders_and_a_video_are_frames(section, small, tmp_path, source):
    camera = build(rig(section + source(small, tmp_path)), "camera", "main")
    (frame,), calibrations = sent(camera, 0)
    assert (frame.left.width, frame.right.height, frame.left.encoding) == (320, 180, ImageEncoding.RAW)
    assert calibrations == [StereoCalibration]
    assert bool(sent(camera, 10**9)[0]) == (source is video), "one pair is shown once"


def test_a_pipe_of_side_by_side_frames_is_frames_until_it_ends(section, stream, suturegrasp, rig_file, until):
    camera = build(rig(section + stream), "camera", "main")
    assert isinstance(camera, Camera)
    with contextlib.closing(camera._source):
        (frame,) = until(lambda: sent(camera, 0)[0])
    assert (frame.left.width, frame.right.height) == (320, 180)
    ended = suturegrasp("run", "camera", "--config", rig_file(section + stream))
    assert ended.status == 1
    told = "suturegrasp: the pipe has ended; start what writes into it again, then the camera"
    assert ended.err.splitlines()[-1] == told


def base_of(told, arm):
    """Where an arm stands by the first state that its bridge reports."""
    (output,) = build(told, "robot_bridge", arm).step(Tick(0))
    assert isinstance(output, Output)
    return output.message.T_camera_base


def test_each_arm_stands_in_a_place_of_its_own_or_where_it_is_told():
    two = rig("[robot.psm1]\n[robot.psm2]")
    for arm in ("psm1", "psm2"):
        np.testing.assert_array_equal(base_of(two, arm), SIMULATED_BASES[arm])
    # what was typed in with few digits becomes a rotation
    typed = "[[0.866, -0.5, 0, 0.05], [0.5, 0.866, 0, 0], [0, 0, 1, -0.08], [0, 0, 0, 1]]"
    told = rig(f"[robot.psm1]\n[robot.left_arm]\nT_camera_base = {typed}")
    T = base_of(told, "left_arm")
    assert T[0, 3] == 0.05
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.degrees(np.arctan2(T[1, 0], T[0, 0])) == pytest.approx(30.0, abs=0.05)
    assert parse_config(told.model_dump_json(), RigConfig, "rig.json") == told


def test_what_is_in_the_way_of_a_rig_is_told_with_its_remedy():
    endpoint = free_local_endpoint()

    def told(text, start=True):
        router = RouterSection(endpoint=endpoint, start=start)
        return in_the_way(rig(text).model_copy(update={"router": router}))

    assert told("").startswith("the configuration has no agent")
    assert told("[planner]") == ""
    assert "standard input" in told('[camera]\nsource = "pipe"\nleft = "-"\nwidth = 4\nheight = 2\ncalibration = "c"')
    with open_router(endpoint):
        assert taken(endpoint)
        assert "already" in told("[planner]")
        assert told("[planner]", start=False) == ""
    assert not taken(endpoint)
    assert not taken("udp/127.0.0.1:7447")


NAMED_SECTIONS = {
    "robot": "robot.psm1",
    "tool_tracker": "tool_tracker.psm1",
    "dvrk": "robot.psm1.dvrk",
    "hosts": "hosts.video",
    "topics": 'topics."camera/frames"',
}
"""As the page gives a name to sections that users name, and to those within."""


def sections(model, prefix=""):
    """Every section of the configuration with its keys."""
    keys, found = {}, {}
    for name, field in model.model_fields.items():
        inner = [c for c in (field.annotation, *get_args(field.annotation)) if isinstance(c, type)]
        section = next((c for c in inner if issubclass(c, BaseModel)), None)
        if section is None:
            keys[name] = field
        else:
            found |= sections(section, f"[{NAMED_SECTIONS.get(name, name)}]")
    return {prefix: keys} | found


@pytest.mark.parametrize("title", sections(RigConfig))
def test_the_page_tells_every_key_with_its_default_and_what_it_may_be(title):
    parts = re.split(r"^## ", (REPOSITORY / "docs" / "configuration.md").read_text(), flags=re.M)
    (text,) = [part for part in parts if part.startswith(f"`{title}`")] if title else parts[:1]
    rows, keys = dict(re.findall(r"^\| `(\w+)` \|(.*)$", text, flags=re.M)), sections(RigConfig)[title]
    assert set(rows) == set(keys)
    for name, field in keys.items():
        default = None if field.is_required() or field.default in (None, "-") else field.default
        written = str(default).lower() if isinstance(default, bool) else str(default)
        assert default is None or f"`{written}`" in rows[name], (name, default)
        for part in (field.annotation, *get_args(field.annotation)):
            assert all(f"`{value}`" in rows[name] for value in get_args(part) if isinstance(value, str)), name
