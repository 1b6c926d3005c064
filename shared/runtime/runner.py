"""Runs one agent: what arrives is decoded and stepped through, what follows is published, and health says how it goes.

One loop, one thread: ticks, commands, events and newest messages are steps of the same object, one after another. Every
output lists what it was made from (shared/runtime/outlets.py), so that a replay can feed it again. While a recording is
replayed on the rig, its time holds for the agent (shared/runtime/clocks.py). What it is set to is told when it starts
and upon each change (shared/runtime/parameters.py).
"""

import dataclasses
import logging
import math
import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import zenoh

import schemas
from schemas.checks import MessageError, require, with_consumed
from schemas.codec import decode, encoding_name
from schemas.messages import (
    AgentFacts,
    AgentHealth,
    CommandAnswer,
    CommandHeader,
    CommandRecord,
    Consumed,
    HostClock,
    HostClocks,
    LogRecord,
    Outcome,
)
from schemas.topics import (
    CLOCKS,
    COMMANDS,
    CONFIGURATION,
    HEALTH,
    LOG,
    MAIN,
    SET,
    Topic,
    key,
    key_root,
)
from shared.clock import Stopwatch, monotonic_s, now_ns
from shared.runtime.accounts import LIKE_PER_LINE, Faults, Vitals
from shared.runtime.agent import Agent, CannotGoOnError, Command, Later, Output, Received, Tick, awaited
from shared.runtime.attachment import why_refused
from shared.runtime.clocks import AgentClock, ClockWatch, follow_replays
from shared.runtime.commands import OTHER_KEY, Answered, refused, stops, untimely
from shared.runtime.delivery import Rows
from shared.runtime.facts import (
    Surroundings,
    answer_clock,
    answer_facts,
    answer_link,
    answer_progress,
    facts_of,
    realtime_priority,
)
from shared.runtime.intake import Arrival, Intake, taking
from shared.runtime.outlets import TICK, Coming, Fed, Outlets
from shared.runtime.parameters import Parameters
from shared.runtime.process import ServiceManager
from shared.runtime.session import RouterWatch
from shared.runtime.taps import LogTopic

HEALTH_PERIOD_S = 1.0
LONGEST_WAIT_S = 0.5


