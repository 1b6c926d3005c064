"""Gathers what `suturegrasp status` judges by: listens to what is small, and asks for the rest from time to time."""

import contextlib
import socket
import threading
from collections import deque
from collections.abc import Iterable

from agents.configuration.digest import rig_sections
from agents.configuration.reading_session import reading_session
from agents.configuration.rig import RigConfig
from agents.configuration.topics import overrides
from agents.diagnostics.status.agents import Pair, late_links
from agents.diagnostics.status.calibrations import allowed_ages
from agents.diagnostics.status.gathered import FROZEN, ArmHeard, Gathered, expected_rates, placed_agents, placed_beside
from agents.diagnostics.status.health_watch import Fare, HealthWatch, key_of
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import (
    AgentFacts,
    ExecutionEvent,
    HostClocks,
    Judgement,
    LogLevel,
    LogRecord,
    RobotState,
    Severity,
    ThreadObservations,
    ToolCorrection,
)
from schemas.topics import CLOCKS, EXECUTION, LOG, OBSERVATIONS, ROBOT_STATE, TOOL
from shared.clock import monotonic_s, now_ns
from shared.runtime.clocks import ClockOffset
from shared.runtime.connection import Connection
from shared.runtime.identity import IdentityError, validity_ns
from shared.runtime.taps import Tapped

PRESENT_EVERY_S, ARMS_EVERY_S, CLOCKS_EVERY_S, FACTS_EVERY_S = 1.0, 2.0, 10.0, 60.0
STATES_WITHIN_S = 0.3
"""States come every 10 ms, more slowly where a machine is busy."""
OBSERVATIONS_EVERY_S, OBSERVATIONS_WITHIN_S = 5.0, 1.0
"""They come with every frame that perception looks at."""
ERRORS_KEPT = 20
ENDS_S = 5.0


