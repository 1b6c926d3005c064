"""The safety monitor: its size, what it lets pass and what it stops, and what it costs.

    .venv/bin/python -m benchmarks.guard [--legal 1000] [--hostile 1000000] [--seconds 20] [--only size]

- size: lines of all that the monitor's process alone uses, wherever they lie, and of those that are neither blank nor
  text; beside them those of the supervisor, the process that starts it and tells the rig of it.
- legal: motions of random plans, as a bridge sends them on a busy machine; every set point must pass.
- hostile: generated set points, judged by an oracle of its own that knows limits and speeds and nothing of the monitor.
- processor: of the real process, beside a real Zenoh, idle and while 200 set points a second pass.
"""

import ast
import contextlib
import io
import json
import math
import subprocess
import sys
import threading
import tokenize
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import psutil
import tyro
from rich.table import Table

from agents.configuration.rig import RigConfig
from agents.configuration.sections import ArmSection, DvrkSection, RouterSection
from agents.guard.description import Description
from agents.guard.monitor import BURST_S, SETTLES_NS, Kind, Monitor
from agents.launch.guard_process import description_of, document_of
from agents.robot_bridge.limits import MotionLimits, Setup
from agents.robot_bridge.motion import Trajectory, plan_motion
from agents.robot_bridge.simulated import SIMULATED_START
from benchmarks.tables import CONSOLE
from schemas.codec import encode
from schemas.messages import Heartbeat
from schemas.topics import HEARTBEAT, key
from shared.clock import monotonic_s, now_ns
from shared.kinematics.psm import LARGE_NEEDLE_DRIVER
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE
from shared.ros import crtk
from shared.ros.guarded import (
    ALIVE,
    CHALLENGE,
    SET_POINT,
    Alive,
    Gate,
    SetPoint,
    alive_bytes,
    challenge_from,
    key_of,
    set_point_bytes,
)
from shared.runtime.attachment import encoding_of
from shared.runtime.session import SessionSettings, free_local_endpoint, open_router, open_session
from tests.rigs.robot.hostile_plans import waypoints

HZ, PERIOD_NS = 200.0, 5_000_000
SECTION = DvrkSection(endpoint="tcp/127.0.0.1:1")
ROOT = Path(__file__).parents[1]
FOLDER, SUPERVISOR = ROOT / "agents" / "guard", ROOT / "agents" / "launch" / "guard_process.py"
PARTS = ("agents", "shared", "schemas")
GOAL_LINES, GOAL_IDLE, GOAL_BUSY = 600, 2.0, 10.0


@dataclass(frozen=True)
class Options:
    """What is measured."""

    legal: int = 1000
    """Motions."""
    hostile: int = 1_000_000
    """Set points."""
    seconds: float = 20.0
    """For which the process is watched, idle and at 200 set points a second."""
    only: Literal["all", "size", "legal", "hostile", "processor"] = "all"
    """One part alone."""


def main() -> None:
    """Measure and print."""
    options = tyro.cli(Options)
    parts = {
        "size": size,
        "legal": lambda: legal(options.legal),
        "hostile": lambda: hostile(options.hostile),
        "processor": lambda: processor(options.seconds),
    }
    for name, part in parts.items():
        if options.only in ("all", name):
            table = Table(title=name, title_justify="left")
            found = part()
            rows = found if isinstance(found, list) else [found]
            for column in rows[0]:
                table.add_column(column, justify="right")
            for row in rows:
                table.add_row(*(f"{value:.3g}" if isinstance(value, float) else str(value) for value in row.values()))
            CONSOLE.print(table)


def size() -> list[dict[str, Any]]:
    """Lines of the monitor's process, and of its supervisor."""
    rows = list[dict[str, Any]]()
    for what, files in (("the monitor's process", _own_files()), ("its supervisor", [SUPERVISOR])):
        lines, code = (sum(counted(path.read_text()) for path in files) for counted in (_lines, _code_lines))
        rows.append({"of": what, "files": len(files), "lines": lines, "lines of code": code, "goal": "-", "met": "-"})
    return [rows[0] | {"goal": f"{GOAL_LINES} lines", "met": rows[0]["lines"] <= GOAL_LINES}, rows[1]]


