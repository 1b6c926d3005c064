"""An emulated robot as a process."""

import contextlib
import json
import threading
from pathlib import Path
from typing import Any

import numpy as np

from agents.cli.lab.options import Emulate
from agents.dvrk_emulator.arm import start_of
from agents.dvrk_emulator.asked import answering
from agents.dvrk_emulator.console import Behaviour, EmulatedConsole
from agents.dvrk_emulator.geometry import JAW_LIMITS
from agents.dvrk_emulator.oracle import Field, Oracle
from agents.dvrk_emulator.wire import BridgeWire, RmwWire
from agents.launch.process import EXIT_OK, stopping
from shared.clock import monotonic_s
from shared.runtime.connection import NoRouterError, open_when_there
from shared.runtime.session import Session, SessionSettings, open_from, open_router
from shared.terminal import UsageError, say

EXIT_UNSAFE = 1
OWN_ENDPOINT = "tcp/127.0.0.1:7448"
"""Beside a rig's router, which listens on 7447."""
HEARTBEATS = "suturegrasp/*/operator/{arm}/heartbeat"
SENT_S = 0.2


def run(options: Emulate) -> int:
    """Emulate until stopped; the exit status."""
    stopped = stopping()
    oracles = {
        arm: Oracle(_field(options.camera, arm), hears_heartbeats=options.heartbeats is not None)
        for arm in options.arm.split(",")
    }
    try:
        with contextlib.ExitStack() as stack:
            session = stack.enter_context(_session(options, stopped))
            if options.tell is not None:
                for arm in oracles:
                    session.put(f"emulator/{arm}/request", options.tell)
                stopped.wait(SENT_S)
                return EXIT_OK
            if options.heartbeats is not None:
                rig = stack.enter_context(
                    open_when_there(SessionSettings(endpoint=options.heartbeats), stopped=stopped)
                )
                for arm, oracle in oracles.items():
                    # of one arm the rig may call it otherwise
                    stands_by = HEARTBEATS.replace("{arm}", arm.lower() if len(oracles) > 1 else "*")
                    rig.declare_subscriber(stands_by, lambda _, oracle=oracle: oracle.heartbeat(monotonic_s()))
            return _run(options, session, oracles, stopped)
    except NoRouterError:
        if stopped.is_set():
            return EXIT_OK
        raise


def _run(options: Emulate, session: Session, oracles: dict[str, Oracle], stopped: threading.Event) -> int:
    with contextlib.ExitStack() as stack:
        consoles, running = list[EmulatedConsole](), list[threading.Thread]()
        for arm, oracle in oracles.items():
            wire = BridgeWire(session) if options.codec == "ros2dds" else RmwWire(session, options.domain)
            stop_rad = JAW_LIMITS[0] if options.jaw_closes is None else options.jaw_closes
            behaviour = Behaviour(options.ready, 1e-3 * options.lag_ms, start_of(arm), options.foot, stop_rad)
            console = stack.enter_context(contextlib.closing(EmulatedConsole(wire, arm, oracle, behaviour)))
            stack.enter_context(answering(session, console))
            consoles.append(console)
            running.append(threading.Thread(target=console.run, args=(stopped,), name=arm))
            running[-1].start()
        where = f"as {options.zenoh} says" if options.zenoh else f"listening on {options.listen or OWN_ENDPOINT}"
        how = f"at {options.connect}" if options.connect else where
        say(f"an emulated dVRK has {options.arm}, {options.codec}, {how}; stop with Ctrl-C")
        stopped.wait()
        for thread in running:
            thread.join()
        verdicts = [console.verdict() for console in consoles]
    return _tell(verdicts[0] if len(verdicts) == 1 else _together(verdicts), options.verdict)


def _together(verdicts: list[dict[str, Any]]) -> dict[str, Any]:
    """What is told of several arms: counts together, and the rest of each."""
    return {
        "set_points": sum(verdict["set_points"] for verdict in verdicts),
        "unsafe": sum(verdict["unsafe"] for verdict in verdicts),
        "sentences": [sentence for verdict in verdicts for sentence in verdict["sentences"]],
        "arms": verdicts,
    }


def _tell(verdict: dict[str, Any], path: Path | None) -> int:
    if path is not None:
        path.write_text(json.dumps(verdict) + "\n")
    for sentence in verdict["sentences"]:
        say(f"unsafe: {sentence}")
    say(f"{verdict['set_points']} set points, {verdict['unsafe']} unsafe")
    return EXIT_UNSAFE if verdict["unsafe"] else EXIT_OK


def _session(options: Emulate, stopped: threading.Event) -> Session:
    if options.zenoh is not None and options.tell is None:
        return open_from(options.zenoh)
    if options.connect is None and options.tell is None:
        return open_router(options.listen or OWN_ENDPOINT)
    return open_when_there(SessionSettings(endpoint=options.connect or options.listen or OWN_ENDPOINT), stopped=stopped)


def _field(path: Path | None, arm: str) -> Field | None:
    """Where an arm stands before the camera, by a file of its own or one with an entry for each arm.

    Raises:
        UsageError: where the file does not say.
    """
    if path is None:
        return None
    try:
        told = json.loads(path.read_text())
        T = np.array(told.get(arm, told)["T_camera_base"], np.float64)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise UsageError(f"{path} is no JSON with T_camera_base: {error}") from None
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise UsageError(f"T_camera_base of {path} is not 4x4 and finite")
    return Field(T)