class StatusWatch:
    """What is heard of a rig; a thread of its own asks, since an agent that hangs takes a second not to answer."""

    def __init__(self, connection: Connection, rig: RigConfig) -> None:
        self._connection, self._rig = connection, rig
        placed = placed_agents(rig)
        self._health = HealthWatch(connection, placed, placed | placed_beside(rig))
        self._rates = expected_rates(rig)
        self._addresses = {name: host.address for name, host in rig.hosts.items()}
        self._lock = threading.Lock()
        self._present: list[str] = []
        self._planner_clocks: HostClocks | None = None
        self._states: dict[str, RobotState] = {}
        self._events: dict[str, ExecutionEvent] = {}
        self._errors: deque[LogRecord] = deque(maxlen=ERRORS_KEPT)
        self._clocks: dict[str, ClockOffset | None] = {}
        self._facts: dict[str, AgentFacts] = {}
        self._expires_ns = _own_expiry(rig)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._ask_again_and_again, name="asking", daemon=True)
        self._tools: dict[str, ToolCorrection] = {}
        self._other_rigs: tuple[str, ...] = ()
        self._faults: tuple[Judgement, ...] = ()
        self._late_since: dict[Pair, float] | None = None
        connection.listen((EXECUTION, LOG, CLOCKS, TOOL), self._take)

    def start(self) -> None:
        """Ask from now on, from a thread."""
        self._thread.start()

    def close(self) -> None:
        """End the thread: one that is still inside Zenoh when the interpreter ends aborts the process."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join(ENDS_S)

    def ask(self) -> None:
        """Ask for all that is asked for, once."""
        self._ask_who_is_there()
        self._hear_observations()
        self._hear_arms()
        self._ask_facts()
        self._ask_clocks()

    def all_heard(self) -> bool:
        """Whether everybody who is there has told how it fares."""
        return all(fare.health is not None for fare in self._health.fares() if fare.present)

    def gathered(self) -> Gathered:
        """All that is known now."""
        with self._lock:
            states, events, planner_clocks = dict(self._states), dict(self._events), self._planner_clocks
            clocks, facts, errors = dict(self._clocks), dict(self._facts), tuple(self._errors)
            tools, faults, other_rigs = dict(self._tools), self._faults, self._other_rigs
        arms, fares = sorted({*self._rig.robot, *states, *events}), tuple(self._health.fares())
        if not (router := self._connection.has_router()):
            self._health.cut_off()
        return Gathered(
            at_ns=now_ns(),
            rig=self._rig.rig,
            endpoint=self._rig.router_endpoint,
            router=router,
            router_host=self._rig.router.host or "",
            here=socket.gethostname(),
            fares=fares,
            addresses=self._addresses,
            rates_hz=self._rates,
            clocks=clocks,
            planner_clocks=planner_clocks,
            arms=tuple(ArmHeard(arm, states.get(arm), events.get(arm), tools.get(arm)) for arm in arms),
            facts=facts,
            said=errors,
            here_expires_ns=self._expires_ns,
            overrides=overrides(self._rig.topics),
            rig_sections=rig_sections(self._rig),
            calibrations=allowed_ages(self._rig),
            other_rigs=other_rigs,
            faults=faults,
            late_s=self._late_s(fares),
        )

    def _late_s(self, fares: tuple[Fare, ...]) -> dict[Pair, float]:
        """For how long each link has carried too little, look by look; one that did at first has for long."""
        now_s, before = monotonic_s(), self._late_since
        since = {pair: 0.0 if before is None else before.get(pair, now_s) for pair in late_links(fares, self._rates)}
        self._late_since = since
        return {pair: now_s - began_s for pair, began_s in since.items()}

    def _take(self, tapped: Tapped) -> None:
        with contextlib.suppress(MessageError), self._lock:
            if tapped.topic is EXECUTION:
                self._events[_instance(tapped.key)] = decode(ExecutionEvent, tapped.payload)
                return
            if tapped.topic is TOOL:
                self._tools[_instance(tapped.key)] = decode(ToolCorrection, tapped.payload)
                return
            if tapped.topic is CLOCKS:
                self._planner_clocks = decode(HostClocks, tapped.payload)
                return
            record = decode(LogRecord, tapped.payload)
            if record.level in (LogLevel.WARNING, LogLevel.ERROR):
                self._errors.append(record)

    def _ask_again_and_again(self) -> None:
        due = {
            self._ask_who_is_there: PRESENT_EVERY_S,
            self._hear_arms: ARMS_EVERY_S,
            self._hear_observations: OBSERVATIONS_EVERY_S,
            self._ask_facts: FACTS_EVERY_S,
            self._ask_clocks: CLOCKS_EVERY_S,
        }
        next_s = dict.fromkeys(due, monotonic_s())
        while not self._ended.is_set():
            if not self._connection.has_router():
                self._health.cut_off()
            for ask, every_s in due.items():
                if monotonic_s() >= next_s[ask] and not self._ended.is_set() and self._connection.has_router():
                    ask()
                    next_s[ask] = monotonic_s() + every_s
            self._ended.wait(PRESENT_EVERY_S)

    def _ask_who_is_there(self) -> None:
        # a router that is cut off does not answer, which says nothing of the agents
        if (present := self._connection.present_if_told()) is not None:
            self._present = present
            self._health.note_present(present)
            others = () if present else tuple(self._connection.other_rigs())
            with self._lock:
                self._other_rigs = others

    def _hear_arms(self) -> None:
        """One state of each arm that is there: to hear all of them, at 100 Hz, would be most of the work here."""
        arms = {name.split("/")[1] for name in self._present if name.startswith(f"{ROBOT_STATE.agent}/")}
        newest, all_heard = dict[str, bytes](), threading.Event()

        def hear(tapped: Tapped) -> None:
            newest[_instance(tapped.key)] = tapped.payload
            if arms <= newest.keys():
                all_heard.set()

        if arms:
            with self._connection.listening((ROBOT_STATE,), hear):
                all_heard.wait(STATES_WITHIN_S)
        states = dict[str, RobotState]()
        for arm, payload in list(newest.items()):
            with contextlib.suppress(MessageError):
                states[arm] = decode(RobotState, payload)
        with self._lock:
            self._states = states

    def _hear_observations(self) -> None:
        """The newest observations, for what keeps the images from being used: all of them would be most of the work."""
        newest, heard = list[bytes](), threading.Event()

        def hear(tapped: Tapped) -> None:
            newest.append(tapped.payload)
            heard.set()

        if key_of(OBSERVATIONS.agent) in self._present:
            with self._connection.listening((OBSERVATIONS,), hear):
                if not heard.wait(OBSERVATIONS_WITHIN_S):
                    # of a slow camera the last ones hold until others come
                    return
        faults: tuple[Judgement, ...] = ()
        with contextlib.suppress(MessageError, IndexError):
            observed = decode(ThreadObservations, newest[-1])
            faults = against_use(observed.judgements)
        with self._lock:
            self._faults = faults

    def _ask_facts(self) -> None:
        facts = self._connection.facts()
        with self._lock:
            self._facts = facts

    def _ask_clocks(self) -> None:
        clocks = self._connection.clocks()
        with self._lock:
            self._clocks = clocks


def against_use(judgements: Iterable[Judgement]) -> tuple[Judgement, ...]:
    """Those that keep images from being used, or an arm from going by them."""
    return tuple(one for one in judgements if one.severity is Severity.FAULT or one.code == FROZEN)


def _instance(key: str) -> str:
    return key.split("/")[3]


def _own_expiry(rig: RigConfig) -> int | None:
    identity = reading_session(rig).identity
    if identity is None:
        return None
    try:
        return validity_ns(identity.certificate)[1]
    except IdentityError:
        return None
