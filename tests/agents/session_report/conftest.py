"""Small sessions made by hand of real messages: frames, threads, a refused goal, a held grasp, health, logs."""

import itertools
from collections import defaultdict

import numpy as np
import pytest

from schemas import messages, topics
from schemas.codec import encode, encoding_name
from shared.images import encode_image
from shared.recording.entry import Entry
from shared.recording.writer import RecordingWriter

ZERO_NS = 1_760_000_000_000_000_000
CAMERA = messages.RectifiedStereo(96, 54, 100.0, 100.0, 47.5, 26.5, 5.5, 1e-3)
K = np.array([[100.0, 0, 47.5], [0, 100.0, 26.5], [0, 0, 1]])
SHIFT = np.array([[1.0, 0, 0, -5.5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
NONE = np.zeros(0)
NO_REGIONS = messages.ReliabilityRegions(NONE, np.zeros((0, 3)), np.zeros((0, 2)), NONE, NONE)
ACCEPTED = messages.CommandAnswer("", messages.Outcome.ACCEPTED, "", "")


def ns(at_s):
    return ZERO_NS + round(at_s * 1e9)


class Maker:
    """Collects messages with their times, and writes them as a recorder would."""

    def __init__(self):
        self.entries, self._numbers = [], defaultdict(itertools.count)

    def put(self, topic, message, at_s, instance=topics.MAIN, agent="", epoch=1, skip=0, repeated=False):
        name = topics.key("lab", topic, instance, agent)
        for _ in range(skip):
            next(self._numbers[name, epoch])
        entry = Entry(
            name, epoch, next(self._numbers[name, epoch]), encode(message), ns(at_s), ns(at_s) + 1000, repeated
        )
        self.entries.append((topic, entry))

    def command(self, topic, command, answer, at_s, agent, instance=topics.MAIN):
        record = messages.CommandRecord(str(topic), encoding_name(topic.message), encode(command), ns(at_s), answer)
        self.put(topics.COMMANDS, record, at_s, instance, agent)

    def write(self, path, notes=(("losses", {"complete": "True"}),), attached=None):
        writer = RecordingWriter(path)
        for name, data in (attached or {}).items():
            writer.attach(name, "application/json", data, ZERO_NS)
        for number, (topic, entry) in enumerate(sorted(self.entries, key=lambda pair: pair[1].received_ns)):
            writer.write(topic, entry)
            if number % 40 == 39:
                writer.flush()
        for name, facts in notes:
            writer.note(name, facts)
        writer.close()
        return path


def stamp(number, at_s):
    return messages.FrameStamp(number, ns(at_s), ns(at_s), "c")


def frame(number, at_s):
    pixels = np.full((54, 96, 3), 40 + number % 100, np.uint8)
    image = encode_image(pixels, messages.ImageEncoding.JPEG)
    return messages.StereoFrame(stamp(number, at_s), image, image)


def calibration(unit=1e-3):
    return messages.StereoCalibration(96, 54, K, K, NONE, NONE, SHIFT, unit)


def thread(number, at_s, unit: float | None = 1e-3, unseen=(), reason=""):
    """A straight thread of 40 mm, 100 mm away; its variance along the view grows from 1 to 9 square millimetres."""
    points = np.column_stack((np.linspace(-20, 20, 4), np.zeros(4), np.full(4, 100.0)))
    camera = messages.RectifiedStereo(96, 54, 100.0, 100.0, 47.5, 26.5, 5.5, unit)
    covariance = np.stack([np.diag([0.25, 0.25, 1.0]), np.diag([0.25, 0.25, 9.0])])
    ok = reason == ""
    return messages.ThreadReconstruction(
        stamp=stamp(number, at_s),
        camera=camera,
        status=messages.Status.OK if ok else messages.Status.FAILED,
        reason=reason,
        method="by hand",
        degree=3,
        knots=np.array([0.0, 0, 0, 0, 1, 1, 1, 1]) if ok else NONE,
        control_points_camera=points if ok else np.zeros((0, 3)),
        regions=NO_REGIONS,
        confidence_s=np.array([0.0, 1.0]) if ok else NONE,
        confidence=np.array([1.0, 0.5]) if ok else NONE,
        posterior_s=np.array([0.0, 1.0]) if ok else NONE,
        posterior_covariance=covariance if ok else np.zeros((0, 3, 3)),
        unseen=np.asarray(unseen, np.float64).reshape(-1, 2),
    )


def health(agent, at_s, dropped=0, fault="", instance=topics.MAIN, received=10):
    inputs = (messages.InputHealth("camera/frames", 30.0, 1.0, received, dropped, 0, 0),)
    return messages.AgentHealth(
        agent, instance, "bench", "0.0.1", "abc", ns(at_s), at_s, 1, 2.0 + at_s, 20.0 + at_s, inputs, (), fault
    )


def goal(number, s):
    return messages.GraspGoal(
        messages.CommandHeader(number, ns(99), "operator"), "psm1", messages.Policy.CAPTURE_SLIDE_GRASP, s, None, None
    )


def plan(goal_id, number, at_s):
    waypoints = tuple(
        messages.Waypoint(np.eye(4), 0.5, phase, 0.4) for phase in (messages.Phase.APPROACH, messages.Phase.GRASP)
    )
    return messages.GraspPlan(
        plan_id=f"plan-{goal_id}",
        arm="psm1",
        goal_id=goal_id,
        stamp=stamp(number, at_s),
        status=messages.Status.OK,
        reason="",
        policy=messages.Policy.CAPTURE_SLIDE_GRASP,
        s_goal=0.5,
        s_capture=0.4,
        probability=0.9,
        slide_m=0.004,
        waypoints=waypoints,
        alternatives=(),
    )


def event(kind, at_s, phase=None, code="", reason=""):
    return messages.ExecutionEvent("plan-g2", "psm1", ns(at_s), kind, phase, code, reason, "a1")


def robot_state(at_s):
    return messages.RobotState("psm1", ns(at_s), messages.RobotMode.IDLE, np.eye(4), np.zeros(6), 0.0, np.eye(4), "")


def made(frames=60, latency_s=0.05, unit=1e-3):
    """A session of 30 frames a second with one refused and one held grasp; frames 20 to 22 were lost."""
    maker = Maker()
    maker.put(topics.CALIBRATION, calibration(unit), 0.0)
    for number in range(frames):
        at_s = number / 30
        if number in (20, 21, 22):
            continue
        maker.put(topics.FRAMES, frame(number, at_s), at_s + 0.01, skip=3 if number == 23 else 0)
        reason = f"only {number} observations" if number in (5, 6) else ""
        maker.put(topics.THREAD, thread(number, at_s, unit, [(0.2, 0.4)], reason), at_s + 0.01 + latency_s)
        maker.put(topics.ROBOT_STATE, robot_state(at_s), at_s + 0.002, instance="psm1")
    for at_s in (0.1, 1.1):
        maker.put(topics.HEALTH, health("perception", at_s, dropped=round(at_s) + 3), at_s, agent="perception")
    maker.put(topics.HEALTH, health("planner", 1.2, fault="a step failed: ValueError"), 1.2, agent="planner")
    maker.put(
        topics.LOG,
        messages.LogRecord(
            ns(0.3), "planner", topics.MAIN, messages.LogLevel.WARNING, "<script>alert(1)</script> [bold]\x1b[31m"
        ),
        0.3,
        agent="planner",
    )
    maker.put(
        topics.LOG,
        messages.LogRecord(ns(0.2), "planner", topics.MAIN, messages.LogLevel.INFO, "started"),
        0.2,
        agent="planner",
    )
    stale = messages.CommandAnswer("g1", messages.Outcome.REFUSED, "thread_stale", "the thread was seen 2000 ms ago")
    maker.command(topics.GOAL, goal("g1", 0.3), stale, 0.4, "planner")
    maker.command(topics.GOAL, goal("g2", 0.5), ACCEPTED, 0.8, "planner")
    maker.put(topics.PLAN, plan("g2", 17, 17 / 30), 0.81)
    consent = messages.Arm(messages.CommandHeader("a1", ns(99), "operator"), "psm1", "plan-g2")
    maker.command(topics.ARM, consent, ACCEPTED, 0.9, "robot_bridge", "psm1")
    steps = [(messages.ExecutionKind.ACCEPTED, None, 0.91)]
    steps += [
        (messages.ExecutionKind.PHASE_REACHED, phase, 1.0 + phase.value / 10) for phase in list(messages.Phase)[:5]
    ]
    steps += [(messages.ExecutionKind.FINISHED, None, 1.6)]
    for kind, phase, at_s in steps:
        maker.put(topics.EXECUTION, event(kind, at_s, phase), at_s, instance="psm1")
    judged = messages.GraspJudgement(
        "plan-g2", "psm1", ns(1.65), messages.Verdict.HELD, 0.5, 0.004, 0.001, "grasp held: caught at 50 %"
    )
    maker.put(topics.JUDGEMENT, judged, 1.65)
    return maker


@pytest.fixture(scope="session")
def recording(tmp_path_factory):
    """The session as a finished file that tells what it was run with."""
    notes = [
        ("run", {"rig": "lab", "settings": '{"planner": {"depth_m": 0.002}}'}),
        ("lost", {"at_ns": str(ns(0.7)), topics.key("lab", topics.FRAMES): "3: 20-22 on the way"}),
        ("losses", {topics.key("lab", topics.FRAMES): "3", "complete": "False"}),
    ]
    return made().write(tmp_path_factory.mktemp("a") / "session.mcap", notes)


@pytest.fixture(scope="session")
def slower(tmp_path_factory):
    """The same, with results that take longer, and other settings."""
    notes = [("run", {"rig": "lab", "settings": '{"planner": {"depth_m": 0.005}}'}), ("losses", {"complete": "True"})]
    return made(latency_s=0.1).write(tmp_path_factory.mktemp("b") / "session.mcap", notes)


@pytest.fixture
def maker():
    """An empty session."""
    return Maker()


@pytest.fixture
def a_session():
    """Makes the session anew, to be changed before it is written."""
    return made
