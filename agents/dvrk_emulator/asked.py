"""What may be asked of an emulated console, beside the topics of CRTK, under `emulator/{arm}/`.

`verdict` is answered with JSON: the oracle's, and when what happened; `request` takes a word of
`EmulatedConsole.request`.
"""

import contextlib
import json
from collections.abc import Generator

import zenoh

from agents.dvrk_emulator.console import EmulatedConsole


@contextlib.contextmanager
def answering(session: zenoh.Session, console: EmulatedConsole) -> Generator[None]:
    """Have a console answer on a session, until the end."""
    own = f"emulator/{console.name}"

    def answer(query: zenoh.Query) -> None:
        query.reply(query.key_expr, json.dumps(console.verdict()))

    kept = (
        session.declare_queryable(f"{own}/verdict", answer),
        session.declare_subscriber(f"{own}/request", lambda sample: console.request(sample.payload.to_string())),
    )
    try:
        yield
    finally:
        for one in kept:
            one.undeclare()
