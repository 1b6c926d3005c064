"""The proof of a rig's access rules, by trying with every certificate of this host.

All is tried under keys that end in `doctor`, which nobody listens to and no agent answers. A router denies silently, so
a listener on a session of its own tells; nothing is concluded from silence before what is allowed has arrived there.
"""

import contextlib
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from agents.configuration.hosts import BESIDE, OPERATOR, kind_and_instance
from agents.configuration.reading_session import certificate_names, session_as
from agents.configuration.rig import RigConfig
from agents.diagnostics.doctor.finding import UNKNOWN, Finding
from schemas.topics import MAIN, ROOT, SET, key
from shared.clock import monotonic_s
from shared.runtime.commands import STATUS
from shared.runtime.config import ConfigError
from shared.runtime.connection import NoRouterError, open_when_there
from shared.runtime.session import Session, on_loopback

OPENS_WITHIN_S = 3.0
REMEDY = "run the router with the configuration that suturegrasp deploy plan makes, and look who may have got in"


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


def examine_rules(rig: RigConfig, present: list[str]) -> Iterator[Finding]:
    """Try what each certificate of this host may do and what it may not; `present` are agents, as `kind/instance`."""
    what = "access rules"
    if rig.security is None:
        where = "on this machine alone" if on_loopback(rig.router_endpoint) else rig.router_endpoint
        open_to_all = f"none are in force: the router listens {where}, where every program may speak for every agent"
        yield Finding(what, f"{open_to_all}; that suits one machine whose users trust each other")
        return
    names = certificate_names(rig.security.certificates)
    for name in names:
        # a listener with another certificate, where there is one, is nearer to what other agents hear
        listener = next((other for other in names if other != name), name)
        yield _tried(rig, name, listener, present)


def _tried(rig: RigConfig, name: str, listener: str, present: list[str]) -> Finding:
    what, own = f"access rules for {name}", name.replace(".", "/", 1)
    kind = name.split(".")[0]
    others = [root for root in _roots(rig) if root != own and not root.startswith(f"{OPERATOR}/")]
    agents = [root for root in present if root != own and root.split("/")[0] not in (*BESIDE, "guard")]
    with contextlib.ExitStack() as stack:
        try:
            trier, hearer = (
                stack.enter_context(open_when_there(session_as(rig, n), OPENS_WITHIN_S)) for n in (name, listener)
            )
        except (NoRouterError, ConfigError) as error:
            return Finding(what, f"{UNKNOWN}, for the router was not reached: {error}")
        trial = try_rules(trier, hearer, rig.rig, own, others)
        asked = try_command(trier, rig.rig, agents[0]) if agents else None
    return verdict(what, trial, asked, kind == OPERATOR, agents[0] if agents else "")


def verdict(what: str, trial: Trial, asked: bool | None, may_command: bool, agent: str) -> Finding:
    """What a trial shows; `asked` says whether a command reached the agent, None where none could be tried."""
    if trial.leaked:
        return Finding(what, f"not in force: {', '.join(trial.leaked)} arrived, and must not", REMEDY)
    if asked and not may_command:
        return Finding(what, f"not in force: a command of it reached {agent}, which operators alone may send", REMEDY)
    if not trial.arrived:
        refused = "what it may say did not arrive either, so that nothing is known of what it may not"
        return Finding(what, refused, "is it in the router's rules? make them anew with suturegrasp deploy plan")
    if may_command and asked is False:
        return Finding(what, f"too narrow: no command reached {agent}, which an operator may send", REMEDY)
    own = "what is its own arrived"
    told = {None: "; commands were not tried, for no agent runs", True: ", and so did a command"}.get(asked, "")
    told = "; a command of it was denied" if asked is False else told
    return Finding(
        what, f"in force: {own}{told}; {trial.denied} ways to speak for others were denied, histories included"
    )


def _roots(rig: RigConfig) -> list[str]:
    """Every agent of the rig, as `kind/instance`."""
    if not rig.hosts:
        return ["/".join(kind_and_instance(name)) for name in rig.processes()]
    names = {kind_and_instance(name, host) for host, section in rig.hosts.items() for name in section.runs}
    return sorted("/".join(name) for name in names)


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
