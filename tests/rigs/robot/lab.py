"""Robot bridge, guard, a person who presses, and an emulated console as processes, and whatever else is to run."""

import contextlib
import datetime
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np

from agents.cli.lab.rehearsal.processes import faked
from agents.launch.supervisor import SUPERVISED
from schemas.codec import decode, encode
from schemas.messages import ChallengeEcho, FrameStamp, GraspPlan, Phase, Policy, Status, TissueSurface, Waypoint
from schemas.topics import PLAN, SURFACE, key
from shared.clock import monotonic_s, now_ns
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.rigid_transforms import exp_so3, transform
from shared.runtime.attachment import Attachment, pack
from shared.runtime.delivery import declare_publisher
from shared.runtime.session import SessionSettings, free_local_endpoint, open_session
from shared.runtime.taps import Tapped, tap
from tests.rigs.faults.processes import at_once
from tests.rigs.robot.person import CALIBRATION

RUNS_FOR_S, STANDS_S = 1.0, 1.0
"""How long the arm moves before the loss, and how long it must not move to be said to stand."""
MOVES_NS = 50_000_000
"""An arm that got a set point so recently moves."""
DEADLINE_S, LOOK_S = 60.0, 0.05
RIG, ARM, CONSOLE = "bench", "psm1", "PSM1"
TURNS = 6
PERSON, PATIENT_S = "tests.rigs.robot.person", 8.0


class NotMovingError(RuntimeError):
    """The arm did not get going; the text says what the processes said."""


