"""Robot bridge, guard, operator and emulated console as processes, and whatever else is to run beside them."""

import contextlib
import json
import os
import selectors
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from agents.cli.running.supervisor import SUPERVISED
from schemas.codec import decode, encode
from schemas.messages import FrameStamp, GraspPlan, Phase, Policy, Status, TissueSurface, Waypoint
from schemas.topics import PLAN, SURFACE, key
from shared.clock import monotonic_s, now_ns
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.rigid_transforms import exp_so3, transform
from shared.runtime.attachment import Attachment, pack
from shared.runtime.delivery import declare_publisher
from shared.runtime.session import SessionSettings, free_local_endpoint, open_session
from shared.runtime.taps import Tapped, tap

RUNS_FOR_S, STANDS_S = 1.0, 1.0
"""How long the arm moves before the loss, and how long it must not move to be said to stand."""
MOVES_NS = 50_000_000
"""An arm that got a set point so recently moves."""
DEADLINE_S, LOOK_S = 60.0, 0.05
RIG, ARM, CONSOLE = "bench", "psm1", "PSM1"
TURNS = 6


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
    ) -> None:
        """Start everything; `turns` of the motion to and fro, and sections of further agents with what they hold.

        Where there are further agents the bridge reaches the console at once, and else through a relay.
        """
        self._folder, self._turns, self._sections = folder, turns, beside or {}
        self._router, self._robot, relayed = (free_local_endpoint() for _ in range(3))
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        base = {"T_camera_base": SIMULATED_T_CAMERA_BASE.tolist()}
        (folder / "base.json").write_text(json.dumps(base))
        self._config("rig.json", base, dvrk | {"endpoint": relayed if beside is None else self._robot})
        self._config("guard.json", base, dvrk | {"endpoint": self._robot})
        rig, camera = ("--config", folder / "rig.json"), ("--camera", folder / "base.json")
        self._start("router", "agents.cli", "router", *rig)
        console = ("emulate", "dvrk", "--ready", "--codec", dvrk["codec"], "--listen", self._robot)
        self._start("console", "agents.cli", *console, *camera, "--heartbeats", self._router)
        self._start("relay", __name__, *(endpoint.rsplit(":", 1)[1] for endpoint in (relayed, self._robot)))
        self._start("bridge", "agents.cli", "robot-bridge", *rig)
        for kind in self._sections:
            self._start(kind, "agents.cli", kind, *rig)
        self._start("guard", "agents.cli", "guard", "--config", folder / "guard.json")
        self._beside = stack.enter_context(open_session(SessionSettings(endpoint=self._robot)))
        session = stack.enter_context(open_session(SessionSettings(RIG, self._router)))
        self._plans, self._told = declare_publisher(session, key(RIG, PLAN), PLAN), 0
        self._frame = "bench"
        self._heard = tap(session, RIG, (SURFACE,), self._see, lambda _topic, _count: None)

    def move(self) -> None:
        """Arm a plan and wait until the arm has moved for a while; it is armed again where it was held."""
        deadline_s = monotonic_s() + DEADLINE_S
        while monotonic_s() < deadline_s:
            self._tell_plan()
            if (ended := self._running.pop("operator", None)) is not None:
                self._end(ended)
            self._start("operator", "agents.cli", "arm", f"plan-{self._told}", "--config", self._folder / "rig.json")
            count, started_s = self.verdict()["set_points"], monotonic_s()
            while self._running["operator"].poll() is None and monotonic_s() - started_s < DEADLINE_S:
                threading.Event().wait(LOOK_S)
                now = self.verdict()
                if count and now["set_points"] > count + 2 * 200 * RUNS_FOR_S:
                    if now_ns() - now["set_point_ns"] < MOVES_NS:
                        return
                    break
                count = count or now["set_points"]
        raise NotMovingError("\n".join(path.read_text() for path in sorted(self._folder.glob("*.log"))))

    def operated(self) -> bool:
        """Whether somebody stands by the motion still."""
        return self._running["operator"].poll() is None

    def pid(self, name: str) -> int:
        """The process of that name."""
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
            self._running["relay"].send_signal(signal.SIGSTOP)
        else:
            self._running[what].kill()

    def mend(self) -> None:
        """Let the relay pass on what it was sent, late as it is."""
        self._running["relay"].send_signal(signal.SIGCONT)

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

    def _tell_plan(self) -> None:
        self._told += 1
        beside = pack(Attachment(1, self._told, now_ns(), 0.0))
        self._plans.put(encode(to_and_fro(f"plan-{self._told}", self._turns, self._frame)), attachment=beside)

    def _config(self, name: str, base: dict[str, Any], dvrk: dict[str, Any]) -> None:
        arm = base | {"backend": "dvrk", "dvrk": dvrk | {"dry_run": False}}
        rig = {"rig": RIG, "router": {"endpoint": self._router}, "robot": {ARM: arm}, **self._sections}
        (self._folder / name).write_text(json.dumps(rig))

    def _start(self, name: str, module: str, *arguments: object) -> None:
        command = [sys.executable, "-m", module, *map(str, arguments)]
        with (self._folder / f"{name}.log").open("ab") as log:
            environment = {**os.environ, SUPERVISED: "1"}
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
    stamp = FrameStamp(1, now_ns(), now_ns(), calibration_id)
    places = [(20, 5, 75), *((x, 6, 75) for x in (-15, 20) * turns)]
    poses = [transform(exp_so3(np.array((0.1, 0.0, 0.3))), np.array(place) / 1e3) for place in places]
    waypoints = tuple(Waypoint(T, 0.5, Phase.APPROACH, None) for T in poses)
    rest: dict[str, Any] = {"status": Status.OK, "reason": "", "policy": Policy.DIRECT, "s_goal": 0.5, "s_capture": 0.5}
    rest |= {"probability": 0.9, "slide_m": 0.0, "alternatives": ()}
    return GraspPlan(plan_id=plan_id, arm=ARM, goal_id="g", stamp=stamp, waypoints=waypoints, **rest)


def relay(listen: int, target: int) -> None:
    """Pass bytes between the two ports until killed."""
    with socket.create_server(("127.0.0.1", listen)) as server, selectors.DefaultSelector() as ready:
        ready.register(server, selectors.EVENT_READ, lambda: _accept(server, target, ready))
        while True:
            for found, _ in ready.select():
                found.data()


def _accept(server: socket.socket, target: int, ready: selectors.BaseSelector) -> None:
    ours, _ = server.accept()
    theirs = socket.create_connection(("127.0.0.1", target))
    for one, other in ((ours, theirs), (theirs, ours)):
        one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        ready.register(one, selectors.EVENT_READ, _passing(one, other, ready))


def _passing(one: socket.socket, other: socket.socket, ready: selectors.BaseSelector) -> Callable[[], None]:
    def go_on() -> None:
        with contextlib.suppress(OSError):
            if data := one.recv(1 << 16):
                other.sendall(data)
                return
        for end in (one, other):
            with contextlib.suppress(KeyError, ValueError):
                ready.unregister(end)
            end.close()

    return go_on


if __name__ == "__main__":
    relay(int(sys.argv[1]), int(sys.argv[2]))
