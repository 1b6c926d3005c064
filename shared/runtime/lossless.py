"""A subscriber that asks publishers' caches for what it has not heard, again and again until they have answered.

Zenoh's own advanced subscriber may lose events that their publisher still holds: its question, or the answer, comes to
nothing while the link of either side has just come back. Over a killed router and four hosts that were cut off for 3 s
each, all agents of a rig running (tests/rigs/faults), a recorder with it missed 191 of 4 294 events by heartbeats, and
246 of 3 506 by periodic queries of half a second; with this one none of 3 247, nor of 3 090. And it believes every
number, of which some were parts of other messages after links broke. (Of 6 177 events between a few sessions neither
missed any on 29 November 2026, `benchmarks.latency --only parts`; a hop of 1 kB takes 0.39 ms with either.)
Publishers are those of `zenoh.ext`: they announce themselves by a token, tell the number of their newest message in a
heartbeat, and answer questions from their cache, all under `{key}/@adv/pub/{session}/{entity}/_`.

A publisher numbers its messages from 0. A number that is skipped, a heartbeat that tells a higher one, or a publisher
that appears, opens a question; it is asked again, less and less often, until the cache has answered. A cache that holds
anything always gives its newest message at least, so an empty answer is none: it was lost, or the router did not know
the cache yet. Only of a publisher of which nothing was heard, an empty answer may also be true; so that question is
given up sooner.
"""

import functools
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import zenoh
from zenoh import ext

from shared.clock import monotonic_s
from shared.runtime.attachment import other_key

AT_ONCE_S = 0.0
ON_ITS_WAY_S = 0.05
"""Of a number told by a heartbeat: messages come by another thread, and may be put away a little later."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.1, 1.0
PATIENCE_S = 20.0
"""How long a hole may keep back what came after it; a router's restart on a busy machine takes some seconds."""
MOST_HELD = 1000
"""As many as a publisher's cache holds: then it could not fill the hole any more."""
BEYOND_CACHE = 3
"""Answers that begin later than what is awaited, until it is taken for not kept: one may have lost its beginning.
Likewise those that end before a number that heartbeats alone have told, until that is taken for another publisher's."""
FAR_AHEAD = 1_000_000
"""Numbers that no publisher goes through between two that are heard. Believed, such a one would be waited for, and all
that follows would pass for old. After links broke, Zenoh has taken parts of other messages for numbers."""
NOTHING_KNOWN_S = 6.0
"""After so long of empty answers, a publisher of which nothing was heard has published nothing."""


