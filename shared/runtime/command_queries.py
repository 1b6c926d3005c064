"""Queries that carry commands, put away for the agent's loop; what asks for an outcome is answered at once.

A command that stops an arm stops it here and now, from Zenoh's thread, and goes before all others in the loop, which
answers it. Where many of those wait already, nothing more could follow from another one: it is answered at once.
"""

import logging
from collections.abc import Callable

import zenoh

from schemas.codec import encode
from schemas.messages import CommandAnswer, Outcome
from schemas.topics import Topic
from shared.runtime.commands import STATUS, Answered, accepted, id_of, stops_unread
from shared.runtime.inbox import Arrival, Inbox
from shared.runtime.own_key import encoding_of, other_key

STOPS_WAITING = 8
"""Commands that stop, of several people say, of which each is stepped and written down by itself."""
LOG = logging.getLogger("suturegrasp.commands")


def taking(
    topic: Topic, inbox: Inbox, answered: Answered, halt: Callable[[], None] = lambda: None
) -> Callable[[zenoh.Query], None]:
    """What a queryable of a command does with a query; it is called from Zenoh's threads, one query after another.

    `halt` stops what the agent moves at once.
    """

    def take(query: zenoh.Query) -> None:
        key = str(query.key_expr)

        def answer(reply: CommandAnswer) -> None:
            query.reply(query.key_expr, encode(reply), encoding=encoding_of(CommandAnswer, key))
            query.drop()

        asked = query.parameters.get(STATUS)
        if asked:
            unknown = CommandAnswer(asked, Outcome.UNKNOWN, "unknown_id", "no command of this id was carried out here")
            answer(answered.recall(asked) or unknown)
            return
        payload = query.payload.to_bytes() if query.payload is not None else b""
        arrival = Arrival(topic, key, lambda: payload, b"", answer, other_key(query.encoding, key))
        if not stops_unread(topic, payload):
            inbox.put(arrival)
            return
        try:
            halt()
        except Exception:
            LOG.exception("%s could not be halted at once; its loop holds it next", key)
        if arrival.named:
            # meant for another arm, which its sender has to tell again; this one stands too, which harms nobody
            inbox.put(arrival)
        elif not inbox.put_first(arrival, STOPS_WAITING):
            answer(accepted(id_of(topic.message, payload)))

    return take
