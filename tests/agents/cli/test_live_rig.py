"""Rigs: every section becomes its agent, every source of frames is opened, and the example and the page fit."""

import contextlib
import re
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
import pytest
from pydantic import BaseModel

from agents.camera.agent import Camera
from agents.configuration.rig import ArmSection, ReconstructionSection, RigConfig, RouterSection, simulated_rig
from agents.launch.builders import build
from agents.launch.in_the_way import in_the_way, taken
from agents.launch.perception_builder import perception_config
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

REPOSITORY = Path(__file__).parents[3]


def rig(text):
    return parse_config(text, RigConfig, "rig.toml")


def frames_of(camera, count):
    """What a camera sends in its first ticks."""
    sent = [output for i in range(count) for output in camera.step(Tick(i * 10**9))]
    return [o.message for o in sent if o.topic is FRAMES], [o.message for o in sent if o.topic is CALIBRATION]


@pytest.fixture
def section(small):
    """The beginning of a camera's section for the small pair of 320 by 180 pixels."""
    return f'[camera]\ncalibration = "{small / "calibration.json"}"\nencoding = "raw"\nunit = "mm"\n'


def test_every_section_of_the_simulated_rig_becomes_its_agent():
    simulated = simulated_rig()
    for kind, instance in simulated.agents_here():
        agent = build(simulated, kind, instance)
        assert (agent.kind, agent.instance) == (kind, instance)


@pytest.mark.parametrize(
    ("sections", "matches"),
    [
        ("[perception]", False),
        ("[perception]\nmatching = true", True),
        ('[perception]\n[reconstruction]\nmethod = "refined"', False),
        ('[perception]\n[reconstruction]\nmethod = "paper"', True),
    ],
)
def test_pixels_are_matched_where_the_method_or_the_configuration_asks_for_it(sections, matches):
    configuration = rig(sections)
    assert configuration.perception is not None
    assert perception_config(configuration.perception, configuration.needs_matching).matching is matches


def test_what_is_told_without_a_configuration_is_the_same_with_one():
    assert ArmSection().maximum_plan_age_s == RobotBridgeConfig().maximum_plan_age_s == MAXIMUM_PLAN_AGE_S
    named = ReconstructionSection.model_fields["method"]
    assert (set(get_args(named.annotation)), named.default) == (set(METHODS), DEFAULT_METHOD)


def test_only_what_has_a_section_is_configured_and_else_refused_with_what_there_is():
    assert rig("").agents_here() == []
    of_two_arms = rig("[robot.psm2]\n[camera]\n[robot.psm1]")
    assert of_two_arms.agents_here() == [("camera", "main"), ("robot_bridge", "psm2"), ("robot_bridge", "psm1")]
    with pytest.raises(ConfigError, match=r"\[planner\]"):
        build(of_two_arms, "planner", "main")
    with pytest.raises(ConfigError, match="psm1"):
        build(of_two_arms, "robot_bridge", "x")


def test_images_in_two_folders_are_frames(section, small, tmp_path):
    for eye in ("left", "right"):
        (tmp_path / eye).mkdir()
        (tmp_path / eye / "0001.png").write_bytes((small / f"{eye}.png").read_bytes())
    text = f'{section}source = "images"\nleft = "{tmp_path / "left"}"\nright = "{tmp_path / "right"}"\nloop = false'
    camera = build(rig(text), "camera", "main")
    frames, calibrations = frames_of(camera, 3)
    assert isinstance(camera, Camera)
    assert [(f.left.width, f.left.height, f.left.encoding) for f in frames] == [(320, 180, ImageEncoding.RAW)]
    assert [type(c) for c in calibrations] == [StereoCalibration]


def test_a_pipe_of_side_by_side_frames_is_frames(section, tmp_path, until):
    frame = np.arange(180 * 640 * 3, dtype=np.uint64).astype(np.uint8).reshape(180, 640, 3)
    stream = tmp_path / "stream"
    stream.write_bytes(2 * frame.tobytes())
    text = f'{section}source = "pipe"\nleft = "{stream}"\nwidth = 640\nheight = 180'
    camera = build(rig(text), "camera", "main")
    assert isinstance(camera, Camera)
    with contextlib.closing(camera._source):
        frames = until(lambda: frames_of(camera, 1)[0])
    assert [(f.left.width, f.right.height) for f in frames] == [(320, 180)]


