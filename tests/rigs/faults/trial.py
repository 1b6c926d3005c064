"""One fault in the middle of a grasp, and what followed, as it was seen from beside."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field

from schemas.messages import CommandAnswer, ExecutionKind, Outcome, Status
from schemas.topics import EXECUTION, HEALTH, LOG, PLAN, ROBOT_STATE, THREAD, Topic
from shared.clock import monotonic_s, now_ns
from tests.rigs.faults.faults import Fault
from tests.rigs.faults.lab import ASK_S, Lab, NotReachedError
from tests.rigs.faults.observer import Heard
from tests.rigs.faults.probe import RATE_HZ
from tests.rigs.faults.rig import BRIDGE, KINDS, ROUTER

FRESH_NS = {THREAD: 1_000_000_000, ROBOT_STATE: 100_000_000}
"""How old what flows may be to count as flowing again."""
READY_S, RECOVERS_S, SETTLES_S, NAMED_S, GRASP_S = 30.0, 30.0, 15.0, 4.0, 15.0
HELD_S = 1.0


@dataclass
class Seen:
    """What a fault did.

    Fields:
        begin_s: when it began, by a clock that nobody sets.
        held_ms: from its beginning until the arm held; None where it did not.
        ended: how the grasp ended: `finished`, or the code of the reason for which the arm held.
        startup_s: from its start until what was started again was ready; None where nothing was.
        recovery_s: from the fault's end, or from then, until each flow was there again; None where it never was.
        lost: events by key that did not arrive everywhere.
        said: everything that people were told, with seconds since the fault began.
        name: the first of it that names the fault.
    """

    fault: str
    begin_s: float = 0.0
    held_ms: float | None = None
    ended: str = ""
    startup_s: float | None = None
    recovery_s: dict[str, float | None] = field(default_factory=dict[str, float | None])
    lost: dict[str, int] = field(default_factory=dict[str, int])
    said: list[tuple[float, str]] = field(default_factory=list[tuple[float, str]])
    name: str = ""


@dataclass
class _Goals:
    """Goals that are named again and again, as by somebody who will not wait, and what was answered."""

    lab: Lab
    said: list[tuple[float, str]] = field(default_factory=list[tuple[float, str]])
    _next_s: float = 0.0

    def ask(self) -> None:
        if monotonic_s() >= self._next_s:
            self._next_s = monotonic_s() + ASK_S
            self.lab.observer.ask(self._take)

    def _take(self, answer: CommandAnswer) -> None:
        if answer.outcome is not Outcome.ACCEPTED:
            self.said.append((monotonic_s(), f"goal: {answer.reason}"))


def trial(lab: Lab, fault: Fault) -> Seen:
    """Carry out a grasp, let the fault happen in its middle, and look at what follows."""
    seen, goals = Seen(fault.name), _Goals(lab)
    plan_id = lab.grasp_under_way()
    lost_before, given_up_before = _lost(lab), _given_up(lab)
    lab.let_pass(0.3)
    begin_s, begin_ns = monotonic_s(), now_ns()
    seen.begin_s = begin_s
    with fault.during(lab):
        end_s = begin_s + fault.lasts_s
        lab.wait(lambda: goals.ask() or monotonic_s() >= end_s, "", fault.lasts_s + READY_S)
        ended_s, ended_ns = monotonic_s(), now_ns()
    seen.startup_s, ready_s = _restarted(lab, fault, ended_s)
    shift_ns = round((ready_s - ended_s) * 1e9)
    seen.recovery_s = _recovered(lab, fault, goals, ready_s, ended_ns + shift_ns)
    lab.let_pass(max(0.0, begin_s + NAMED_S - monotonic_s()))
    seen.lost = _lost_meanwhile(lab, lost_before)
    seen.held_ms, seen.ended = _awaited_end(lab, fault, plan_id, begin_s, begin_ns)
    held = [(h.at_s, f"{h.message.arm}: {h.message.reason}") for h in _events(lab, plan_id) if h.message.reason]
    given_up = [
        (monotonic_s(), f"the probe at {host} gave up {count - given_up_before[host]} events")
        for host, count in _given_up(lab).items()
        if count > given_up_before[host]
    ]
    said = sorted(lab.observer.told(begin_s) + goals.said + held + given_up)
    seen.said = [(round(at_s - begin_s, 2), sentence) for at_s, sentence in said]
    seen.name = next((s for _, s in seen.said if re.search(fault.named, s)), "")
    lab.processes.forget("arm")
    return seen


def _restarted(lab: Lab, fault: Fault, started_s: float) -> tuple[float | None, float]:
    """How long what was started again took to be ready, and when it was."""
    if not fault.restarts:
        return None, started_s
    kind, marks = KINDS.get(fault.restarts, fault.restarts), lab.processes.said(fault.restarts).count("router on")

    def ready() -> float | None:
        if kind == ROUTER:
            return monotonic_s() if lab.processes.said(ROUTER).count("router on") > marks else None
        if kind == "recorder":
            return monotonic_s() if len(list(lab.recording.parent.glob("*.mcap"))) > 1 else None
        started = (h for h in lab.observer.messages(LOG, started_s) if h.message.agent == kind)
        return next((h.at_s for h in started if h.message.text.startswith("started")), None)

    ready_s: float = lab.wait(ready, f"{fault.restarts} to be ready again", READY_S)
    return ready_s - started_s, ready_s


def _recovered(lab: Lab, fault: Fault, goals: _Goals, since_s: float, since_ns: int) -> dict[str, float | None]:
    """Seconds until each flow was there again."""
    flows: dict[str, Callable[[], float | None]] = {
        "thread": lambda: _fresh(lab, THREAD, since_s, since_ns),
        "arm": lambda: _fresh(lab, ROBOT_STATE, since_s, since_ns),
        "plan": lambda: next((h.at_s for h in lab.observer.messages(PLAN, since_s)), None),
    }
    if fault.of_recorder:
        flows["recording"] = lambda: _recording(lab, since_s)
    came: dict[str, float | None] = dict.fromkeys(flows)

    def all_flow() -> bool:
        goals.ask()
        for name, flow in flows.items():
            came[name] = came[name] or flow()
        return None not in came.values()

    try:
        lab.wait(all_flow, "all to flow again", RECOVERS_S)
    except NotReachedError as error:
        goals.said.append((monotonic_s(), str(error)))
    return {name: None if at_s is None else max(0.0, at_s - since_s) for name, at_s in came.items()}


def _fresh(lab: Lab, topic: Topic, since_s: float, since_ns: int) -> float | None:
    """When the first message came that is of a time after the fault."""
    wall_ns = now_ns() - round(monotonic_s() * 1e9)
    for heard in lab.observer.messages(topic, since_s):
        message = heard.message
        of_ns = message.measured_ns if topic is ROBOT_STATE else message.stamp.capture_left_ns
        well = topic is ROBOT_STATE or message.status is Status.OK
        if well and of_ns >= since_ns and abs(round(heard.at_s * 1e9) + wall_ns - of_ns) <= FRESH_NS[topic]:
            return heard.at_s
    return None


def _recording(lab: Lab, since_s: float) -> float | None:
    """When the recorder first said, once a second, that nothing keeps it from recording."""
    told = (h for h in lab.observer.messages(HEALTH, since_s) if h.message.agent == "recorder")
    return next((h.at_s for h in told if not h.message.fault), None)


def _events(lab: Lab, plan_id: str) -> list[Heard]:
    return [h for h in lab.observer.messages(EXECUTION) if h.message.plan_id == plan_id]


def _awaited_end(lab: Lab, fault: Fault, plan_id: str, begin_s: float, begin_ns: int) -> tuple[float | None, str]:
    """How the grasp ended, which nobody tells where the arm's own bridge was killed; else it is waited for."""
    if fault.restarts == BRIDGE:
        return _end_of(lab, plan_id, begin_s, begin_ns, fault.wants_clocks) or (None, "ended with its bridge")
    try:
        found: tuple[float | None, str] = lab.wait(
            lambda: _end_of(lab, plan_id, begin_s, begin_ns, fault.wants_clocks), "the grasp to end", GRASP_S
        )
    except NotReachedError:
        return None, f"no end within {GRASP_S:.0f} s"
    return found