def _own_files() -> list[Path]:
    """What the monitor's process loads of this repository and nothing else does but its supervisor and tests."""
    listed = "import sys, agents.guard.__main__; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", listed], capture_output=True, text=True, check=True, cwd=ROOT).stdout
    others = set[str]()
    for path in (path for part in PARTS for path in (ROOT / part).rglob("*.py")):
        if path != SUPERVISOR and FOLDER not in path.parents:
            others |= _imported(ast.parse(path.read_text()))
    files = set(FOLDER.glob("*.py"))
    for name in loaded.split():
        path = ROOT / f"{name.replace('.', '/')}.py"
        if name not in others and path.is_file() and path.relative_to(ROOT).parts[0] in PARTS:
            files.add(path)
    return sorted(files)


def _imported(tree: ast.AST) -> set[str]:
    """Modules, and what may be some, that a file imports."""
    found = set[str]()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def _lines(text: str) -> int:
    return len(text.splitlines())


def _code_lines(text: str) -> int:
    """Lines with code: neither blank, nor comments, nor docstrings."""
    tree = ast.parse(text)
    texts = {
        line
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    nothing = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return len({t.start[0] for t in tokens if t.type not in nothing} - texts)


class Fed:
    """A monitor in virtual time with somebody who answers and an arm that is measured where it is sent."""

    def __init__(self, place: tuple[float, ...]) -> None:
        document = description_of("psm1", SECTION) | {"rate_hz": HZ}
        self.monitor = Monitor(Description.from_document(document))
        self.now_ns, self.asked, self.sequence, self.place = 10**12, 0, 0, place
        self.armings = 0
        self.arming = "a0"
        self.tick(beats=False)
        self.now_ns += SETTLES_NS

    def tick(self, elapsed_ns: int = PERIOD_NS, beats: bool = True) -> None:
        """Time passes; the arm is measured, and the newest challenge answered."""
        self.now_ns += elapsed_ns
        self.asked = self.monitor.challenge(self.now_ns).challenge
        self.monitor.hear_joints(self.place[:-1], self.now_ns)
        self.monitor.hear_jaw(self.place[-1:], self.now_ns)
        if beats:
            self.monitor.hear_heartbeat("psm1", self.arming, self.asked, True, self.now_ns)
        self.monitor.turn(self.now_ns)

    def arm_anew(self) -> None:
        """Another arming."""
        self.armings += 1
        self.arming = f"a{self.armings}"

    def say(self, positions: tuple[float, ...], **changes: Any) -> bool:
        """A set point; whether it passes."""
        self.sequence += 1
        said = replace(SetPoint(self.sequence, self.asked, self.arming, positions), **changes)
        found = self.monitor.hear_set_point(said, self.now_ns)
        return any(action.kind is Kind.PASS for action in found)


def legal(count: int, seed: int = 0) -> dict[str, Any]:
    """Motions as a bridge plans and sends them: ticks are early and late, and come in bursts after a stall."""
    rng, sent, passed, motions = np.random.default_rng(seed), 0, 0, 0
    limits = MotionLimits()
    while motions < count:
        setup = Setup(LARGE_NEEDLE_DRIVER, SIMULATED_T_CAMERA_BASE, limits, 1 / HZ)
        planned = plan_motion(waypoints(rng), np.array(SIMULATED_START), 0.0, setup)
        if not isinstance(planned, Trajectory):
            continue
        motions += 1
        fed = Fed((*SIMULATED_START, 0.0))
        fed.tick()
        stalls = 0
        for index in range(len(planned.joints)):
            # now and then the machine is late by up to 40 ms, and what was to be sent comes at once
            stalls = stalls - 1 if stalls else int(rng.integers(1, 9)) * bool(rng.random() < 0.005)
            late = 1.0 if stalls else float(np.clip(rng.normal(1.0, 0.2), 0.3, 1.7))
            fed.tick(round(late * PERIOD_NS))
            point = (*(float(joint) for joint in planned.joints[index]), float(planned.jaw_rad[index]))
            sent += 1
            passed += fed.say(point)
            # an arm that follows 20 ms behind
            behind = max(0, index - 4)
            fed.place = (*(float(joint) for joint in planned.joints[behind]), float(planned.jaw_rad[behind]))
    return {"motions": motions, "set points": sent, "stopped": sent - passed, "met": sent == passed}


class Oracle:
    """What may pass, written down once more: within limits, and no faster than each axis may go."""

    def __init__(self) -> None:
        axes = description_of("psm1", SECTION)["axes"]
        self._lower, self._upper, self._speed = (np.array([axis[k] for axis in axes]) for k in range(3))
        self._passed: list[tuple[float, np.ndarray]] = []

    def begin(self, now_s: float, place: tuple[float, ...]) -> None:
        """A motion begins where the arm is."""
        self._passed = [(now_s, np.array(place))]

    def unsafe(self, now_s: float, positions: tuple[float, ...]) -> str:
        """What is wrong with what has passed; empty where nothing is."""
        point = np.array(positions)
        if point.shape != self._lower.shape or not np.isfinite(point).all():
            return "numbers"
        if (point < self._lower - 1e-6).any() or (point > self._upper + 1e-6).any():
            return "limits"
        self._passed = [*self._passed, (now_s, point)][-40:]
        for then_s, before in self._passed[:-1]:
            if (np.abs(point - before) > self._speed * (now_s - then_s + BURST_S) * (1 + 1e-9) + 1e-9).any():
                return "speed"
        return ""


def hostile(count: int, seed: int = 0) -> dict[str, Any]:
    """Set points from good ones by what goes wrong: numbers, limits, jumps, drift, age, order, arming, presence."""
    rng, oracle = np.random.default_rng(seed), Oracle()
    axes = np.array(description_of("psm1", SECTION)["axes"])
    start = (*SIMULATED_START, 0.0)
    fed, wrong, passed, held = Fed(start), dict[str, int](), 0, 0
    fed.tick()
    oracle.begin(1e-9 * fed.now_ns, start)
    position, speed = np.array(start), axes[:, 2]
    beats, drifts = True, np.zeros(7)
    for _ in range(count):
        if fed.monitor.gate is Gate.HELD:
            held += 1
            fed.arm_anew()
            position, drifts, beats = np.array(fed.place), np.zeros(7), True
            fed.tick()
            oracle.begin(1e-9 * fed.now_ns, fed.place)
        kind = int(rng.integers(40))
        fed.tick(int(rng.integers(0, 2 * PERIOD_NS)), beats)
        point, changes = position + drifts, dict[str, Any]()
        match kind:
            case 0:
                point[rng.integers(7)] = (math.nan, math.inf, -math.inf, 1e308, -1e9)[rng.integers(5)]
            case 1:
                point = axes[:, rng.integers(2)] + rng.normal(size=7) * 0.1
            case 2:
                point = point + rng.normal(size=7) * speed * 0.1
            case 3:
                drifts = rng.normal(size=7) * speed * 0.004
            case 4:
                changes = {"sequence": int(rng.integers(0, fed.sequence + 2))}
            case 5:
                changes = {"challenge": int(rng.integers(0, 1 << 63))}
            case 6:
                changes = {"arming_id": ("", "another", fed.arming + "x")[rng.integers(3)]}
            case 7:
                point = point[: rng.integers(0, 7)]
            case 8:
                beats = not beats
            case 9:
                fed.place = tuple(float(value) for value in np.array(fed.place) + rng.normal(size=7) * 0.02)
            case _:
                point = point + rng.normal(size=7) * speed * 0.001
        said = tuple(float(value) for value in point)
        if fed.say(said, **changes):
            passed += 1
            if why := oracle.unsafe(1e-9 * fed.now_ns, said):
                wrong[why] = wrong.get(why, 0) + 1
            position = np.array(said)
            fed.place = tuple(0.5 * (a + b) for a, b in zip(fed.place, said, strict=True))
    return {
        "set points": count,
        "passed": passed,
        "motions held": held,
        "unsafe passed": sum(wrong.values()),
        "of": " ".join(f"{name} {times}" for name, times in wrong.items()) or "-",
        "met": not wrong,
    }


def processor(seconds: float) -> dict[str, Any]:
    """Percent of a core of the real monitor process, idle and while set points pass."""
    robot, rig = free_local_endpoint(), free_local_endpoint()
    section = DvrkSection(endpoint=robot)
    base = SIMULATED_T_CAMERA_BASE.tolist()
    arm = ArmSection(backend="dvrk", T_camera_base=base, dvrk=section)
    config = RigConfig(rig="lab", router=RouterSection(endpoint=rig), robot={"psm1": arm})
    document = document_of(config, "psm1", section)
    with contextlib.ExitStack() as stack:
        for endpoint in (robot, rig):
            stack.enter_context(open_router(endpoint))
        beside = stack.enter_context(open_session(SessionSettings(endpoint=robot)))
        desk = stack.enter_context(open_session(SessionSettings(endpoint=rig)))
        monitor = subprocess.Popen(
            [sys.executable, "-m", "agents.guard"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        stack.callback(monitor.kill)
        assert monitor.stdin is not None
        assert monitor.stdout is not None
        monitor.stdin.write(json.dumps(document).encode() + b"\n")
        monitor.stdin.flush()
        numpy_loaded = json.loads(monitor.stdout.readline())["modules"]
        player = _Player(beside, desk)
        watched = psutil.Process(monitor.pid)
        idle = _share(watched, seconds, player.measure)
        busy = _share(watched, seconds, player.move)
        resident = watched.memory_info().rss / 1e6
        monitor.stdin.close()
    return {
        "idle %": idle,
        "at 200 Hz %": busy,
        "passed": player.passed,
        "of": player.sent,
        "MB": resident,
        "NumPy": numpy_loaded,
        "met": idle <= GOAL_IDLE and busy <= GOAL_BUSY and player.passed > 0.95 * player.sent and not numpy_loaded,
    }


class _Player:
    """A console that is measured, a bridge that moves, and a person who answers, on real sessions."""

    def __init__(self, robot: Any, rig: Any) -> None:
        self._robot, self._rig, self._challenge = robot, rig, 0
        self.sent = self.passed = 0
        self._joints = np.array(SIMULATED_START)
        name = key_of("PSM1", CHALLENGE)
        self._kept = [
            robot.declare_subscriber(name, lambda sample: self._hear(name, sample.payload.to_bytes())),
            robot.declare_subscriber("PSM1/servo_jp", lambda _sample: self._count()),
        ]
        self._beat = key("lab", HEARTBEAT, "psm1")

    def measure(self) -> None:
        """What a console says all the time, at 100 Hz, and a bridge at rest, at 5."""
        self._tell_where()
        if now_ns() // 10_000_000 % 20 == 0:
            name = key_of("PSM1", ALIVE)
            self._robot.put(name, alive_bytes(name, Alive(1, self._challenge)))

    def move(self) -> None:
        """The same with set points at 200 Hz and 25 answers a second."""
        self._tell_where()
        if self.sent % 8 == 0:
            beat = Heartbeat("psm1", "p", now_ns(), "arming", 1, self._challenge, pressed=True)
            self._rig.put(self._beat, encode(beat), encoding=encoding_of(Heartbeat, self._beat))
        for _ in range(2):
            name, self.sent = key_of("PSM1", SET_POINT), self.sent + 1
            point = SetPoint(self.sent, self._challenge, "arming", (*self._joints.tolist(), 0.0))
            self._robot.put(name, set_point_bytes(name, point))
            threading.Event().wait(0.004)

    def _tell_where(self) -> None:
        self._robot.put("PSM1/measured_js", crtk.joint_command(self._joints, now_ns()))
        self._robot.put("PSM1/jaw/measured_js", crtk.joint_command(np.zeros(1), now_ns()))

    def _hear(self, name: str, data: bytes) -> None:
        self._challenge = challenge_from(name, data).challenge

    def _count(self) -> None:
        self.passed += 1


def _share(process: psutil.Process, seconds: float, turn: Any) -> float:
    """Percent of a core that a process takes while turns come 100 times a second."""
    warm_s = monotonic_s() + 2.0
    began: tuple[float, float] | None = None
    while True:
        now_s = monotonic_s()
        if began is None and now_s > warm_s:
            began = now_s, sum(process.cpu_times()[:2])
        if began is not None and now_s - began[0] > seconds:
            return 100 * (sum(process.cpu_times()[:2]) - began[1]) / (now_s - began[0])
        turn()
        threading.Event().wait(max(0.0, 0.01 - (monotonic_s() - now_s)))


if __name__ == "__main__":
    main()