def test_a_camera_whose_pipe_has_ended_says_so_and_ends(section, suturegrasp, settings, tmp_path):
    stream, config = tmp_path / "stream", tmp_path / "rig.toml"
    stream.write_bytes(bytes(180 * 640 * 3))
    source = f'source = "pipe"\nleft = "{stream}"\nwidth = 640\nheight = 180\n'
    config.write_text(f'rig = "test"\n[router]\nendpoint = "{settings.endpoint}"\n{section}{source}')
    ended = suturegrasp("run", "camera", "--config", config)
    assert ended.status == 1
    assert (
        ended.err.splitlines()[-1]
        == "suturegrasp: the pipe has ended; start what writes into it again, then the camera"
    )


def test_a_video_is_frames(section, tmp_path):
    path = tmp_path / "pair.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (640, 180))
    for level in (50, 100, 150):
        writer.write(np.full((180, 640, 3), level, np.uint8))
    writer.release()
    camera = build(rig(f'{section}source = "video"\nleft = "{path}"'), "camera", "main")
    frames, _ = frames_of(camera, 1)
    assert [(f.left.width, f.left.height) for f in frames] == [(320, 180)]


ASIDE = "[[1, 0, 0, 0.05], [0, 1, 0, 0], [0, 0, 1, -0.08], [0, 0, 0, 1]]"


def base(rows, arm="psm1"):
    """The section of an arm that stands there."""
    return f"[robot.{arm}]\nT_camera_base = {rows}"


def base_of(configured_rig, arm):
    """Where an arm stands by the first state that its bridge reports."""
    (output,) = build(configured_rig, "robot_bridge", arm).step(Tick(0))
    assert isinstance(output, Output)
    return output.message.T_camera_base


def test_each_arm_stands_in_a_place_of_its_own_or_where_it_is_told():
    two = rig("[robot.psm1]\n[robot.psm2]")
    for arm in ("psm1", "psm2"):
        np.testing.assert_array_equal(base_of(two, arm), SIMULATED_BASES[arm])
    told = rig(f"[robot.psm1]\n{base(ASIDE, 'left_arm')}")
    assert base_of(told, "left_arm")[0, 3] == 0.05
    assert parse_config(told.model_dump_json(), RigConfig, "rig.json") == told


def test_a_base_that_was_typed_in_with_few_digits_is_a_rotation():
    typed = "[[0.866, -0.5, 0, 0.05], [0.5, 0.866, 0, 0], [0, 0, 1, -0.08], [0, 0, 0, 1]]"
    T = base_of(rig(base(typed)), "psm1")
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.degrees(np.arctan2(T[1, 0], T[0, 0])) == pytest.approx(30.0, abs=0.05)


DVRK = '[robot.psm1]\nbackend = "dvrk"\n[robot.psm1.dvrk]\n'
MISTAKES = {
    '[camera]\nsource = "images"': "camera: source 'images' needs left",
    '[camera]\nsource = "video"\nleft = "a"': "camera: source 'video' needs calibration",
    '[camera]\nsource = "pipe"\nleft = "-"\ncalibration = "c"': "needs width and height",
    '[camera]\nsource = "ros"\nleft_topic = "a"': "source 'ros' needs endpoint, left_topic and right_topic",
    '[camera]\nsource = "magic"': "source = 'magic': it must be 'scene', 'images', 'video', 'pipe', 'bag',",
    "[camera]\nrate_hz = 0": "camera.rate_hz = 0: it must be greater than 0",
    '[router]\nendpoint = "localhost"': "'localhost' is no endpoint; write protocol, host and port",
    'rig = "my rig"': "rig: 'my rig' cannot be used; write small letters",
    '[robot.psm1]\nbackend = "ros"': "robot.psm1.backend = 'ros': it must be 'simulated' or 'dvrk'",
    '[robot.psm1]\nbackend = "dvrk"': "robot.psm1: backend 'dvrk' and a section dvrk with its endpoint go together",
    f'{DVRK}endpoint = "tcp/127.0.0.1:7448"': "backend 'dvrk' needs T_camera_base",
    f"{DVRK}[planner]": "robot.psm1.dvrk.endpoint is missing",
    f'{base(ASIDE)}\nbackend = "dvrk"\n[robot.psm1.dvrk]\nendpoint = "tcp/10.0.0.9:7"': "needs tls and [security]; or",
    f'{base(ASIDE)}\nbackend = "dvrk"\n[robot.psm1.dvrk]\nthrough_guard = false': "set points go through the guard",
    '[camera]\nsource = "ros"\nendpoint = "tcp/10.0.0.9:7"\nleft_topic = "a"\nright_topic = "b"': "camera.endpoint",
    "[robot.psm1]\nbakend = 1": "robot.psm1.bakend is unknown; did you mean backend?",
    "[robot.psm3]": "robot: psm3 needs T_camera_base; only psm1 and psm2 have a place of their own",
    base("[1, 2, 3]"): "robot.psm1.T_camera_base: write four rows of four numbers",
    base("[[1, 0, 0, nan], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"): "write four rows of four numbers",
    base(f"[[1{'0' * 400}, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"): "write four rows of four numbers",
    base("[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 2]]"): "its last row must be 0, 0, 0, 1",
    base("[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]"): "must be a rotation",
    base("[[1, 0, 0, 45], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"): "the base would be 45 m from the camera",
    f"{base(ASIDE)}\n{base(ASIDE, 'psm2')}": "robot: psm1 and psm2 stand in the same place",
    '[perception]\nmatching = false\n[reconstruction]\nmethod = "paper"': "matching = true",
    "[sim]": "sim is unknown; allowed here: rig, router, camera",
}


