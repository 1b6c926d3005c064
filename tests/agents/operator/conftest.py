"""A field made by hand: a straight thread 80 mm away that is known less well in its middle, and its images."""

import asyncio
import contextlib
import logging
import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from agents.cli.page.recording import RigRecording
from agents.configuration.rig import simulated_rig
from agents.operator.access import Access
from agents.operator.desk import Desk
from agents.operator.page_server import serving
from agents.operator.surroundings import Surroundings
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.limits import MotionLimits
from agents.robot_bridge.simulated import SimulatedPsm
from schemas.messages import (
    ChallengeEcho,
    FrameNotice,
    FrameStamp,
    ImageEncoding,
    RectifiedStereo,
    ReliabilityRegions,
    Status,
    StereoFrame,
    ThreadReconstruction,
    ToolCandidate,
    ToolCorrection,
    ToolStatus,
)
from schemas.topics import FRAME_NOTICE, FRAMES, MAIN, ROBOT_STATE, THREAD
from shared.clock import now_ns
from shared.images import encode_image
from shared.runtime.agent import Agent, Input, Output, Received, Tick
from shared.runtime.connection import connected
from tests.rigs.browser import chromium

NONE = np.zeros(0)
LENGTH_M = 0.04
PATIENT_S, HERE, STATES_HZ = 60.0, "127.0.0.1", 20.0
READY = "window.suturegrasp?.presented.length > 3 && suturegrasp.picture.thread && suturegrasp.panel.state"
QUICK = MotionLimits(
    speed=0.2,
    acceleration=2.0,
    jerk=80.0,
    angular_speed=6.0,
    angular_acceleration=60.0,
    angular_jerk=2400.0,
    jaw_speed=8.0,
    jaw_acceleration=160.0,
    jaw_jerk=6400.0,
    rounding_s=0.025,
)
"""For tests that wait for the end of a motion."""


class Stamped(Agent):
    """What stamps frames; where it `echoes`, each with the newest challenge of every arm's bridge, until it is frozen.

    One that echoes begins with the first challenge.

    Fields:
        frozen: once it is set, every frame is as old as the last one of before, by what it echoes.
    """

    inputs: tuple[Input, ...] = (Input(ROBOT_STATE, "*", only_newest_counts=True, only_remembered=True),)

    def __init__(self, echoes):
        self.echoes, self.frozen, self._newest, self._frame = echoes, threading.Event(), {}, 0

    def heard(self, arrived):
        """Whether it was a challenge, or there is none to echo yet."""
        if isinstance(arrived, Received):
            if not self.frozen.is_set():
                self._newest[arrived.message.arm] = arrived.message.challenge_ns
            return True
        assert isinstance(arrived, Tick)
        return self.echoes and not self._newest

    def next_stamp(self, at_ns):
        self._frame += 1
        echoes = tuple(ChallengeEcho(*each) for each in self._newest.items()) if self.echoes else ()
        return FrameStamp(self._frame, at_ns, at_ns, "hand", echoes)


class HandMadeThread(Stamped):
    """In the place of camera, perception and reconstruction; tells of so many frames (None: of all)."""

    kind, instance = "reconstruction", MAIN
    outputs, commands = (THREAD,), ()
    tick_hz = 20.0

    def __init__(self, most=None, echoes=False):
        super().__init__(echoes)
        self._most = most

    def step(self, arrived: Any):
        if self.heard(arrived) or self._frame == self._most:
            return []
        confidence_s = np.linspace(0, 1, 11)
        return [
            Output(
                THREAD,
                ThreadReconstruction(
                    stamp=self.next_stamp(arrived.now_ns),
                    camera=RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 0.0055, 1.0),
                    status=Status.OK,
                    reason="",
                    method="by hand",
                    degree=1,
                    knots=np.array([0.0, 0.0, 1.0, 1.0]),
                    control_points_camera=np.array([[-LENGTH_M / 2, 0, 0.08], [LENGTH_M / 2, 0, 0.08]]),
                    regions=ReliabilityRegions(NONE, np.zeros((0, 3)), np.zeros((0, 2)), NONE, NONE),
                    confidence_s=confidence_s,
                    confidence=np.where(np.abs(confidence_s - 0.5) < 0.15, 0.7, 1.0),
                ),
            )
        ]


class HandMadeCamera(Stamped):
    """Ten grey images a second, or thirty that echo challenges."""

    kind, instance = "camera", MAIN
    outputs, commands = (FRAMES, FRAME_NOTICE), ()

    def __init__(self, echoes=False):
        super().__init__(echoes)
        self.tick_hz = 30.0 if echoes else 10.0
        self._image = encode_image(np.full((540, 960, 3), 90, np.uint8), ImageEncoding.JPEG)

    def step(self, arrived: Any):
        if self.heard(arrived):
            return []
        stamp = self.next_stamp(arrived.now_ns)
        return [Output(FRAMES, StereoFrame(stamp, self._image, self._image)), Output(FRAME_NOTICE, FrameNotice(stamp))]


