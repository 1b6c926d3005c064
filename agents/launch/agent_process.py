"""One agent as a process: from configuration to a clean stop. What all agents are made of takes a second to load."""

import threading
from collections.abc import Callable

from agents.camera.image_files import ImageFileError
from agents.camera.sources import SourceError
from agents.configuration.base_file import registered_ns
from agents.configuration.hosts import run_name
from agents.configuration.rig import RigConfig
from agents.launch.builders import build
from agents.launch.host_facts import around
from agents.launch.process import EXIT_GAVE_UP, EXIT_OK, EXIT_UNUSABLE, LOGGER, log_to_console, step_back, stopping
from agents.registry import CAMERA, ROBOT_BRIDGE, Pace, with_pace
from shared.calibration import CalibrationError
from shared.calibration.made import made_ns
from shared.rendering.backdrop_files import SceneError
from shared.runtime.config import ConfigError, config_hash
from shared.runtime.connection import NoRouterError, open_when_there
from shared.runtime.facts import Surroundings, ask_for_realtime
from shared.runtime.process import keep_freed_memory
from shared.runtime.runner import Runner
from shared.runtime.session import runs_already
from shared.terminal import complain

REALTIME_PRIORITY = 50


def run_agent(rig: RigConfig, kind: str, instance: str) -> int:
    """Run one agent until it is told to stop; the exit status."""
    handler = log_to_console()
    try:
        return _run(rig, kind, instance)
    finally:
        LOGGER.removeHandler(handler)


def _run(rig: RigConfig, kind: str, instance: str) -> int:
    keep_freed_memory()
    if kind in with_pace(Pace.STEPS_BACK):
        step_back()
    try:
        agent = build(rig, kind, instance)
    except (ConfigError, SourceError, ImageFileError, CalibrationError, SceneError, OSError) as error:
        return complain(str(error), EXIT_UNUSABLE)
    stopped = stopping(for_sure=True)
    # before the session is opened, so that its threads have the priority too: the loop waits for them at times
    known = surroundings(rig, kind, instance)
    try:
        session = open_when_there(rig.session_of(run_name(kind, instance)), stopped=stopped)
    except NoRouterError as error:
        return complain(str(error), EXIT_OK if stopped.is_set() else EXIT_UNUSABLE)
    with session:
        if runs_already(session, rig.rig, kind, instance):
            return complain(f"{kind} {instance} of rig {rig.rig} runs already; stop that one first", EXIT_UNUSABLE)
        runner = Runner(agent, session, rig.rig, config_hash(rig), known, rig.rows_otherwise)
        threading.Thread(target=_stop_after, args=(stopped, runner.stop), name="stop", daemon=True).start()
        runner.run()
    return complain(runner.gave_up, EXIT_GAVE_UP) if runner.gave_up else EXIT_OK


def surroundings(rig: RigConfig, kind: str, instance: str) -> Surroundings:
    """What the agent's process knows of its host; real-time priority is asked for first where a real arm is driven,
    and where the rig wants it.
    """
    drives = kind == ROBOT_BRIDGE.name and rig.robot[instance].dvrk is not None
    asked = REALTIME_PRIORITY if drives or (kind in with_pace(Pace.KEEPS_TIME) and rig.realtime_here) else None
    refused = "" if asked is None else ask_for_realtime(asked)
    own = {"realtime_asked": asked, "realtime_refused": refused, "calibrated_ns": calibrated_ns(rig, kind, instance)}
    return around(rig, run_name(kind, instance), **own)


def calibrated_ns(rig: RigConfig, kind: str, instance: str) -> int | None:
    """When the calibration was made that an agent uses, as far as its file tells."""
    camera = rig.camera.calibration if kind == CAMERA.name and rig.camera is not None else None
    if kind == ROBOT_BRIDGE.name:
        return registered_ns(rig.robot[instance])
    return None if camera is None else made_ns((camera,))


def _stop_after(stopped: threading.Event, stop: Callable[[], None]) -> None:
    stopped.wait()
    stop()