def test_a_mistake_names_the_key_and_what_is_allowed():
    for text, told in MISTAKES.items():
        with pytest.raises(ConfigError) as caught:
            rig(text)
        assert told in str(caught.value)


@pytest.mark.parametrize("command", ["run planner", "up", "doctor", "goal --s 0.5", "arm x", "record"])
def test_every_command_tells_a_mistake_in_one_line(suturegrasp, tmp_path, command):
    config = tmp_path / "rig.toml"
    config.write_text("[planer]")
    ended = suturegrasp(*command.split(), "--config", config)
    assert (ended.status, ended.out, len(ended.err.splitlines())) == (2, "", 1)
    assert "planer is unknown; did you mean planner?" in ended.err


def test_what_is_in_the_way_of_a_rig_is_told_with_its_remedy():
    endpoint = free_local_endpoint()
    free = RouterSection(endpoint=endpoint)
    assert in_the_way(rig("")).startswith("the configuration has no agent")
    assert in_the_way(rig("[planner]").model_copy(update={"router": free})) == ""
    piped = '[camera]\nsource = "pipe"\nleft = "-"\nwidth = 4\nheight = 2\ncalibration = "c"'
    assert "standard input" in in_the_way(rig(piped).model_copy(update={"router": free}))
    with open_router(endpoint):
        assert taken(endpoint)
        assert "already" in in_the_way(rig("[planner]").model_copy(update={"router": free}))
        joined = free.model_copy(update={"start": False})
        assert in_the_way(rig("[planner]").model_copy(update={"router": joined})) == ""
    assert not taken(endpoint)
    assert not taken("udp/127.0.0.1:7447")


def test_the_example_rig_is_the_simulated_one_spelt_out():
    example = load_config(REPOSITORY / "deploy" / "rig.toml", RigConfig)
    expected = simulated_rig().model_copy(update={"rig": "lab"})
    assert example == expected
    assert example.session == SessionSettings("lab", expected.router.endpoint)


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
            title = NAMED_SECTIONS.get(name, name)
            found |= sections(section, f"[{title}]")
    return {prefix: keys} | found


def values_allowed(field):
    """The words that a key may be, where it may only be some."""
    parts = (field.annotation, *get_args(field.annotation))
    return [value for part in parts for value in get_args(part) if isinstance(value, str)]


def default_as_written(field):
    if field.is_required() or field.default is None:
        return None
    return str(field.default).lower() if isinstance(field.default, bool) else str(field.default)


@pytest.mark.parametrize("title", sections(RigConfig))
def test_the_page_tells_every_key_with_its_default_and_what_it_may_be(title):
    parts = re.split(r"^## ", (REPOSITORY / "docs" / "configuration.md").read_text(), flags=re.M)
    (text,) = [part for part in parts if part.startswith(f"`{title}`")] if title else parts[:1]
    rows = dict(re.findall(r"^\| `(\w+)` \|(.*)$", text, flags=re.M))
    keys = sections(RigConfig)[title]
    assert set(rows) == set(keys)
    for name, field in keys.items():
        default = default_as_written(field)
        assert default in (None, "-") or f"`{default}`" in rows[name], (name, default)
        assert all(f"`{value}`" in rows[name] for value in values_allowed(field)), name
