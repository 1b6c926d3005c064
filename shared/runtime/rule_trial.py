"""Whether a rig's access rules hold, by trying: what a certificate must not say arrives nowhere, what it may say does.

All is tried under keys that end in `doctor`, which nobody listens to and no agent answers. A router denies silently, so
a listener on a session of its own tells; nothing is concluded from silence before what is allowed has arrived there.
Chunks that begin with @, where histories lie, have rules of their own and are tried too.
"""

import os
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from schemas.topics import MAIN, ROOT, SET, key
from shared.clock import monotonic_s
from shared.runtime.commands import STATUS
from shared.runtime.session import Session

TRIAL = "doctor"
"""The last part of the keys under which is tried."""
HISTORY = f"{TRIAL}/@adv/{TRIAL}"
ARRIVES_WITHIN_S, TURN_S = 3.0, 0.05
ANSWER_WAIT_S = 1.0
WAYS = {"message": TRIAL, "message of a history": HISTORY}


@dataclass(frozen=True)
class Trial:
    """What came of trying with one certificate.

    Fields:
        arrived: whether all that is allowed arrived; where it did not, nothing is known of the rest.
        leaked: what arrived though it must not, such as `message under camera/main`.
        denied: how many ways were tried and led nowhere.
    """

    arrived: bool
    leaked: tuple[str, ...]
    denied: int


def try_rules(trier: Session, listener: Session, rig: str, own: str, others: Iterable[str]) -> Trial:
    """Publish, answer and be present in others' place, and in one's own; roots are `kind/instance`."""
    others = tuple(others)
    ways = (_published(trier, listener, rig, (own, *others)), *_told(trier, listener, rig, (own, *others)))
    arrived = all((way, own) in came for came, names in ways for way in names)
    leaked = [f"{way} under {root}" for came, _ in ways for way, root in sorted(came) if root != own]
    tried = len(others) * sum(len(names) for _, names in ways)
    return Trial(arrived, tuple(leaked), tried - len(leaked))


def try_command(session: Session, rig: str, root: str) -> bool:
    """Whether a command of this session reaches an agent: it is asked what became of an id that never was."""
    kind, instance = root.split("/")
    asked = f"{key(rig, SET, instance or MAIN, kind)}?{STATUS}={TRIAL}"
    return any(reply.ok is not None for reply in session.get(asked, timeout=ANSWER_WAIT_S))


Came = set[tuple[str, str]]


def _published(trier: Session, listener: Session, rig: str, roots: tuple[str, ...]) -> tuple[Came, tuple[str, ...]]:
    """What arrives of messages under each root; the first root is one's own."""
    mark, came = os.urandom(8), Came()

    def hear(sample: Any) -> None:
        # another doctor may be trying at this moment
        if sample.payload.to_bytes() == mark:
            _, _, kind, instance, *rest = str(sample.key_expr).split("/")
            came.add(("message" if rest == [TRIAL] else "message of a history", f"{kind}/{instance}"))

    kept = [listener.declare_subscriber(f"{ROOT}/{rig}/*/*/{tail}", hear) for tail in WAYS.values()]
    own = {(way, roots[0]) for way in WAYS}

    def say() -> bool:
        # what is one's own comes last, so that all else had its time when it has arrived
        for root in reversed(roots):
            for tail in WAYS.values():
                trier.put(f"{ROOT}/{rig}/{root}/{tail}", mark)
        return own <= came

    _repeat(say)
    for declared in kept:
        declared.undeclare()
    return came, tuple(WAYS)


def _told(
    trier: Session, listener: Session, rig: str, roots: tuple[str, ...]
) -> Iterable[tuple[Came, tuple[str, ...]]]:
    """Whose history is answered, and whose presence is seen."""
    mark = os.urandom(8)

    def answer(query: Any) -> None:
        query.reply(query.key_expr, mark)
        query.drop()

    keys = {root: f"{ROOT}/{rig}/{root}/{HISTORY}" for root in reversed(roots)}
    kept = [trier.declare_queryable(own, answer) for own in keys.values()]
    kept += [trier.liveliness().declare_token(f"{ROOT}/{rig}/{root}/{TRIAL}") for root in keys]

    def answered(root: str) -> bool:
        replies = listener.get(keys[root], timeout=ANSWER_WAIT_S)
        return any(reply.ok is not None and reply.ok.payload.to_bytes() == mark for reply in replies)

    def present(root: str) -> bool:
        replies = listener.liveliness().get(f"{ROOT}/{rig}/{root}/{TRIAL}", timeout=ANSWER_WAIT_S)
        return any(reply.ok is not None for reply in replies)

    found: list[tuple[Came, tuple[str, ...]]] = []
    for way, seen in (("answer to a history", answered), ("presence", present)):
        _repeat(lambda seen=seen: seen(roots[0]))
        found.append(({(way, root) for root in roots if seen(root)}, (way,)))
    for declared in kept:
        declared.undeclare()
    return found


def _repeat(attempt: Callable[[], bool]) -> None:
    """Until it succeeds, for a while."""
    deadline_s, turn = monotonic_s() + ARRIVES_WITHIN_S, threading.Event()
    while not attempt() and monotonic_s() < deadline_s:
        turn.wait(TURN_S)