class Runner:
    """One agent on one session, from `run` until `stop`, or until the agent cannot go on.

    Fields:
        gave_up: why the agent could not go on; empty where it was stopped.
    """

    def __init__(
        self,
        agent: Agent,
        session: zenoh.Session,
        rig: str,
        config_hash: str = "",
        around: Surroundings | None = None,
        otherwise: Rows = (),
    ) -> None:
        self._agent, self._session, self._rig, self._otherwise = agent, session, rig, otherwise
        self._config_hash = config_hash
        self._parameters, self._around, self._manager = Parameters(agent), around or Surroundings(), ServiceManager()
        self._root = key_root(rig, agent.instance, agent.kind)
        self._clock = AgentClock(lambda: agent.keeps_time)
        self._out = Outlets(session, rig, (agent.kind, agent.instance), self._clock, otherwise)
        self._stopped = threading.Event()
        self._answered = Answered()
        self._kept: list[Any] = []
        self._fed = Fed(agent, rig, self._out.epoch)
        self._newest_only = {str(i.topic) for i in agent.inputs if i.only_newest_counts}
        self._steady = {TICK, *(str(i.topic) for i in agent.inputs if i.topic.rate_hz is not None)}
        self._vitals, self._faults = Vitals(agent.kind, agent.instance), Faults()
        self.gave_up = ""
        self._log = logging.getLogger(f"suturegrasp.{agent.kind}.{agent.instance}")
        self._intake = Intake(agent, self._clock, self._log)
        self._coming = Coming(self._intake.handled, self._intake.inbox.wake)
        self._watched = frozenset(agent.watches_clocks)
        for topic in (*agent.outputs, HEALTH, LOG, COMMANDS, CONFIGURATION, *((CLOCKS,) if self._watched else ())):
            self._out.declare(topic)
        self._log_topic = LogTopic(agent.kind, agent.instance, self._publish_log)
        self._log.addHandler(self._log_topic)
        self._log.setLevel(logging.INFO)

    def run(self) -> None:
        """Step until `stop` is called, which any thread or signal handler may do."""
        self._listen()
        next_health_s = monotonic_s()
        next_tick_s = next_health_s if self._agent.tick_hz else math.inf
        longest_s = min(LONGEST_WAIT_S, self._manager.alive_every_s or LONGEST_WAIT_S)
        try:
            while not self._stopped.is_set():
                self._vitals.heartbeat += 1
                self._manager.alive()
                now_s = monotonic_s()
                if change := self._clock.change():
                    self._log.info(change)
                if now_s >= next_health_s:
                    if self._faults.ended(now_s):
                        self._log.info("well again; steps that failed since it began: %d", self._faults.count)
                    self._publish_health(now_s)
                    self._manager.status(self._faults.text or "running")
                    next_health_s = now_s + HEALTH_PERIOD_S
                self._publish_coming()
                # an agent that wants the time more often than before has not to wait for it
                next_tick_s = min(next_tick_s, now_s + self._period_s())
                if now_s >= next_tick_s:
                    self._feed_remembered()
                    self._tick(self._clock.now_ns())
                    # ticks that were missed are left out, not made up for
                    next_tick_s = max(next_tick_s + self._period_s(), monotonic_s())
                # even where ticks alone take all the time, what arrives has its turn after each
                until_s = min(next_health_s, next_tick_s)
                arrival = self._intake.inbox.take(min(longest_s, max(0.0, until_s - monotonic_s())))
                if arrival is not None:
                    self._take_up(arrival)
        finally:
            self._end()

    def stop(self) -> None:
        """Let `run` return after the step it is in."""
        self._stopped.set()
        self._intake.inbox.wake()

    def _take_up(self, arrival: Arrival) -> None:
        """Handle what has arrived; where that fails beside the step itself, the loop goes on with the next."""
        try:
            self._feed_remembered()
            self._handle(arrival)
        except Exception as error:
            self._note_fault(error, str(arrival.topic))

    def _publish_health(self, now_s: float) -> None:
        try:
            self._out.publish(HEALTH, self._health(now_s))
        except Exception as error:
            # what an agent drives goes on, or is held, whether or not anybody can be told
            self._note_fault(error, str(HEALTH))

    def _period_s(self) -> float:
        return 1.0 / self._agent.tick_hz if self._agent.tick_hz else math.inf

    def _listen(self) -> None:
        self._kept += self._intake.listen(self._session, self._rig, self._otherwise)
        commands = [
            (topic, topic.agent, self._agent.instance if topic.per_arm else MAIN) for topic in self._agent.commands
        ]
        for topic, agent, instance in (*commands, (SET, self._agent.kind, self._agent.instance)):
            take = taking(topic, self._intake.inbox, self._answered, self._agent.halt)
            selector = key(self._rig, topic, instance, agent)
            self._kept.append(self._session.declare_queryable(selector, take, complete=True))
        self._answer_questions()
        self._kept.append(RouterWatch(self._session, self._log.warning))
        if self._agent.accepts_replayed_time:
            self._kept.append(follow_replays(self._session, self._rig, self._clock))
        self._kept.append(self._session.liveliness().declare_token(self._root))
        self._publish_configuration()
        if self._watched:
            self._kept.append(ClockWatch(self._session, self._rig, self._watched, self._publish_clocks))
        self._log.info("started, version %s", schemas.__version__)
        self._manager.ready()

    def _answer_questions(self) -> None:
        """What is answered from Zenoh's threads, however long a step takes."""
        granted, agent = realtime_priority(), self._agent

        def facts() -> AgentFacts:
            config_hash = self._parameters.hashed(self._config_hash)
            return facts_of(self._session, agent.kind, agent.instance, config_hash, self._around, granted)

        self._kept.append(answer_clock(self._session, self._root))
        self._kept.append(answer_facts(self._session, self._root, facts))
        self._kept.append(answer_link(self._session, self._root))
        self._tell_progress()

    def _tell_progress(self) -> None:
        def published() -> tuple[Consumed, ...]:
            # an agent that ticks speaks unasked, and nobody can wait for the end of that
            topics = self._agent.outputs if self._agent.tick_hz is None else ()
            counts = [(self._out.key(topic), self._out.account(topic).published) for topic in topics]
            return tuple(Consumed(name, self._out.epoch, count - 1) for name, count in counts if count)

        listens = [key(self._rig, i.topic, i.instance) for i in self._agent.inputs]
        self._kept.append(answer_progress(self._session, self._root, listens, self._intake.handled, published))

    def _feed_remembered(self) -> None:
        for arrival in self._intake.inbox.remembered():
            self._handle(arrival, counted=True)

    def _handle(self, arrival: Arrival, counted: bool = False) -> None:
        if arrival.answer is not None:
            self._carry_out(arrival, arrival.answer)
            return
        account, beside = self._intake.account(arrival.topic), arrival.beside
        try:
            if arrival.named:
                raise MessageError(why_refused(arrival.named))
            if beside is None:
                raise MessageError("it came without the attachment that agents send")
            message = decode(arrival.topic.message, arrival.payload())
            check_arm(arrival.topic, arrival.key, message)
        except MessageError as error:
            if account.refused % LIKE_PER_LINE == 0:
                self._log.warning("a message on %s was refused: %s", arrival.key, error)
            account.refuse(counted)
            # what is only remembered was noted when it came, and a newer one may have come since
            if beside is not None and not counted:
                self._intake.handled.note(arrival.key, beside.epoch, beside.sequence)
            return
        if not counted:
            self._intake.looked_at(arrival.topic, beside)
        only_newest_counts = str(arrival.topic) in self._newest_only
        self._fed.message(arrival.key, beside.epoch, beside.sequence, only_newest_counts)
        self._step(Received(arrival.topic, arrival.key, beside.sequence, message))
        if not counted:
            self._coming.note(arrival.key, beside.epoch, beside.sequence)

    def _carry_out(self, arrival: Arrival, answer: Callable[[CommandAnswer], None]) -> None:
        payload, received_ns = arrival.payload(), self._clock.now_ns()
        try:
            if arrival.named:
                raise MessageError(why_refused(arrival.named))
            message = decode(arrival.topic.message, payload)
        except MessageError as error:
            self._log.warning("a command on %s was refused: %s", arrival.key, error)
            answer(refused("", OTHER_KEY if arrival.named else "unreadable", str(error)))
            return
        before, stopping = self._answered.recall(message.header.id), stops(message)
        if before is not None and not stopping:
            answer(before)
            return
        refusal = None if stopping else _untimely(message.header, received_ns)
        outputs: list[Output] = []
        watch = Stopwatch("step")
        if refusal is not None:
            reply = refusal
        else:
            record_key = key(self._rig, COMMANDS, self._agent.instance, self._agent.kind)
            self._fed.message(record_key, self._out.epoch, self._out.account(COMMANDS).published)
            command = Command(arrival.topic, arrival.key.split("/")[-2], message, received_ns)
            reply, outputs, watch = self._answer_of(command)
        self._answered.remember(reply)
        try:
            answer(reply)
        except Exception as error:
            # whoever asked is gone; what was carried out is recorded all the same
            self._log.warning("an answer to %s could not be sent: %s", arrival.topic, error)
        record = CommandRecord(str(arrival.topic), encoding_name(arrival.topic.message), payload, received_ns, reply)
        try:
            self._out.publish(COMMANDS, record)
        except Exception as error:
            self._note_fault(error, str(arrival.topic))
        if arrival.topic is SET and reply.outcome is Outcome.ACCEPTED:
            self._log.info("%s was set to %s by %s", message.name, message.value, message.header.sender)
            # listed from now on, so that a replay that knows nothing of the command knows what followed from it
            sequence = self._publish_configuration()
            self._fed.message(self._out.key(CONFIGURATION), self._out.epoch, sequence, only_newest_counts=True)
        if reply.outcome is not Outcome.ACCEPTED:
            self._log.info("refused %s: %s", arrival.topic, reply.reason)
        if outputs:
            self._publish_all(outputs, watch, str(arrival.topic))

    def _answer_of(self, command: Command) -> tuple[CommandAnswer, list[Output], Stopwatch]:
        watch = Stopwatch("step")
        try:
            with watch.step("step"):
                replies = awaited(self._parameters.step(command))
        except Exception as error:
            self._note_fault(error, str(command.topic))
            return refused(command.message.header.id, "fault", self._faults.text), [], watch
        answers = [reply for reply in replies if isinstance(reply, CommandAnswer)]
        outputs = [reply for reply in replies if isinstance(reply, Output)]
        if len(answers) != 1:
            return refused(command.message.header.id, "fault", "the agent gave no answer"), outputs, watch
        return answers[0], outputs, watch

    def _tick(self, at_ns: int) -> None:
        self._fed.tick(at_ns)
        self._step(Tick(at_ns))

    def _step(self, arrived: Received | Tick) -> None:
        of = TICK if isinstance(arrived, Tick) else str(arrived.topic)
        watch = Stopwatch("step")
        try:
            went_well = self._publish_all(self._outputs_of(arrived, watch), watch, of)
        except Exception as error:
            self._note_fault(error, of)
            return
        self._vitals.steps.add(watch.ms["step"])
        if went_well:
            self._faults.went_well(of)

    def _outputs_of(self, arrived: Received | Tick, watch: Stopwatch) -> Iterator[Output | Later]:
        """What follows from a step, each as soon as the agent has it, so that nobody waits for what comes after."""
        replies = iter(self._parameters.step(arrived))
        while True:
            with watch.step("step"):
                reply = next(replies, None)
            if reply is None:
                return
            if isinstance(reply, Output | Later):
                yield reply

    def _note_fault(self, error: Exception, of: str) -> None:
        """A step that raises is a bug; the agent goes on with the next message, and says so until that is over.

        Unless it says itself that it cannot: then `run` ends, and the last health says why.
        """
        said = str(error).encode("utf-8", "backslashreplace").decode()
        gives_up = isinstance(error, CannotGoOnError)
        fault = said if gives_up else f"a step failed: {type(error).__name__}: {said}"
        is_new = self._faults.failed(of, fault, monotonic_s(), alone=of not in self._steady)
        if gives_up:
            self.gave_up = said
            self._stopped.set()
        if is_new:
            self._log.error(fault, exc_info=None if gives_up else error)

    def _publish_coming(self, wait: bool = False) -> None:
        """Publish what earlier steps gave and was still worked on, if it is there; or wait for it."""
        for expected in self._coming.there(wait):
            try:
                output = expected.later.output()
                self._out.publish(output.topic, with_consumed(output.message, expected.fed), expected.took_ms())
            except Exception as error:
                self._note_fault(error, expected.of)

    def _publish_all(self, outputs: Iterable[Output | Later], watch: Stopwatch, of: str) -> bool:
        """Publish what follows from a step that the watch times; whether all of it could be."""
        fed, last, went_well = self._fed.listed(), None, True
        try:
            for output in outputs:
                if isinstance(output, Later):
                    self._publish_coming(wait=True)
                    self._coming.add(output, fed, of, watch.ms["step"])
                    continue
                try:
                    message = with_consumed(output.message, fed)
                    place = self._out.key(output.topic), self._out.publish(output.topic, message, watch.ms["step"])
                    last = place if output.topic is (self._agent.goes_on_from or output.topic) else last
                except MessageError as error:
                    self._note_fault(error, of)
                    went_well = False
        finally:
            if last is not None:
                self._fed.published(*last)
        return went_well

    def _publish_log(self, record: LogRecord) -> None:
        self._out.publish(LOG, dataclasses.replace(record, at_ns=self._clock.now_ns()))

    def _publish_configuration(self) -> int:
        told = self._parameters.told(self._clock.now_ns(), self._config_hash)
        return self._out.publish(CONFIGURATION, told)

    def _publish_clocks(self, clocks: tuple[HostClock, ...]) -> None:
        self._out.publish(CLOCKS, HostClocks(self._clock.now_ns(), clocks))

    def _health(self, now_s: float) -> AgentHealth:
        config_hash, inputs = self._parameters.hashed(self._config_hash), self._intake.health(now_s)
        outputs = tuple(self._out.account(topic).health(now_s) for topic in self._agent.outputs)
        return self._vitals.health(self._clock.now_ns(), config_hash, self._faults.text, inputs, outputs)

    def _end(self) -> None:
        """Let the agent come to rest before it falls silent."""
        self._manager.stopping()
        self._publish_coming(wait=True)
        if self.gave_up:
            self._out.publish(HEALTH, self._health(monotonic_s()))
        try:
            self._agent.close()
        except Exception as error:
            self._note_fault(error, "closing")
        self._undeclare()

    def _undeclare(self) -> None:
        self._log.info("stopped")
        self._log.removeHandler(self._log_topic)
        for declared in (*self._kept, self._out):
            declared.undeclare()


def _untimely(header: CommandHeader, received_ns: int) -> CommandAnswer | None:
    """As `untimely`; while a recording is replayed, people who send commands live by this machine's clock still."""
    return untimely(header, now_ns()) and untimely(header, received_ns)


def check_arm(topic: Topic, key: str, message: Any) -> None:
    """Refuse what speaks of another arm than the one under whose key it was published.

    Raises:
        MessageError: where it does.
    """
    if topic.per_arm:
        of = key.split("/")[-2]
        require(message.arm == of, f"it speaks of the arm {message.arm[:40]!r} under the key of {of}")