class Lab:
    """The processes, and who publishes plans and asks the console."""

    def __init__(
        self,
        folder: Path,
        dvrk: dict[str, Any],
        stack: contextlib.ExitStack,
        turns: int = TURNS,
        beside: dict[str, Any] | None = None,
        queue: tuple[str, str, float] = ("", "constant", 0.0),
    ) -> None:
        """Start everything; `turns` of the motion to and fro, and sections of further agents `beside`.

        Without such, the bridge reaches the console through a relay, and the person the rig. `queue` says which of both
        relays, `robot` or `rig`, is to turn bad, how and for how long (relay.py), or whose clock is to be set.
        """
        self._folder, self._turns, self._sections, self._clock = folder, turns, beside or {}, queue[0]
        self.endpoint, self._robot, relayed, self._desk = (free_local_endpoint() for _ in range(4))
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        base = {"T_camera_base": SIMULATED_T_CAMERA_BASE.tolist()}
        told = {"T_camera_base_calibration": CALIBRATION, "T_camera_base_made": today()}
        (folder / "base.json").write_text(json.dumps(base))
        untold = {"dry_run": False, "has_no": ["teleoperation", "endoscope_arm", "clutch", "tissue"]}
        for name, endpoint in (("rig", relayed if beside is None else self._robot), ("guard", self._robot)):
            emulated = {"endpoint": endpoint, "emulated_at": endpoint}
            arm = base | told | {"backend": "dvrk", "dvrk": dvrk | untold | emulated}
            rig = {"rig": RIG, "router": {"endpoint": self.endpoint}, "robot": {ARM: arm}, **self._sections}
            (folder / f"{name}.json").write_text(json.dumps(rig))
        rig, camera = ("--config", folder / "rig.json"), ("--camera", folder / "base.json")
        self._start("router", "agents.cli", "router", *rig)
        console = ("emulate", "dvrk", "--ready", "--codec", dvrk["codec"], "--listen", self._robot)
        self._start("console", "agents.cli", *console, *camera, "--heartbeats", self.endpoint)
        for name, ends in (("robot", (relayed, self._robot)), ("rig", (self._desk, self.endpoint))):
            mode = queue[1:] if queue[0] == name else ("constant", 0.0)
            ports = (endpoint.rsplit(":", 1)[1] for endpoint in ends)
            self._start(f"link of the {name}", "tests.rigs.robot.relay", *ports, *mode)
        self._start("bridge", "agents.cli", "run", "robot-bridge", *rig)
        if beside is None:
            self._start("camera", PERSON, "watch", RIG, self.endpoint, ARM)
        for kind in self._sections:
            self._start(kind, "agents.cli", "run", kind, *rig)
        self._start("guard", "agents.cli", "guard", "--config", folder / "guard.json")
        self._beside = stack.enter_context(open_session(SessionSettings(endpoint=self._robot)))
        session = stack.enter_context(open_session(SessionSettings(RIG, self.endpoint)))
        self._plans, self._told = declare_publisher(session, key(RIG, PLAN), PLAN), 0
        self._frame = CALIBRATION
        self._heard = tap(session, RIG, (SURFACE,), self._see, lambda _topic, _count: None)

    def move(self) -> None:
        """Arm a plan and wait until the arm has moved for a while; it is armed again where it was held."""
        deadline_s = monotonic_s() + DEADLINE_S
        while monotonic_s() < deadline_s:
            self.press()
            count, started_s = self.verdict()["set_points"], monotonic_s()
            while not self._refused() and monotonic_s() - started_s < PATIENT_S:
                threading.Event().wait(LOOK_S)
                now = self.verdict()
                if count and now["set_points"] > count + 2 * 200 * RUNS_FOR_S:
                    if now_ns() - now["set_point_ns"] < MOVES_NS:
                        return
                    break
                count = count or now["set_points"]
        raise NotMovingError("\n".join(path.read_text() for path in sorted(self._folder.glob("*.log"))))

    def press(self) -> str:
        """Have a person press for a fresh plan, whose id it is; whoever pressed before is gone."""
        self._told += 1
        plan_id = f"plan-{self._told}"
        plan = to_and_fro(plan_id, self._turns, self._frame)
        self._plans.put(encode(plan), attachment=pack(Attachment(1, self._told, now_ns(), 0.0)))
        if (ended := self._running.pop("operator", None)) is not None:
            self._end(ended)
        (self._folder / "operator.log").unlink(missing_ok=True)
        self._start("operator", PERSON, "press", RIG, self._desk, ARM, plan_id)
        return plan_id

    def answer(self) -> str:
        """What the bridge answers when the plan is armed once more, over links as they are now; nothing moves on."""
        self.press()
        deadline_s = monotonic_s() + PATIENT_S
        while not self.said("operator") and monotonic_s() < deadline_s:
            threading.Event().wait(LOOK_S)
        said = self.said("operator") or [{"outcome": "no answer"}]
        self._end(self._running.pop("operator"))
        return said[0].get("code") or str(said[0]["outcome"]).lower()

    def operated(self) -> bool:
        """Whether somebody stands by the motion still."""
        return self._running["operator"].poll() is None and not self._refused()

    def said(self, name: str) -> list[dict[str, Any]]:
        """The lines of JSON that a process has said."""
        log = self._folder / f"{name}.log"
        lines = log.read_text().splitlines() if log.exists() else []
        return [json.loads(line) for line in lines if line.startswith("{")]

    def _refused(self) -> bool:
        return any(line.get("outcome") not in (None, "ACCEPTED") for line in self.said("operator"))

    def signal(self, name: str) -> None:
        """Have the person let go, the camera freeze, or a link begin to queue."""
        self._running[name].send_signal(signal.SIGUSR1)

    def set_clock(self, name: str, ahead_s: float) -> None:
        """Set the clock of one process, of which that was to be possible."""
        fresh = self._folder / f"{name}.clock.new"
        fresh.write_text(f"{ahead_s:+g}s\n")
        fresh.rename(self._folder / f"{name}.clock")

    def pid(self, name: str) -> int:
        return self._running[name].pid

    def waited_ms(self) -> dict[tuple[str, str], float]:
        """How long each thread of each process has been ready and had no processor, since it began."""
        found = dict[tuple[str, str], float]()
        for name, process in self._running.items():
            # what has ended, or was killed, waits for nothing
            with contextlib.suppress(OSError):
                for thread in Path(f"/proc/{process.pid}/task").iterdir():
                    found[name, thread.name] = 1e-6 * int((thread / "schedstat").read_text().split()[1])
        return found

    def lose(self, what: str) -> None:
        """Kill a process, or stop the relay so that nothing passes and nothing is closed."""
        if what.startswith("link"):
            self._running["link of the robot"].send_signal(signal.SIGSTOP)
        elif what in ("operator", "camera"):
            self.signal(what)
        else:
            self._running[what].kill()

    def mend(self) -> None:
        """Let the relay pass on what it was sent, late as it is."""
        self._running["link of the robot"].send_signal(signal.SIGCONT)

    def still(self, lost_ns: int) -> dict[str, Any]:
        """What the console says once the arm has not moved for a while."""
        deadline_s = monotonic_s() + DEADLINE_S
        while monotonic_s() < deadline_s:
            verdict = self.verdict()
            if now_ns() - max(lost_ns, verdict["moved_ns"]) > STANDS_S * 1e9:
                return verdict
            threading.Event().wait(LOOK_S)
        raise NotMovingError("the arm did not come to rest")

    def verdict(self) -> dict[str, Any]:
        """What the console says now."""
        for reply in self._beside.get(f"emulator/{CONSOLE}/verdict", timeout=5.0):
            if reply.ok is not None:
                return json.loads(reply.ok.payload.to_string())
        return {"set_points": 0, "moved_ns": 0, "held_ns": 0}

    def close(self) -> None:
        for process in self._running.values():
            self._end(process)

    def _see(self, tapped: Tapped) -> None:
        # a plan in another camera's frame than the tissue is refused
        self._frame = decode(TissueSurface, tapped.payload).stamp.calibration_id

    def _start(self, name: str, module: str, *arguments: object) -> None:
        command = [sys.executable, "-m", module, *map(str, arguments)]
        with (self._folder / f"{name}.log").open("ab") as log:
            environment = {**os.environ, SUPERVISED: "1"}
            if f"clock of the {name}" == self._clock:
                self.set_clock(name, 0.0)
                environment |= at_once(faked(self._folder / f"{name}.clock"))
            self._running[name] = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=log, stderr=log, env=environment
            )

    def _end(self, process: "subprocess.Popen[bytes]") -> None:
        process.kill()
        process.wait()
        if process.stdin is not None:
            process.stdin.close()


def to_and_fro(plan_id: str, turns: int, calibration_id: str) -> GraspPlan:
    """A plan that takes long: to the field and to and fro in it."""
    at_ns = now_ns()
    stamp = FrameStamp(1, at_ns, at_ns, calibration_id, (ChallengeEcho(ARM, at_ns),))
    places = [(20, 5, 75), *((x, 6, 75) for x in (-15, 20) * turns)]
    poses = [transform(exp_so3(np.array((0.1, 0.0, 0.3))), np.array(place) / 1e3) for place in places]
    waypoints = tuple(Waypoint(T, 0.5, Phase.APPROACH, None) for T in poses)
    rest: dict[str, Any] = {"status": Status.OK, "reason": "", "policy": Policy.DIRECT, "s_goal": 0.5, "s_capture": 0.5}
    rest |= {"probability": 0.9, "slide_m": 0.0, "alternatives": ()}
    return GraspPlan(plan_id=plan_id, arm=ARM, goal_id="g", stamp=stamp, waypoints=waypoints, **rest)


def today() -> str:
    """As a rig's file writes it."""
    return datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC).date().isoformat()
