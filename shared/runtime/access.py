"""Who may do what on a rig's router: access rules from the topic table, default deny; and whether they hold, by trying.

A certificate's common name is `{kind}.{instance}`, such as `camera.main`, `robot_bridge.psm1`, `operator.desk`. Every
certificate of the rig may read all of it. It publishes, and answers, under its own key root alone; a command is
answered by its receiver alone, and asked by operators alone. Chunks that begin with @ are not matched by `**`: the
history and the recovery of states and events have rules of their own.

Routers of other sites have the name `router.main`. Between them goes what is needed to read rigs, and nothing else:
neither commands nor questions, and of other rigs only those that a site says it reads.

All is tried under keys that end in `doctor`, which nobody listens to and no agent answers. A router denies silently, so
a listener on a session of its own tells; nothing is concluded from silence before what is allowed has arrived there.
"""

import os
import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from schemas.topics import ANY_AGENT, MAIN, ROOT, SET, TOPICS, Delivery, Topic, key, key_root
from shared.clock import monotonic_s
from shared.runtime.commands import STATUS
from shared.runtime.session import Session

OPERATOR = "operator"
READING = ("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query")
SPEAKING = ("put", "delete", "reply", "declare_queryable", "liveliness_token")
HEARING = ("put", "delete", "reply", "query", *READING, "declare_queryable", "liveliness_token")
ANSWERS = ("clock", "progress", "facts", "link")
"""What each agent answers under its root, to every certificate of the rig."""
ADVANCED = "@adv/**"
ROUTER = "router.main"
"""The common name of every site's router."""


@dataclass(frozen=True)
class Sites:
    """How a rig's router and the routers of other sites deal with each other.

    Fields:
        connect: endpoints of routers that this one connects to, as Zenoh writes them.
        reads: rigs of other sites that the certificates of this one may read.
        read_by_others: whether the routers of other sites may read this rig.
    """

    connect: tuple[str, ...] = ()
    reads: tuple[str, ...] = ()
    read_by_others: bool = False


ALONE = Sites()


def common_name(kind: str, instance: str = MAIN) -> str:
    """What a certificate of that agent is called."""
    return f"{kind}.{instance}"


def access_control(rig: str, names: Iterable[str], sites: Sites = ALONE) -> dict[str, Any]:
    """Zenoh's `access_control` of a router: what each of these common names may do on that rig, and nothing else.

    Raises:
        ValueError: where a name is not `{kind}.{instance}`.
    """
    unique = sorted(set(names))
    everything = _everything((rig,))
    rules = [
        *_reading("", rig),
        _rule("questions", "ingress", ("query",), [f"{ROOT}/{rig}/*/*/{answer}" for answer in ANSWERS]),
        _rule("hear", "egress", HEARING, everything),
    ]
    policies = [{"rules": [rule["id"] for rule in rules], "subjects": unique}]
    for name in unique:
        own = _own_rules(rig, name)
        rules += own
        policies.append({"rules": [rule["id"] for rule in own], "subjects": [name]})
    for subjects, between in _between_sites(rig, unique, sites):
        rules += between
        policies.append({"rules": [rule["id"] for rule in between], "subjects": subjects})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": name, "cert_common_names": [name]} for name in (*unique, *_routers(sites))],
        "policies": policies,
    }


def _own_rules(rig: str, name: str) -> list[dict[str, Any]]:
    kind, separator, instance = name.partition(".")
    if not (kind and separator and instance):
        raise ValueError(f"{name!r} is no agent; write its kind and instance, such as camera.main")
    root = f"{ROOT}/{rig}/{OPERATOR}/*" if kind == OPERATOR else key_root(rig, instance, kind)
    rules = [_rule(f"speak as {name}", "ingress", SPEAKING, [root, f"{root}/**", f"{root}/*/{ADVANCED}"])]
    if kind == OPERATOR:
        asked = [key(rig, topic, "*", "*" if topic.agent == ANY_AGENT else "") for topic in _commands()]
        rules.append(_rule(f"command as {name}", "ingress", ("query",), asked))
    elif received := _received(rig, kind, instance):
        rules.append(_rule(f"obey as {name}", "ingress", ("declare_queryable", "reply"), received))
    return rules


def _received(rig: str, kind: str, instance: str) -> list[str]:
    """The commands that are for that instance."""
    commands = (t for t in _commands() if t.receiver == kind and (t.per_arm or instance == MAIN))
    return [key(rig, topic, instance) for topic in commands]


def _routers(sites: Sites) -> tuple[str, ...]:
    return (ROUTER,) if sites.reads or sites.read_by_others else ()


def _between_sites(rig: str, names: list[str], sites: Sites) -> Iterable[tuple[list[str], list[dict[str, Any]]]]:
    """Whom further rules are for, and those rules."""
    if sites.read_by_others:
        told = _rule("tell sites", "egress", SPEAKING, _everything((rig,)))
        yield [ROUTER], [*_reading(" by sites", rig), told]
    if sites.reads:
        heard = _everything(sites.reads)
        yield (
            [ROUTER],
            [
                _rule("hear sites", "ingress", SPEAKING, heard),
                *(rule for other in sites.reads for rule in _reading(f" {other} from its site", other, "egress")),
            ],
        )
        yield (
            names,
            [
                *(rule for other in sites.reads for rule in _reading(f" {other}", other)),
                _rule("hear other rigs", "egress", HEARING, heard),
            ],
        )


def _reading(whose: str, rig: str, flow: str = "ingress") -> list[dict[str, Any]]:
    """To subscribe to a rig, and to ask for the history of what was subscribed to."""
    histories = [f"{ROOT}/{rig}/*/*/*/{ADVANCED}"]
    return [
        _rule(f"read{whose}", flow, READING, _everything((rig,))),
        _rule(f"history{whose}", flow, ("query",), histories),
        # a subscriber that recovers what it missed announces itself beside the key that it hears
        _rule(f"attend{whose}", flow, ("liveliness_token",), [f"{ROOT}/{rig}/*/*/*/@adv/sub/**"]),
    ]


def _everything(rigs: Iterable[str]) -> list[str]:
    return [key for rig in rigs for key in (f"{ROOT}/{rig}/**", f"{ROOT}/{rig}/*/*/*/{ADVANCED}")]


def _commands() -> list[Topic]:
    return [topic for topic in TOPICS if topic.delivery is Delivery.COMMAND]


def _rule(name: str, flow: str, messages: Sequence[str], keys: Sequence[str]) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": list(messages), "key_exprs": list(keys)}


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
