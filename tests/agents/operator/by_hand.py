"""A field made by hand before real agents: a straight thread 80 mm away that is known less well in its middle.

And a browser before a page that shows it.
"""

import asyncio
import contextlib
import logging
import threading
from dataclasses import replace
from typing import Any

import numpy as np

from agents.cli.page.recording import RigRecording
from agents.configuration.rig import simulated_rig
from agents.operator.desk import Desk
from agents.operator.page_server import Access, serving
from agents.operator.surroundings import Surroundings
from agents.planner.agent import Planner
from agents.planner.config import PlannerConfig
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.limits import MotionLimits
from agents.robot_bridge.simulated import SimulatedPsm
from schemas import messages
from schemas.topics import FRAME_NOTICE, FRAMES, MAIN, ROBOT_STATE, THREAD
from shared.clock import now_ns
from shared.images import encode_image
from shared.runtime.agent import Agent, Input, Output, Received, Tick
from shared.runtime.connection import connected
from tests.rigs.browser import chromium

NONE = np.zeros(0)
LENGTH_M = 0.04
CAMERA = messages.RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 0.0055, 1.0)
PATIENT_S, HERE, STATES_HZ = 60.0, "127.0.0.1", 20.0
READY = "window.suturegrasp?.presented.length > 3 && suturegrasp.picture.thread && suturegrasp.panel.state"
PLANNED = "suturegrasp.panel.state.goals.psm1?.text === '' && suturegrasp.plans.psm1?.ok && suturegrasp.plans.psm1.id"
QUICK = replace(MotionLimits().slowed(4.0), joint_share=0.8)
"""For tests that wait for the end of a motion."""


def thread_at(stamp):
    """What reconstruction would tell of the thread in a frame."""
    confidence_s = np.linspace(0, 1, 11)
    return messages.ThreadReconstruction(
        stamp=stamp,
        camera=CAMERA,
        status=messages.Status.OK,
        reason="",
        method="by hand",
        degree=1,
        knots=np.array([0.0, 0.0, 1.0, 1.0]),
        control_points_camera=np.array([[-LENGTH_M / 2, 0, 0.08], [LENGTH_M / 2, 0, 0.08]]),
        regions=messages.ReliabilityRegions(NONE, np.zeros((0, 3)), np.zeros((0, 2)), NONE, NONE),
        confidence_s=confidence_s,
        confidence=np.where(np.abs(confidence_s - 0.5) < 0.15, 0.7, 1.0),
    )


class HandMadeThread(Agent):
    """In the place of camera, perception and reconstruction; tells of so many frames (None: of all).

    Where it `echoes`, each frame has the newest challenge of every arm's bridge, and the first one waits for one.

    Fields:
        frozen: once it is set, every frame is as old as the last one of before, by what it echoes.
    """

    kind, instance = "reconstruction", MAIN
    inputs: tuple[Input, ...] = (Input(ROBOT_STATE, "*", only_newest_counts=True, only_remembered=True),)
    outputs, commands = (THREAD,), ()
    tick_hz = 20.0

    def __init__(self, most=None, echoes=False):
        self._most, self.echoes, self.frozen = most, echoes, threading.Event()
        self._newest, self._frame = {}, 0

    def step(self, arrived: Any):
        if isinstance(arrived, Received):
            if not self.frozen.is_set():
                self._newest[arrived.message.arm] = arrived.message.challenge_ns
            return []
        assert isinstance(arrived, Tick)
        if self._frame == self._most or (self.echoes and not self._newest):
            return []
        self._frame += 1
        echoes = tuple(messages.ChallengeEcho(*each) for each in self._newest.items()) if self.echoes else ()
        return self.told(messages.FrameStamp(self._frame, arrived.now_ns, arrived.now_ns, "hand", echoes))

    def told(self, stamp):
        return [Output(THREAD, thread_at(stamp))]


class HandMadeCamera(HandMadeThread):
    """Ten grey images a second, or thirty that echo challenges."""

    kind = "camera"
    outputs = (FRAMES, FRAME_NOTICE)

    def __init__(self, echoes=False):
        super().__init__(echoes=echoes)
        self.tick_hz = 30.0 if echoes else 10.0
        self._image = encode_image(np.full((540, 960, 3), 90, np.uint8), messages.ImageEncoding.JPEG)

    def told(self, stamp):
        return [
            Output(FRAMES, messages.StereoFrame(stamp, self._image, self._image)),
            Output(FRAME_NOTICE, messages.FrameNotice(stamp)),
        ]


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