def corrected(status=ToolStatus.CONVERGED, off_m=0.0, measured_ns=1, outline_px=()):
    """What perception tells of psm1's tool; where it was found, so far off its registration."""
    found = status is ToolStatus.CONVERGED
    candidate = ToolCandidate(np.zeros(6), np.eye(6), np.zeros((16, 16, 16), np.uint8), 9, 0.9, 0.8, 0.5)
    return ToolCorrection(
        arm="psm1",
        stamp=FrameStamp(1, measured_ns, measured_ns, "x"),
        measured_ns=measured_ns,
        status=status,
        reason="" if found else "10% of an outline found, of 65% needed",
        T_correction=np.eye(4) if found else None,
        pivot_camera=np.zeros(3),
        tip_camera=np.zeros(3),
        tip_off_m=off_m,
        turned_rad=0.0,
        tip_deviation_m=0.0003 if found else 0.0,
        turn_deviation_rad=0.0,
        registered_left_px=np.zeros((0, 2)),
        found_left_px=np.reshape(outline_px, (-1, 2)),
        found_right_px=np.zeros((0, 2)),
        candidates=(candidate,) if found else (),
        attempts=1,
        misses=0,
        looks=1,
    )


@pytest.fixture(scope="session")
def tool_correction():
    return corrected


GUARD = (1 << 63) + 1
"""A guard's challenges have 64 bits."""


class RealPsm(SimulatedPsm):
    """An arm that says that it is real, with a guard whose number grows, and a pedal."""

    is_real, pedal = True, False

    def __init__(self):
        super().__init__()
        self.guard_challenge = GUARD

    def state(self, now_ns):
        self.guard_challenge += 1
        return replace(super().state(now_ns), guard_challenge=self.guard_challenge, pedal=self.pedal)


def real_bridge(backend, **settings):
    """The bridge of such an arm, which lacks nothing that a real arm needs to be known of."""
    known = RobotBridgeConfig(calibration_id="hand", registered_ns=now_ns(), tissue_needed=False)
    return RobotBridge(replace(known, **settings), backend)


@pytest.fixture
def limits(request):
    """Of the arm's motion; `quick` ones where a test asks for them."""
    return QUICK if getattr(request, "param", "") == "quick" else MotionLimits()


@pytest.fixture(scope="session")
def hand_made_thread():
    return HandMadeThread


@pytest.fixture(scope="session")
def hand_made_camera():
    return HandMadeCamera


@pytest.fixture
def real_arm():
    return RealPsm()


@pytest.fixture(scope="session")
def bridge_of_real_arm():
    return real_bridge


class Emulated:
    """Who tells of the states: each test has them begin."""

    def __init__(self, connection, stack):
        self._connection, self._stack = connection, stack

    def repeats(self, topic, arm, message):
        self._stack.enter_context(self._connection.repeating(topic, arm, STATES_HZ, message))

    def once(self, topic, arm, message):
        publish = self._stack.enter_context(self._connection.publishing(topic, arm))
        publish(message, message.at_ns)

    def log_of(self, kind, instance):
        """Where an agent of that name warns."""
        logger = logging.getLogger(f"emulated.{kind}.{instance}")
        self._stack.enter_context(self._connection.reporting(kind, instance, logger, lambda: ""))
        return logger


def before_a_browser(rig, look, *flags, tls=None, opened=chromium, **around):
    """Have a browser before a page, and whoever tells beside it; `opened` opens it."""

    async def run():
        with contextlib.ExitStack() as stack:
            connection, beside = (stack.enter_context(connected(rig, PATIENT_S)) for _ in range(2))
            config = simulated_rig().model_copy(update={"rig": rig.rig})
            recording = stack.enter_context(contextlib.closing(RigRecording(config, connection)))
            audit = around.pop("audit", lambda *_, **__: None)
            told = Surroundings("test", ("psm1",), audit, recording=recording, **around)
            access = Access()
            async with (
                serving(Desk(connection, told), access, HERE, 0, (HERE,), tls) as (_, address),
                opened(*(("--window-size=1280,900",) if opened is chromium else ()), *flags) as browser,
            ):
                page = await browser.open(f"{address}#token={access.link}")
                await page.until(READY, PATIENT_S)
                await look(page, Emulated(beside, stack))
                assert page.errors == []

    asyncio.run(run())


@pytest.fixture(scope="session")
def looked_at():
    """Look at a page with a real browser."""
    return before_a_browser
