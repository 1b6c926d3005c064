"""One fault in the middle of a grasp, and what followed, as it was seen from beside."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field

from schemas.messages import ExecutionKind, Status
from schemas.topics import EXECUTION, HEALTH, LOG, PLAN, ROBOT_STATE, THREAD, Topic
from shared.clock import monotonic_s, now_ns
from tests.rigs.faults.faults import Fault
from tests.rigs.faults.lab import Lab, NotReachedError
from tests.rigs.faults.observer import Heard
from tests.rigs.faults.probe import RATE_HZ
from tests.rigs.faults.rig import BRIDGE, KINDS, ROUTER

FRESH_NS = {THREAD: 1_000_000_000, ROBOT_STATE: 100_000_000}
"""How old what flows may be to count as flowing again."""
READY_S, RECOVERS_S, SETTLES_S, NAMED_S, GRASP_S = 30.0, 30.0, 15.0, 4.0, 15.0


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


def trial(lab: Lab, fault: Fault) -> Seen:
    """Carry out a grasp, let the fault happen in its middle, and look at what follows."""
    plan_id, lost_before = lab.grasp_under_way(), _lost(lab)
    lab.let_pass(0.3)
    seen, begin_ns = Seen(fault.name, monotonic_s()), now_ns()
    end_s = seen.begin_s + fault.lasts_s

    def over() -> bool:
        lab.observer.ask()
        return monotonic_s() >= end_s

    with fault.during(lab):
        lab.wait(over, "the fault to end", fault.lasts_s + READY_S)
        ended_s, ended_ns = monotonic_s(), now_ns()
    ready_s = _ready_s(lab, fault, ended_s)
    seen.startup_s = ready_s - ended_s if fault.restarts else None
    seen.recovery_s = _recovered(lab, fault, ready_s, ended_ns + round((ready_s - ended_s) * 1e9))
    lab.let_pass(max(0.0, seen.begin_s + NAMED_S - monotonic_s()))
    seen.lost = _lost_meanwhile(lab, lost_before)
    seen.held_ms, seen.ended = _awaited_end(lab, fault, plan_id, seen.begin_s, begin_ns)
    held = [(h.at_s, f"{h.message.arm}: {h.message.reason}") for h in _events(lab, plan_id) if h.message.reason]
    said = sorted(lab.observer.told(seen.begin_s) + held)
    seen.said = [(round(at_s - seen.begin_s, 2), sentence) for at_s, sentence in said]
    seen.name = next((s for _, s in seen.said if re.search(fault.named, s)), "")
    lab.processes.forget("arm")
    return seen


def _ready_s(lab: Lab, fault: Fault, started_s: float) -> float:
    """When what was started again was ready."""
    if not fault.restarts:
        return started_s
    kind, marks = KINDS.get(fault.restarts, fault.restarts), lab.processes.said(fault.restarts).count("router on")

    def ready() -> float | None:
        if kind in (ROUTER, "recorder"):
            listens = kind == ROUTER and lab.processes.said(ROUTER).count("router on") > marks
            records = kind != ROUTER and len(list(lab.recording.parent.glob("*.mcap"))) > 1
            return monotonic_s() if listens or records else None
        started = (h for h in lab.observer.messages(LOG, started_s) if h.message.agent == kind)
        return next((h.at_s for h in started if h.message.text.startswith("started")), None)

    return lab.wait(ready, f"{fault.restarts} to be ready again", READY_S)


def _recovered(lab: Lab, fault: Fault, since_s: float, since_ns: int) -> dict[str, float | None]:
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
        lab.observer.ask()
        for name, flow in flows.items():
            came[name] = came[name] or flow()
        return None not in came.values()

    try:
        lab.wait(all_flow, "all to flow again", RECOVERS_S)
    except NotReachedError as error:
        lab.observer.note(str(error))
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
    """When the arm held, by its own clock unless that is set, and how its grasp ended; which it is waited for.

    Nobody tells that where the arm's own bridge was killed.
    """

    def end() -> tuple[float | None, str] | None:
        for heard in _events(lab, plan_id):
            if heard.message.kind is ExecutionKind.HELD:
                arrived_ms, by_arm_ms = 1e3 * (heard.at_s - begin_s), 1e-6 * (heard.message.at_ns - begin_ns)
                return arrived_ms if fault.wants_clocks else by_arm_ms, heard.message.code
            if heard.message.kind is ExecutionKind.FINISHED:
                return None, "finished"
        return None

    if fault.restarts == BRIDGE:
        return end() or (None, "ended with its bridge")
    try:
        return lab.wait(end, "the grasp to end", GRASP_S)
    except NotReachedError:
        return None, f"no end within {GRASP_S:.0f} s"


def _lost(lab: Lab) -> dict[str, int]:
    """Events by key that have not come where they should, by now."""
    lost = dict(lab.observer.lost_events())
    for listener, told in lab.probes().items():
        lost |= {f"{source} at {listener}": missing for source, (_, missing) in told["heard"].items()}
    return lost


def _lost_meanwhile(lab: Lab, before: dict[str, int]) -> dict[str, int]:
    """Those that were lost since, once all probes have heard what all have said by now, or had time enough."""
    said = {host: told["said"] for host, told in lab.probes().items()}

    def lost() -> dict[str, int]:
        return {name: n - before.get(name, 0) for name, n in _lost(lab).items() if n > before.get(name, 0)}

    def behind() -> dict[str, int]:
        """How many events of each host that each listener has not heard."""
        return {
            f"{host} not at {listener} yet": n - 1 - told["heard"].get(host, (-1, 0))[0]
            for listener, told in lab.probes().items()
            for host, n in said.items()
        }

    late: dict[str, int] = {}
    try:
        lab.wait(lambda: max(behind().values()) <= 0 and not lost(), "events", SETTLES_S)
    except NotReachedError:
        late = {name: n for name, n in behind().items() if n > RATE_HZ}
    return lost() | late
