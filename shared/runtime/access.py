"""Who may do what on a rig's router: access rules from the topic table, default deny.

A certificate's common name is `{kind}.{instance}`, such as `camera.main`, `robot_bridge.psm1`, `operator.desk`. Every
certificate of the rig may read all of it. It publishes, and answers, under its own key root alone; a command is
answered by its receiver alone, and asked by operators alone. Chunks that begin with @ are not matched by `**`: the
history and the recovery of states and events have rules of their own.

Routers of other sites have the name `router.main`. Between them goes what is needed to read rigs, and nothing else:
neither commands nor questions, and of other rigs only those that a site says it reads.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from schemas.topics import ANY_AGENT, MAIN, ROOT, TOPICS, Delivery, Topic, key, key_root

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
