"""Messages become entities: thinned, decoded, mapped and counted, one after the other."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from agents.viewer.entity import BY_FRAME, Entity, Moment, Thinning
from agents.viewer.layout import DEFAULT, Scene, live_layout
from agents.viewer.live_mapping import LiveMapping
from agents.viewer.session_mapping import (
    Arrivals,
    StageTimes,
    count_entities,
    failure,
    latency_entities,
    nothing_yet,
    pace,
    said,
)
from agents.viewer.sinks import Sink
from schemas.codec import decode, decode_stamp
from schemas.messages import FrameStamp, Status, ThreadReconstruction
from shared.runtime.taps import Tapped

RECORDING = "recording"
COUNTS_EVERY_NS = 1_000_000_000

OWN_TIMES = ("at_ns", "measured_ns", "received_ns", "now_ns")
"""What messages that descend from no frame call their time."""


class Showing:
    """Shows messages by way of `to_sinks`, which has something done to every stream."""

    def __init__(
        self,
        to_sinks: Callable[[Callable[[Sink], None]], None],
        layout: str = DEFAULT,
        thin: bool = True,
        told: Sequence[str] = (),
    ) -> None:
        """Begin in the layout of that name; `thin` leaves out what is faster than an eye can follow.

        `told` are sentences about the session, which are shown with its first message.
        """
        self._to_sinks = to_sinks
        self._mapping, self._thinning = LiveMapping(), Thinning() if thin else None
        self._stages, self._arrivals = StageTimes(), Arrivals()
        self._layout = layout
        self._laid_out: Scene | None = None
        self.shown: Counter[str] = Counter()
        self.thinned: Counter[str] = Counter()
        self.unreadable: Counter[str] = Counter()
        self._told, self._begun = told, False
        self._latest_ns = 0
        self._counted_ns = 0

    def show(self, tapped: Tapped, received_ns: int | None = None, counted: bool = True) -> None:
        """Show one message that was received then, or count why not; a file repeats some that are none of its own."""
        topic = str(tapped.topic)
        published_ns = tapped.beside.published_ns if tapped.beside else self._latest_ns
        if received_ns is not None and tapped.beside:
            self._log(Moment(published_ns), self._arrivals.count(tapped.key, published_ns, received_ns))
        try:
            shown = self._show(tapped, published_ns)
        except Exception as error:
            # whatever a message holds, the next one is to be shown; a viewer that ends shows nothing
            self.unreadable[topic] += 1
            # a flood of them is not to fill the log
            if (count := self.unreadable[topic]) & (count - 1) == 0:
                self._log(Moment(self._latest_ns), [failure(tapped.key, str(error), count)])
            return
        (self.shown if shown else self.thinned)[topic] += counted

    def give_room(self, there_is_room: bool) -> None:
        """Show fewer frames where the machine is full, and as many as before where it has room again; and say so."""
        if self._thinning is not None:
            self._thinning.there_is_room = there_is_room
            self._log(Moment(self._latest_ns), [pace(there_is_room)])

    def count(self, dropped: dict[str, int], at_least_every_ns: int = COUNTS_EVERY_NS) -> None:
        """Log what became of messages, if that has not been done for so long."""
        if abs(self._latest_ns - self._counted_ns) < at_least_every_ns:
            return
        self._counted_ns = self._latest_ns
        counts = {"dropped": dropped, "thinned": self.thinned, "unreadable": self.unreadable}
        entities = [entity for what, by_topic in counts.items() for entity in count_entities(what, by_topic)]
        self._log(Moment(self._latest_ns), entities)

    def _show(self, tapped: Tapped, published_ns: int) -> bool:
        message: Any = None
        at_ns = published_ns
        if tapped.topic in BY_FRAME:
            stamp = decode_stamp(tapped.topic.message, tapped.payload)
            if stamp is None:
                message = decode(tapped.topic.message, tapped.payload)
                stamp = message.stamp
            # of the frames that are left out too: what is made of them need not be
            self._saw(tapped, stamp.sequence, published_ns)
            at_ns = stamp.capture_left_ns
        if self._thinning is not None and not self._thinning.keeps(tapped.topic, tapped.key, at_ns):
            return False
        if message is None:
            message = decode(tapped.topic.message, tapped.payload)
        moment = moment_of(message, published_ns)
        entities = self._mapping.entities(message)
        if moment.frame is not None and tapped.beside:
            stage_ms = self._saw(tapped, moment.frame, published_ns)
            entities += latency_entities(tapped.topic, moment.capture_ns, tapped.beside, stage_ms)
        if isinstance(message, ThreadReconstruction) and message.status is Status.OK:
            self._lay_out()
        if not self._begun:
            self._begun = True
            entities += [*nothing_yet(), *(said(RECORDING, sentence) for sentence in self._told)]
        self._log(moment, entities)
        # not the latest of all: a single time in the far future must not end the counting
        self._latest_ns = published_ns if tapped.beside else moment.capture_ns
        return True

    def _saw(self, tapped: Tapped, frame: int, published_ns: int) -> float | None:
        """Note when a stage published its result; milliseconds since its input was published, where that is known."""
        return self._stages.saw(tapped.topic, frame, published_ns) if tapped.beside else None

    def _lay_out(self) -> None:
        """Make room for what this session has, where that is more than before."""
        scene = self._mapping.scene
        has = replace(scene, middle_camera=None)
        if has != self._laid_out:
            self._laid_out = has
            layout = live_layout(self._layout, scene)
            self._to_sinks(lambda sink: sink.lay_out(layout))

    def _log(self, moment: Moment, entities: list[Entity]) -> None:
        if entities:
            self._to_sinks(lambda sink: sink.log(moment, entities))


def moment_of(message: Any, published_ns: int) -> Moment:
    """When something was so: when its frame was seen, or its own time, or when it was published."""
    stamp = getattr(message, "stamp", None)
    if isinstance(stamp, FrameStamp):
        return Moment(stamp.capture_left_ns, stamp.sequence)
    return Moment(next((getattr(message, name) for name in OWN_TIMES if hasattr(message, name)), published_ns))