@dataclass
class SourceOrder:
    """The messages of one publisher.

    Fields:
        lossless: whether a message waits until those before it have come; otherwise only what is newer counts.
        missed: numbers that were given up.
    """

    lossless: bool = True
    missed: int = 0
    _delivered: int | None = None
    _newest: int = -1
    _held: dict[int, Any] = field(default_factory=dict[int, Any])
    _opened_s: float | None = None
    _due_s: float = 0.0
    _pause_s: float = FIRST_PAUSE_S
    _asking: bool = False
    _lacking: int = 0
    _untrue: int = 0
    _doubted: int | None = None

    def appeared(self, now_s: float) -> None:
        """The publisher is there, or is there again: what it has sent meanwhile is to be asked for."""
        self._open(now_s, AT_ONCE_S, anew=True)

    def told(self, number: int, now_s: float) -> None:
        """A heartbeat told the number of the newest message."""
        if not self._is_believed(number):
            return
        if number > self._last:
            self._open(now_s, ON_ITS_WAY_S, anew=self._newest < 0)
        self._newest = max(self._newest, number)

    def came(self, number: int, message: Any, now_s: float) -> list[Any]:
        """A message came; those that are to be handed over now, in order.

        What is not believed is asked for, as any that is missing, once the next one has come.
        """
        if not self._is_believed(number):
            return []
        first_of_all, self._newest = self._newest < 0, max(self._newest, number)
        if number <= self._last:
            return []
        self._held[number] = message
        ready = self._ready()
        if self._last >= self._newest:
            # it follows on what was there before, so nothing is missing in between
            self._opened_s = None
        else:
            self._open(now_s, AT_ONCE_S, anew=first_of_all)
        return ready + (self._given_up() if len(self._held) > MOST_HELD else [])

    def due(self, now_s: float) -> float | None:
        """Seconds until the cache is to be asked, 0 for now; None where there is nothing to ask."""
        return None if self._opened_s is None or self._asking else max(0.0, self._due_s - now_s)

    def question(self) -> str:
        """What to ask the cache for; `answered` must follow."""
        self._asking = True
        return "" if self._delivered is None else f"_sn={self._delivered}.."

    def answered(self, answer: Iterable[tuple[int, Any]], now_s: float) -> list[Any]:
        """All that the cache gave, numbered; those that are to be handed over now, in order."""
        self._asking, given = False, {number: message for number, message in answer if self._is_believed(number)}
        self._held |= {number: given[number] for number in given if number > self._last}
        if given and self._delivered is None:
            # earlier ones are kept by nobody, and were sent before anybody listened here
            self._delivered = min(self._held) - 1
        self._newest = max(self._newest, *given, -1)
        ready = self._ready()
        if given and self._held and min(given) > self._last + 1:
            self._lacking += 1
            if self._lacking >= BEYOND_CACHE:
                ready += self._skip_hole()
        if given:
            self._compare_with_heartbeats()
        if self._opened_s is None or (given and self._last >= self._newest):
            self._opened_s = None
        elif now_s - self._opened_s > (PATIENCE_S if self._newest >= 0 else NOTHING_KNOWN_S):
            ready += self._given_up()
        else:
            self._due_s, self._pause_s = now_s + self._pause_s, min(2 * self._pause_s, LONGEST_PAUSE_S)
        return ready

    def _compare_with_heartbeats(self) -> None:
        """A cache has each message before a heartbeat tells its number, so it must give what was told."""
        reached = max(self._held, default=self._last)
        self._untrue = self._untrue + 1 if reached < self._newest else 0
        if self._untrue >= BEYOND_CACHE:
            self._newest, self._untrue = reached, 0

    def _is_believed(self, number: int) -> bool:
        """Whether a number may be next to those before, or has been told by another one near it."""
        far = self._newest >= 0 and number > self._newest + FAR_AHEAD
        believed = not far or (self._doubted is not None and 0 < abs(number - self._doubted) <= FAR_AHEAD)
        self._doubted = number if far else self._doubted
        return believed

    @property
    def is_idle(self) -> bool:
        """Whether nothing is awaited."""
        return self._opened_s is None and not self._asking

    @property
    def _last(self) -> int:
        return -1 if self._delivered is None else self._delivered

    def _open(self, now_s: float, after_s: float, anew: bool = False) -> None:
        if self._opened_s is None or anew:
            self._opened_s, self._pause_s, self._due_s = now_s, FIRST_PAUSE_S, now_s + after_s

    def _ready(self) -> list[Any]:
        """What follows on what was handed over; of states all that is newer, for what lies between is no loss."""
        ready: list[Any] = []
        while self._last + 1 in self._held if self.lossless else self._held:
            self._delivered = min(self._held)
            ready.append(self._held.pop(self._delivered))
        if ready:
            self._lacking = 0
        return ready

    def _skip_hole(self) -> list[Any]:
        first = min(self._held)
        self.missed += first - self._last - 1
        self._delivered = first - 1
        return self._ready()

    def _given_up(self) -> list[Any]:
        """What is held, though something before it never came; that is missed."""
        ready: list[Any] = []
        while self._held:
            ready += self._skip_hole()
        if self.lossless:
            self.missed += self._newest - self._last
        self._delivered, self._opened_s = (self._newest if self._newest >= 0 else None), None
        return ready


PUBLISHERS, NO_METADATA = "@adv/pub", "_"
ANSWER_WAIT_S = 2.0
ENDS_S = 5.0
MOST_SOURCES = 1000
"""Publishers of which is known how far they were heard; of more, those are forgotten that nothing is awaited from."""

_Place = tuple[str, str, int]
"""Of a publisher: its key, and the session and entity that it is."""


