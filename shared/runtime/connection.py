"""What a person's command, or a tool beside the dataflow, needs of it: send, listen, and keep a heartbeat.

Such a client is no agent: it has no inputs to replay. It knows the rig's keys and nothing of Zenoh.
"""

import contextlib
import json
import logging
import os
import queue
import threading
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, contextmanager
from itertools import count
from typing import Any

import zenoh

from schemas.checks import MessageError
from schemas.codec import decode, encode
from schemas.messages import AgentConfiguration, AgentFacts, CommandAnswer, SetParameter
from schemas.topics import CONFIGURATION, MAIN, SET, Topic, key, key_root
from shared.clock import monotonic_s, now_ns
from shared.runtime.attachment import Attachment, pack
from shared.runtime.clocks import ClockOffset, clock_offset
from shared.runtime.commands import new_header, send_command
from shared.runtime.delivery import as_told, declare_publisher
from shared.runtime.facts import Link, Surroundings, ask_facts, measure_link
from shared.runtime.identity import IdentityError
from shared.runtime.session import SessionSettings, open_session, present
from shared.runtime.taps import TapAccounts, Tapped, reporting, tap

ROUTER_WAIT_S = 3.0
CONFIGURATION_WAIT_S = 1.0
LOOK_S = 0.05
ABOUT_TO_S = 0.5


class NoRouterError(RuntimeError):
    """No router answers; the text names where it was looked for."""


class Connection:
    """A client of a rig."""

    def __init__(self, session: zenoh.Session, settings: SessionSettings) -> None:
        self._session, self._rig, self._otherwise = session, settings.rig, settings.otherwise
        self._kept: list[Any] = []
        self._accounts = TapAccounts()

    def listen(
        self,
        topics: tuple[Topic, ...],
        receive: Callable[[Tapped], None],
        missed: Callable[[Topic, int], None] = lambda _topic, _count: None,
    ) -> None:
        """Have every message of these topics handed over, from other threads, until the connection is closed."""
        self._kept += tap(self._session, self._rig, topics, receive, missed, self._otherwise, self._accounts)

    @contextmanager
    def listening(self, topics: tuple[Topic, ...], receive: Callable[[Tapped], None]) -> Generator[None]:
        """Have messages handed over as `listen` does, for as long as it is needed."""
        declared = tap(self._session, self._rig, topics, receive, lambda _topic, _count: None, self._otherwise)
        try:
            yield
        finally:
            for one in declared:
                one.undeclare()

    def command(self, topic: Topic, message: Any, instance: str = MAIN) -> CommandAnswer:
        """Send a command and return its answer; UNKNOWN where none came."""
        return send_command(self._session, self._rig, topic, message, instance)

    def has_router(self) -> bool:
        """Whether a router is connected now."""
        return bool(self._session.info.routers_zid())

    def present(self) -> list[str]:
        """Which agents are there, as `kind/instance`; none where nobody tells."""
        return self.present_if_told() or []

    def present_if_told(self) -> list[str] | None:
        """Which agents are there, as `kind/instance`; None where the router gives no answer."""
        told = present(self._session, key_root(self._rig, "*", "*"))
        return None if told is None else [f"{kind}/{instance}" for _, kind, instance in told]

    def other_rigs(self) -> list[str]:
        """Whose agents are there beside this rig's, on the same router; none where nobody tells."""
        told = present(self._session, key_root("*", "*", "*")) or []
        return sorted({rig for rig, _, _ in told} - {self._rig})

    def clocks(self) -> dict[str, ClockOffset | None]:
        """How far the clock of each agent's host is from this one's; None where the agent gives no answer."""
        named = {name: name.split("/") for name in self.present()}
        return {name: clock_offset(self._session, self._rig, kind, which) for name, (kind, which) in named.items()}

    def facts(self) -> dict[str, AgentFacts]:
        """Where each agent runs and what it was granted there, by `kind/instance`, of those that answer."""
        return ask_facts(self._session, self._rig)

    def link(self, kind: str, instance: str = MAIN) -> Link | None:
        """How long a round trip to an agent takes and how fast much comes; None where it gives no answer."""
        return measure_link(self._session, self._rig, kind, instance)

    def set_parameter(self, kind: str, instance: str, name: str, value: Any, sender: str) -> CommandAnswer:
        """Set a parameter of a running agent to a value that JSON can hold; its answer, UNKNOWN where none came."""
        command = SetParameter(new_header(sender), name, json.dumps(value))
        return send_command(self._session, self._rig, SET, command, instance, agent=kind)

    def configurations(self, within_s: float = CONFIGURATION_WAIT_S) -> dict[str, AgentConfiguration]:
        """What each agent that is there is set to, by `kind/instance`, of those of which it was heard in time."""
        present, found, heard = set(self.present()), dict[str, AgentConfiguration](), threading.Condition()

        def take(tapped: Tapped) -> None:
            with contextlib.suppress(MessageError), heard:
                found["/".join(tapped.key.split("/")[2:4])] = decode(AgentConfiguration, tapped.payload)
                heard.notify()

        with self.listening((CONFIGURATION,), take), heard:
            heard.wait_for(lambda: present <= found.keys(), within_s)
            told = dict(sorted(found.items()))
        return {name: configuration for name, configuration in told.items() if name in present}

    @contextmanager
    def repeating(
        self, topic: Topic, instance: str, rate_hz: float, message: Callable[[int], Any | None]
    ) -> Generator[threading.Event]:
        """Publish a message again and again from a thread of its own; setting the event stops it early.

        `message` is given the time, and gives None where nothing is to be published this time.
        """
        stopped = threading.Event()
        with self.publishing(topic, instance) as publish:
            repeat = (publish, stopped, rate_hz, message)
            thread = threading.Thread(target=_repeat, args=repeat, name=f"repeat {topic}", daemon=True)
            thread.start()
            try:
                yield stopped
            finally:
                stopped.set()
                thread.join()

    @contextmanager
    def publishing(self, topic: Topic, instance: str = MAIN) -> Generator[Callable[[Any, int], None]]:
        """A way to publish messages of a topic, each with the time that it is of; one at a time."""
        row = as_told(topic, self._otherwise)
        publisher = declare_publisher(self._session, key(self._rig, topic, instance), row)
        epoch, sequence = int.from_bytes(os.urandom(7), "big"), count()

        def publish(message: Any, at_ns: int) -> None:
            publisher.put(encode(message), attachment=pack(Attachment(epoch, next(sequence), at_ns, 0.0)))

        try:
            yield publish
        finally:
            publisher.undeclare()

    def reporting(
        self,
        kind: str,
        instance: str,
        logger: logging.Logger,
        fault: Callable[[], str],
        config_hash: str = "",
        around: Surroundings | None = None,
    ) -> AbstractContextManager[None]:
        """Tell of this process as agents do, for as long as it lasts; see `shared.runtime.taps`.

        What it hears by `listen` is counted in its health, where any of it had to be refused.
        """
        told = logger, fault, config_hash, around, self._otherwise, self._accounts.health
        return reporting(self._session, self._rig, kind, instance, *told)

    def close(self) -> None:
        """Stop listening."""
        for declared in self._kept:
            declared.undeclare()
        self._kept = []