def patient_bridge(arm=None, **settings):
    """The bridge of an arm, a simulated one unless given, that waits for long, and that lacks nothing."""
    waits = "dead_man_s", "first_heartbeat_s", "maximum_plan_age_s", "maximum_frame_age_s"
    told: dict[str, Any] = dict.fromkeys(waits, PATIENT_S)
    told |= {"calibration_id": "hand", "registered_ns": now_ns(), "tissue_needed": False} | settings
    return RobotBridge(RobotBridgeConfig(**told), arm or SimulatedPsm())


def patient_planner():
    """A test machine may stall."""
    return Planner(PlannerConfig(arm_age_ms=1e3 * PATIENT_S))


def followed(measured_ns=1, off_m=0.0042, outline_px=()):
    """What perception tells of psm1's tool, found so far off its registration."""
    candidate = messages.ToolCandidate(np.zeros(6), np.eye(6), np.zeros((16, 16, 16), np.uint8), 9, 0.9, 0.8, 0.5)
    stamp, nowhere = messages.FrameStamp(1, measured_ns, measured_ns, "x"), np.zeros((0, 2))
    return messages.ToolCorrection(
        "psm1",
        stamp,
        measured_ns,
        messages.ToolStatus.CONVERGED,
        reason="",
        T_correction=np.eye(4),
        pivot_camera=np.zeros(3),
        tip_camera=np.zeros(3),
        tip_off_m=off_m,
        turned_rad=0.0,
        tip_deviation_m=0.0003,
        turn_deviation_rad=0.0,
        registered_left_px=nowhere,
        found_left_px=np.reshape(outline_px, (-1, 2)),
        found_right_px=nowhere,
        candidates=(candidate,),
        attempts=1,
        misses=0,
        looks=1,
    )


class Emulated:
    """Who tells of the states: each test has them begin; `another_page` opens one beside the first."""

    def __init__(self, connection, stack, another_page):
        self._connection, self._stack, self.another_page = connection, stack, another_page

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


@contextlib.asynccontextmanager
async def desk_of(connection, tls=None, audit=lambda *_, **__: None, **around):
    """A page's server of its own, its address, and who may use it."""
    access, told = Access(), Surroundings("test", ("psm1",), audit, **around)
    async with serving(Desk(connection, told), access, HERE, 0, (HERE,), tls) as (server, address):
        yield server, address, access


def on_thread(share):
    """Where in the window a place of the thread is."""
    thread = "suturegrasp.picture.thread.px"
    return _in_window(f"{thread}[Math.round({share} * ({thread}.length - 1))]")


def at_pixel(u, v):
    """Where in the window a pixel of the left image is."""
    return _in_window(f"[{u}, {v}]")


def _in_window(pixel):
    return f"""(() => {{
      scrollTo(0, 0);
      const {{ canvas, header }} = suturegrasp.picture;
      const box = canvas.getBoundingClientRect();
      const [u, v] = {pixel};
      return [box.x + (u + 0.5) * box.width / header.width, box.y + (v + 0.5) * box.height / header.height];
    }})()"""


def before_a_browser(rig, look, *flags, opened=chromium, **around):
    """Have a browser before a page, and whoever tells beside it; `opened` opens it."""

    async def run():
        with contextlib.ExitStack() as stack:
            connection, beside = (stack.enter_context(connected(rig, PATIENT_S)) for _ in range(2))
            config = simulated_rig().model_copy(update={"rig": rig.rig})
            recording = stack.enter_context(contextlib.closing(RigRecording(config, connection)))
            size = ("--window-size=1280,900",) if opened is chromium else ()
            async with (
                desk_of(connection, recording=recording, **around) as (_, address, access),
                opened(*size, *flags) as browser,
            ):

                async def another_page():
                    page = await browser.open(f"{address}#token={access.link}")
                    await page.until(READY, PATIENT_S)
                    return page

                page = await another_page()
                await look(page, Emulated(beside, stack, another_page))
                assert page.errors == []

    asyncio.run(run())
