"""Gathers what `suturegrasp status` judges by: listens to what is small, and asks for the rest from time to time."""

import contextlib
import socket
import threading
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from agents.configuration.digest import rig_sections
from agents.configuration.reading_session import reading_session
from agents.configuration.rig import RigConfig
from agents.configuration.topics import overrides
from agents.diagnostics.status.agents import Pair, late_links
from agents.diagnostics.status.calibrations import allowed_ages
from agents.diagnostics.status.gathered import FROZEN, ArmHeard, Gathered, expected_rates, placed_agents, placed_beside
from agents.diagnostics.status.health_watch import HealthWatch, key_of
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import (
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
        self._lock = threading.Lock()
        self._known = Gathered(
            at_ns=0,
            rig=rig.rig,
            endpoint=rig.router_endpoint,
            router_host=rig.router.host or "",
            here=socket.gethostname(),
            addresses={name: host.address for name, host in rig.hosts.items()},
            rates_hz=expected_rates(rig),
            here_expires_ns=_own_expiry(rig),
            overrides=overrides(rig.topics),
            rig_sections=rig_sections(rig),
            calibrations=allowed_ages(rig),
        )
        self._present: list[str] = []
        self._states: dict[str, RobotState] = {}
        self._events: dict[str, ExecutionEvent] = {}
        self._tools: dict[str, ToolCorrection] = {}
        self._late_since: dict[Pair, float] | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._ask_again_and_again, name="asking", daemon=True)
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
        fares = tuple(self._health.fares())
        if not (router := self._connection.has_router()):
            self._health.cut_off()
        with self._lock:
            names = sorted({*self._rig.robot, *self._states, *self._events})
            arms = (ArmHeard(a, self._states.get(a), self._events.get(a), self._tools.get(a)) for a in names)
            known = replace(self._known, at_ns=now_ns(), router=router, fares=fares, arms=tuple(arms))
        now_s, late = monotonic_s(), late_links(fares, known.rates_hz)
        self._late_since = late_since(self._late_since, late, now_s)
        return replace(known, late_s={pair: now_s - began_s for pair, began_s in self._late_since.items()})

    def _note(self, **known: Any) -> None:
        with self._lock:
            self._known = replace(self._known, **known)

    def _take(self, tapped: Tapped) -> None:
        with contextlib.suppress(MessageError), self._lock:
            if tapped.topic is EXECUTION:
                self._events[_instance(tapped.key)] = decode(ExecutionEvent, tapped.payload)
                return
            if tapped.topic is TOOL:
                self._tools[_instance(tapped.key)] = decode(ToolCorrection, tapped.payload)
                return
            if tapped.topic is CLOCKS:
                self._known = replace(self._known, planner_clocks=decode(HostClocks, tapped.payload))
                return
            record = decode(LogRecord, tapped.payload)
            if record.level in (LogLevel.WARNING, LogLevel.ERROR):
                self._known = replace(self._known, said=(*self._known.said, record)[-ERRORS_KEPT:])

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
            self._note(other_rigs=() if present else tuple(self._connection.other_rigs()))

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
        self._note(faults=faults)

    def _ask_facts(self) -> None:
        self._note(facts=self._connection.facts())

    def _ask_clocks(self) -> None:
        self._note(clocks=self._connection.clocks())


def late_since(before: Mapping[Pair, float] | None, late: Iterable[Pair], now_s: float) -> dict[Pair, float]:
    """Since when each link has carried too little; one that did at the first look, with none `before`, has for long."""
    return {pair: 0.0 if before is None else before.get(pair, now_s) for pair in late}


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