@contextmanager
def connected(
    settings: SessionSettings, within_s: float | None = ROUTER_WAIT_S, stopped: threading.Event | None = None
) -> Generator[Connection]:
    """A connection to a rig for as long as it is needed.

    Raises:
        NoRouterError: where no router answers in time (None: as long as it takes), or before `stopped` is set.
        IdentityError: where its certificate cannot be used.
    """
    with open_when_there(settings, within_s, stopped) as session:
        connection = Connection(session, settings)
        try:
            yield connection
        finally:
            connection.close()


def open_when_there(
    settings: SessionSettings, within_s: float | None = None, stopped: threading.Event | None = None
) -> zenoh.Session:
    """A session once the router answers. Zenoh waits without heeding signals, so it is left to wait in a thread.

    Raises:
        NoRouterError: as for `connected`.
    """
    opened: queue.Queue[zenoh.Session | Exception] = queue.Queue()

    def wait() -> None:
        try:
            opened.put(open_session(settings))
        except (zenoh.ZError, IdentityError) as error:
            opened.put(error)

    connecting = threading.Thread(target=wait, name="connecting", daemon=True)
    connecting.start()
    deadline_s = None if within_s is None else monotonic_s() + within_s
    while stopped is None or not stopped.is_set():
        try:
            session = opened.get(timeout=LOOK_S)
        except queue.Empty:
            if deadline_s is not None and monotonic_s() > deadline_s:
                break
            continue
        if isinstance(session, IdentityError):
            raise session
        if isinstance(session, Exception):
            raise NoRouterError(f"{settings.endpoint} cannot be connected to: {session}")
        return session
    # what comes back from Zenoh while Python ends aborts the process: what is about to connect is awaited, and closed
    connecting.join(ABOUT_TO_S)
    if not opened.empty() and isinstance(late := opened.get(), zenoh.Session):
        late.close()
    raise NoRouterError(f"no router answers on {settings.endpoint}; is suturegrasp up running there?")


def _repeat(
    publish: Callable[[Any, int], None],
    stopped: threading.Event,
    rate_hz: float,
    message: Callable[[int], Any | None],
) -> None:
    while not stopped.is_set():
        at_ns = now_ns()
        said = message(at_ns)
        if said is not None:
            publish(said, at_ns)
        stopped.wait(1.0 / rate_hz)
