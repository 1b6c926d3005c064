"""A rig on four hosts and a router, with a probe on each host and an observer at the switch."""

import contextlib
import json
import sys
import threading
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agents.cli.lab.rehearsal.network import OWN, Network, connected_hosts
from agents.cli.lab.rehearsal.processes import faketime
from schemas.messages import GraspPlan, RobotMode, Status
from schemas.topics import HEALTH, PLAN, ROBOT_STATE, THREAD
from shared.clock import monotonic_s
from shared.runtime.connection import connected
from tests.command_words import words
from tests.rigs.faults.disk import Disk, small_disk
from tests.rigs.faults.observer import Observer
from tests.rigs.faults.processes import LabProcesses
from tests.rigs.faults.rig import CONFIG, HOSTS, MODULE, ROUTER, RUNS, describe, settings_at

COMPUTES = ("perception", "reconstruction")
"""What would take the processors, which here all hosts share, from what keeps time."""
STARTS_S, PLANS_S, MOVES_S = 90.0, 60.0, 20.0
LOOK_S = 0.02
WATCH_S = 0.2
AGENTS = 6
PROBED = tuple(host for host in HOSTS if host != ROUTER)
PLAN_AGAIN = "plan again"
"""How a refusal ends that speaks against the moment: its frame was too old on a busy machine."""


class NotReachedError(RuntimeError):
    """Something did not come in time; the text says what."""


@dataclass
class Lab:
    """What a trial acts on."""

    network: Network
    processes: LabProcesses
    observer: Observer
    disk: Disk
    folder: Path
    _watched_s: float = 0.0

    def start(self, name: str) -> None:
        """Start one of the rig's processes on its host, for the first time or again."""
        host = next(host for host, names in RUNS.items() if name in names)
        options = ("--output", str(self.recording), "--numbered") if name == "record" else ()
        self.processes.start(host, name, *MODULE, *words(name), "--config", str(self.config(host)), *options)

    def start_probe(self, host: str) -> None:
        """Start the one who says and hears events there."""
        told = str(self.config(host)), str(self.folder / f"probe-{host}.json")
        self.processes.start(host, f"probe-{host}", sys.executable, "-m", "tests.rigs.faults.probe", *told)

    def config(self, host: str) -> Path:
        """A host's copy of the rig's configuration."""
        return self.folder / host / CONFIG

    @property
    def recording(self) -> Path:
        """Where the recorder writes: a disk of its own."""
        return self.disk.folder / "session.mcap"

    def wait(self, condition: Callable[[], Any], what: str, limit_s: float) -> Any:
        """Wait until something holds, noting meanwhile what people are told; its value.

        Raises:
            NotReachedError: where it does not hold in time.
        """
        end_s, turn = monotonic_s() + limit_s, threading.Event()
        while not (value := condition()):
            if monotonic_s() > end_s:
                ended = "; ".join(self.processes.all_ended())
                raise NotReachedError(f"waited {limit_s:.0f} s for {what}{'; ' if ended else ''}{ended}")
            if monotonic_s() > self._watched_s + WATCH_S:
                self.observer.look()
                self._watched_s = monotonic_s()
            turn.wait(LOOK_S)
        return value

    def let_pass(self, seconds: float) -> None:
        """Go on watching for so long."""
        end_s = monotonic_s() + seconds
        self.wait(lambda: monotonic_s() >= end_s, "", seconds + STARTS_S)

    def until_well(self) -> None:
        """Wait until every agent has reported, and a thread has come."""
        begin_s = monotonic_s()

        def well() -> bool:
            if ended := self.processes.all_ended():
                raise NotReachedError("; ".join(ended))
            names = {heard.message.agent for heard in self.observer.messages(HEALTH, begin_s)}
            threads = (h for h in self.observer.messages(THREAD, begin_s) if h.message.status is Status.OK)
            return len(names) >= AGENTS and any(threads)

        self.wait(well, "every agent's health and a thread", STARTS_S)

    def plan(self) -> GraspPlan:
        """A plan that can be armed, as long as it takes to get one."""
        asked, begin_s = set[str | None](), monotonic_s()

        def planned() -> GraspPlan | None:
            plans = [heard.message for heard in self.observer.messages(PLAN, begin_s)]
            asked.add(self.observer.ask())
            return next((plan for plan in plans if plan.status is Status.OK and plan.goal_id in asked), None)

        return self.wait(planned, "a plan", PLANS_S)

    def grasp_under_way(self) -> str:
        """The id of a plan that an operator at the desk has armed, once the arm moves."""
        end_s = monotonic_s() + PLANS_S
        while True:
            plan_id, begin_s = self.plan().plan_id, monotonic_s()
            self.processes.start("desk", "arm", *MODULE, "arm", plan_id, "--config", str(self.config("desk")))

            def moving(of: str = plan_id, since_s: float = begin_s) -> bool:
                states = self.observer.messages(ROBOT_STATE, since_s)
                return any((s.message.plan_id, s.message.mode) == (of, RobotMode.MOVING) for s in states)

            self.wait(lambda: moving() or self.processes.ended("arm"), "the arm to move", MOVES_S)
            said = self.processes.ended("arm")
            if not said:
                return plan_id
            if PLAN_AGAIN not in said or monotonic_s() > end_s:
                raise NotReachedError(f"no grasp came under way: {said}")

    def probes_hear_each_other(self) -> bool:
        """Whether all are there: what came before somebody joined is the matter of no fault."""
        told = self.probes()
        return len(told) == len(PROBED) and all(len(one["heard"]) == len(told) for one in told.values())

    def probes(self) -> dict[str, Any]:
        """What each probe has said and heard, as it last wrote it."""
        files = {host: self.folder / f"probe-{host}.json" for host in PROBED}
        return {host: json.loads(path.read_text()) for host, path in files.items() if path.exists()}


@contextlib.contextmanager
def laboratory(folder: Path, rate_hz: float = 3.0, clocks: bool = False, emulated: bool = False) -> Generator[Lab]:
    """A lab whose rig runs and has seen a thread; `clocks`: whose hosts' clocks can be set; `emulated` as `describe`.

    Raises:
        CannotError: where this system cannot play it.
    """
    if clocks:
        faketime()
    with contextlib.ExitStack() as stack:
        network = stack.enter_context(connected_hosts(HOSTS))
        processes = stack.enter_context(
            contextlib.closing(LabProcesses(network, folder, HOSTS if clocks else (), COMPUTES))
        )
        describe(network, rate_hz, folder, emulated)
        # one who hears all from the beginning
        processes.start(ROUTER, ROUTER, *MODULE, ROUTER, "--config", str(folder / ROUTER / CONFIG))
        connection = stack.enter_context(connected(settings_at(folder / OWN / CONFIG), within_s=STARTS_S))
        disk = stack.enter_context(small_disk(folder / "disk"))
        observer = stack.enter_context(contextlib.closing(Observer(connection)))
        lab = Lab(network, processes, observer, disk, folder)
        for name in (name for host in PROBED for name in RUNS[host]):
            lab.start(name)
        lab.until_well()
        for host in PROBED:
            lab.start_probe(host)
        lab.wait(lab.probes_hear_each_other, "the probes to hear each other", STARTS_S)
        yield lab
