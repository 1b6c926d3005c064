"""A subscriber that asks publishers' caches for what it has not heard, again and again until they have answered.

Zenoh's own advanced subscriber asks once. On a busy machine that question, or its answer, may come to nothing while the
link of either side has just come back, and the events of the meantime were lost although their publisher still held
them. Publishers are those of `zenoh.ext`: they announce themselves by a token, tell the number of their newest message
in a heartbeat, and answer questions from their cache, all under `{key}/@adv/pub/{session}/{entity}/_`.
"""

import functools
import threading
from collections.abc import Callable

import zenoh
from zenoh import ext

from shared.clock import monotonic_s
from shared.runtime.own_key import other_key
from shared.runtime.recovery import SourceOrder

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
