"""Queries that carry commands, put away for the agent's loop; what asks for an outcome is answered at once."""

from collections.abc import Callable

import zenoh

from schemas.codec import encode
from schemas.messages import CommandAnswer, Outcome
from schemas.topics import Topic
from shared.runtime.commands import STATUS, Answered
from shared.runtime.inbox import Arrival, Inbox
from shared.runtime.own_key import encoding_of, other_key


def taking(topic: Topic, inbox: Inbox, answered: Answered) -> Callable[[zenoh.Query], None]:
    """What a queryable of a command does with a query; it is called from Zenoh's threads, one query after another."""

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
        inbox.put(Arrival(topic, key, lambda: payload, b"", answer, other_key(query.encoding, key)))

    return take
