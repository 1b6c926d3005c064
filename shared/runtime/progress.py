"""How far consumers have got, told to whoever asks: every agent, and whoever listens to topics without being one.

A replay that goes as fast as its consumers asks after each message, and sends the next one when all has been handled
that follows from it. Answers come at once from Zenoh's threads, not from the loop.
"""

from collections.abc import Callable, Iterable
from typing import Any

import zenoh

from schemas.checks import MessageError
from schemas.codec import decode, encode
from schemas.messages import Consumed, Progress
from shared.runtime.attachment import encoding_of, other_key

PROGRESS = "progress"
"""The last part of the key under which a consumer answers; nothing is published there."""
ANSWER_WAIT_S = 1.0


class Handled:
    """The newest message of each key that a consumer is done with; one thread notes, others read."""

    def __init__(self) -> None:
        self._newest: dict[str, tuple[int, int]] = {}

    def note(self, key: str, epoch: int, sequence: int) -> None:
        """A message is done with, and whatever followed from it has been published."""
        self._newest[key] = epoch, sequence

    def listed(self) -> tuple[Consumed, ...]:
        """What was noted so far."""
        return tuple(Consumed(key, *place) for key, place in dict(self._newest).items())


def answer_progress(
    session: zenoh.Session,
    root: str,
    listens: Iterable[str],
    handled: Handled,
    published: Callable[[], tuple[Consumed, ...]] = lambda: (),
) -> Any:
    """Have it told to whoever asks, under the root of a consumer's keys; keep what is returned."""
    selectors = " ".join(listens)

    def answer(query: zenoh.Query) -> None:
        # what follows from a message is published before it is noted: in this order, nothing that followed is missing
        noted = handled.listed()
        reply = encode(Progress(selectors, noted, published()))
        query.reply(own, reply, encoding=encoding_of(Progress, own))
        query.drop()

    own = f"{root}/{PROGRESS}"
    return session.declare_queryable(own, answer)


def ask_progress(session: zenoh.Session, rig: str) -> dict[str, Progress]:
    """How far every consumer of a rig has got, as `kind/instance`."""
    replies = session.get(
        f"suturegrasp/{rig}/*/*/{PROGRESS}",
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
        timeout=ANSWER_WAIT_S,
    )
    found: dict[str, Progress] = {}
    for reply in replies:
        if reply.ok is not None and not other_key(reply.ok.encoding, str(reply.ok.key_expr)):
            try:
                name = "/".join(str(reply.ok.key_expr).split("/")[2:4])
                found[name] = decode(Progress, reply.ok.payload.to_bytes())
            except MessageError:
                continue
    return found


def matches(selector: str, key: str) -> bool:
    """Whether a key is one of those that a consumer listens to; `*` stands for any one part."""
    ours, theirs = selector.split("/"), key.split("/")
    return len(ours) == len(theirs) and all(a in ("*", b) for a, b in zip(ours, theirs, strict=True))