def _end_of(lab: Lab, plan_id: str, begin_s: float, begin_ns: int, by_arrival: bool) -> tuple[float | None, str] | None:
    """When the arm held, by its own clock unless that is set, and how its grasp ended; None where it has not."""
    for heard in _events(lab, plan_id):
        if heard.message.kind is ExecutionKind.HELD:
            arrived_ms, by_arm_ms = 1e3 * (heard.at_s - begin_s), 1e-6 * (heard.message.at_ns - begin_ns)
            return arrived_ms if by_arrival else by_arm_ms, heard.message.code
        if heard.message.kind is ExecutionKind.FINISHED:
            return None, "finished"
    return None


def _lost(lab: Lab) -> dict[str, int]:
    """Events by key that have not come where they should, by now."""
    lost = dict(lab.observer.lost_events())
    for listener, told in lab.probes().items():
        for source, (_, missing) in told["heard"].items():
            lost[f"{source} at {listener}"] = missing
        lost[f"order at {listener}"] = told["disordered"]
    return lost


def _given_up(lab: Lab) -> dict[str, int]:
    """By host, what the subscriber of its probe says that it could not get: what else is lost, vanished unnoticed."""
    return {host: told["given_up"] for host, told in lab.probes().items()}


def _lost_meanwhile(lab: Lab, before: dict[str, int]) -> dict[str, int]:
    """Those that were lost since, once all probes have heard what all have said by now, or had time enough."""
    said = {host: told["said"] for host, told in lab.probes().items()}

    def lost() -> dict[str, int]:
        return {name: n - before.get(name, 0) for name, n in _lost(lab).items() if n > before.get(name, 0)}

    def all_heard() -> bool:
        probes = lab.probes().values()
        newest = all(told["heard"].get(host, (-1, 0))[0] >= n - 1 for told in probes for host, n in said.items())
        return newest and not lost()

    late: dict[str, int] = {}
    try:
        lab.wait(all_heard, "events", SETTLES_S)
    except NotReachedError:
        for listener, told in lab.probes().items():
            behind = {host: n - 1 - told["heard"].get(host, (-1, 0))[0] for host, n in said.items()}
            late |= {f"{host} not at {listener} yet": n for host, n in behind.items() if n > RATE_HZ}
    return lost() | late
