"""A field made by hand: a straight thread 80 mm away that is known less well in its middle, and its images."""

import asyncio
import contextlib
import logging

import numpy as np
import pytest

from agents.cli.page.recording import RigRecording
from agents.cli.rig.config import simulated_rig
from agents.operator.access import Access
from agents.operator.desk import Desk
from agents.operator.page_server import serving
from agents.operator.surroundings import Surroundings
from agents.robot_bridge.limits import MotionLimits
from benchmarks.browser import chromium
from schemas.messages import (
    FrameStamp,
    ImageEncoding,
    RectifiedStereo,
    ReliabilityRegions,
    Status,
    StereoFrame,
    ThreadReconstruction,
)
from schemas.topics import FRAMES, MAIN, THREAD
from shared.images import encode_image
from shared.runtime.agent import Output, Tick
from shared.runtime.connection import connected

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


class HandMadeThread:
    """In the place of camera, perception and reconstruction; tells of so many frames (None: of all)."""

    kind, instance = "reconstruction", MAIN
    inputs, outputs, commands = (), (THREAD,), ()
    tick_hz = 20.0

    def __init__(self, most=None):
        self._frame, self._most = 0, most

    def step(self, arrived):
        assert isinstance(arrived, Tick)
        if self._frame == self._most:
            return []
        self._frame += 1
        confidence_s = np.linspace(0, 1, 11)
        return [
            Output(
                THREAD,
                ThreadReconstruction(
                    stamp=FrameStamp(self._frame, arrived.now_ns, arrived.now_ns, "hand"),
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


class HandMadeCamera:
    """Ten grey images a second."""

    kind, instance = "camera", MAIN
    inputs, outputs, commands = (), (FRAMES,), ()
    tick_hz = 10.0

    def __init__(self):
        self._frame, self._image = 0, encode_image(np.full((540, 960, 3), 90, np.uint8), ImageEncoding.JPEG)

    def step(self, arrived):
        assert isinstance(arrived, Tick)
        self._frame += 1
        stamp = FrameStamp(self._frame, arrived.now_ns, arrived.now_ns, "hand")
        return [Output(FRAMES, StereoFrame(stamp, self._image, self._image))]


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


def before_a_browser(rig, look, *flags, tls=None, **around):
    """Have a browser before a page, and whoever tells beside it."""

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
                chromium("--window-size=1280,900", *flags) as browser,
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