class LosslessSubscriber:
    """Hands over each message of each publisher once and in order, and says how many it had to give up."""

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        lossless: bool,
        most: int,
        receive: Callable[[zenoh.Sample], None],
        missed: Callable[[int], None],
        refused: Callable[[str, str], None],
    ) -> None:
        """The last three are called from other threads, one at a time, and must only put things away.

        `most` are asked for of what was sent before anybody listened here; where not `lossless`, only what is newer
        than anything before counts.
        """
        self._session, self._lossless, self._history = session, lossless, f"_max={most}"
        self._receive, self._missed, self._refused = receive, missed, refused
        self._sources: dict[_Place, SourceOrder] = {}
        self._changed, self._ended = threading.Condition(), False
        self._questions = zenoh.CancellationToken()
        about = f"{key}/{PUBLISHERS}/**"
        self._declared = (
            session.declare_subscriber(key, self._came),
            session.declare_subscriber(about, self._told),
            session.liveliness().declare_subscriber(about, self._appeared, history=True),
        )
        self._thread = threading.Thread(target=self._ask, name=f"recover {key}", daemon=True)
        self._thread.start()

    def undeclare(self) -> None:
        """End it: a thread that is still inside Zenoh when the interpreter ends aborts the process."""
        for declared in self._declared:
            declared.undeclare()
        with self._changed:
            self._ended = True
            self._changed.notify()
        self._questions.cancel()
        self._thread.join(ENDS_S)

    def _came(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        if named := other_key(sample.encoding, key):
            # its number is one in another key's sequence
            self._refused(key, named)
            return
        info = sample.source_info
        if info is None:
            # a foreign publisher that numbers nothing, and of which nothing can be asked
            self._receive(sample)
            return
        place = key, str(info.source_id.zid), info.source_id.eid
        with self._changed:
            source = self._source(place)
            self._hand_over(source, source.came(info.source_sn, sample, monotonic_s()))

    def _told(self, sample: zenoh.Sample) -> None:
        place = _place_of(str(sample.key_expr))
        try:
            number = ext.z_deserialize(ext.UInt32, sample.payload)
        except ext.ZDeserializeError:
            return
        if place is not None:
            with self._changed:
                self._source(place).told(int(number), monotonic_s())
                self._changed.notify()

    def _appeared(self, sample: zenoh.Sample) -> None:
        place = _place_of(str(sample.key_expr))
        if place is not None and sample.kind == zenoh.SampleKind.PUT:
            with self._changed:
                self._source(place).appeared(monotonic_s())
                self._changed.notify()

    def _source(self, place: _Place) -> SourceOrder:
        if place not in self._sources:
            if len(self._sources) >= MOST_SOURCES:
                self._sources = {of: source for of, source in self._sources.items() if not source.is_idle}
            self._sources[place] = SourceOrder(self._lossless)
        return self._sources[place]

    def _hand_over(self, source: SourceOrder, ready: list[zenoh.Sample]) -> None:
        for sample in ready:
            self._receive(sample)
        if source.missed:
            count, source.missed = source.missed, 0
            self._missed(count)
        if not source.is_idle:
            self._changed.notify()

    def _ask(self) -> None:
        """Ask for what is missing whenever it is due, without waiting for answers."""
        with self._changed:
            while not self._ended:
                now_s = monotonic_s()
                waits = [(source.due(now_s), place) for place, source in self._sources.items()]
                for place in [place for wait_s, place in waits if wait_s == 0.0]:
                    self._question(place, self._sources[place])
                self._changed.wait(min((wait_s for wait_s, _ in waits if wait_s), default=None))

    def _question(self, place: _Place, source: SourceOrder) -> None:
        key, of_session, entity = place
        answer: list[tuple[int, zenoh.Sample]] = []
        self._session.get(
            f"{key}/{PUBLISHERS}/{of_session}/{entity}/**?{source.question() or self._history}",
            zenoh.handlers.Callback(
                functools.partial(_note, place, answer), functools.partial(self._answered, source, answer)
            ),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            accept_replies=zenoh.ReplyKeyExpr.ANY,
            timeout=ANSWER_WAIT_S,
            cancellation_token=self._questions,
        )

    def _answered(self, source: SourceOrder, answer: list[tuple[int, zenoh.Sample]]) -> None:
        with self._changed:
            if not self._ended:
                self._hand_over(source, source.answered(answer, monotonic_s()))
                self._changed.notify()


def is_of(place: _Place, sample: zenoh.Sample) -> bool:
    """Whether a numbered sample is of the publisher whose cache was asked, and names no other key."""
    of, key = sample.source_info, str(sample.key_expr)
    told = None if of is None else (key, str(of.source_id.zid), of.source_id.eid)
    return told == place and not other_key(sample.encoding, key)


def _note(place: _Place, answer: list[tuple[int, zenoh.Sample]], reply: zenoh.Reply) -> None:
    given = reply.ok
    if given is not None and given.source_info is not None and is_of(place, given):
        answer.append((given.source_info.source_sn, given))


def _place_of(key: str) -> _Place | None:
    """The publisher that tells something under this key; None for any other key.

    After a link to the router broke, messages of other topics have come under such a key with theirs behind it.
    """
    of, _, rest = key.partition(f"/{PUBLISHERS}/")
    of_session, _, rest = rest.partition("/")
    entity, _, rest = rest.partition("/")
    return (of, of_session, int(entity)) if entity.isdigit() and rest == NO_METADATA else None
