"""The access rules by themselves: who may say what on which key, against the policy told in other words.

Zenoh lets a message pass where a rule's key expression includes that of the message; its own matching is asked here.
What the rules do on a real router, `test_access.py` tries.
"""

import functools
import itertools

import pytest
import zenoh

from schemas.topics import ANY_AGENT, TOPICS, Delivery
from shared.runtime.access import Sites, access_control

NAMES = ("camera.main", "perception.main", "tool_tracker.psm1", "planner.main", "robot_bridge.psm1",
         "robot_bridge.psm2", "guard.psm1", "recorder.desk", "viewer.desk", "operator.desk",
         "operator.strong")  # fmt: skip
KINDS = sorted({name.split(".")[0] for name in NAMES} | {"simulator", "router", "replay"})
INSTANCES = ("main", "psm1", "psm2", "desk", "strong")
OUTGOING = ("put", "delete", "reply", "declare_queryable", "liveliness_token")
READING = ("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query")
EVERY = (*OUTGOING, *READING, "query")
HISTORY, RECOVERY = "@adv/pub/1/2/_", "@adv/sub/1/2/_"
ANSWERS = ("clock", "progress", "facts", "link")
COMMANDS = {t.name: t for t in TOPICS if t.delivery is Delivery.COMMAND}
TOPIC_NAMES = sorted({topic.name for topic in TOPICS})


class Rules:
    """Whether a router with these rules lets a message of a certificate pass."""

    def __init__(self, *sites):
        self.told = access_control("lab", NAMES, *sites)
        self._wide = {}
        by_id = {rule["id"]: rule for rule in self.told["rules"] if rule["permission"] == "allow"}
        for policy in self.told["policies"]:
            for subject, rule in itertools.product(policy["subjects"], (by_id[one] for one in policy["rules"])):
                for passed in itertools.product([subject], rule["flows"], rule["messages"]):
                    self._wide.setdefault(passed, set()).update(rule["key_exprs"])

    def allow(self, name, flow, message, key):
        return any(expression(wide).includes(expression(key)) for wide in self._wide.get((name, flow, message), ()))


expression = functools.cache(zenoh.KeyExpr)


def keys(rig):
    """Of every agent that there might be: its presence, topics, their histories and recovery, and what it answers."""
    for kind, instance in itertools.product(KINDS, INSTANCES):
        root = f"suturegrasp/{rig}/{kind}/{instance}"
        yield root, kind, instance, "", ""
        for topic in (*TOPIC_NAMES, *ANSWERS, "doctor"):
            yield f"{root}/{topic}", kind, instance, topic, ""
        for topic, history in itertools.product(("frames", "log", "plan", "set"), (HISTORY, RECOVERY)):
            yield f"{root}/{topic}/{history}", kind, instance, topic, history


def obeys(name, kind, instance, topic):
    """Whether a command's key is for that certificate to answer."""
    command, (own, _, own_instance) = COMMANDS.get(topic), name.partition(".")
    if command is None or command.agent == ANY_AGENT or kind != command.agent or own != command.receiver:
        return False
    return instance == own_instance if command.per_arm else instance == own_instance == "main"


def is_command(kind, topic):
    command = COMMANDS.get(topic)
    return command is not None and command.agent in (kind, ANY_AGENT)


def may_send(name, message, kind, instance, topic, history):
    """The policy: what a certificate may send to the router about a key of its own rig."""
    own_kind, _, own_instance = name.partition(".")
    own = kind == own_kind and (instance == own_instance or own_kind == "operator")
    if message in READING:
        return True
    if message == "query":
        command = own_kind == "operator" and not history and is_command(kind, topic)
        return bool(history) or topic in ANSWERS or command
    if message == "liveliness_token" and history == RECOVERY:
        return True
    answers = message in ("reply", "declare_queryable") and not history and obeys(name, kind, instance, topic)
    return own or answers


def differing(rules, name, flow, keys, allowed):
    """Messages under keys that pass where they must not, or do not where they must."""
    tried = itertools.product(keys, EVERY)
    return [(m, key) for (key, *about), m in tried if rules.allow(name, flow, m, key) != allowed(m, *about)]


@pytest.mark.parametrize("name", NAMES)
def test_each_certificate_sends_what_is_its_own_and_reads_and_is_told_all_of_its_rig(name):
    rules = Rules()
    assert differing(rules, name, "ingress", keys("lab"), lambda *what: may_send(name, *what)) == []
    assert differing(rules, name, "egress", keys("lab"), lambda *_: True) == []


@pytest.mark.parametrize("name", NAMES)
def test_nothing_of_another_rig_or_of_none_passes_nor_a_message_for_many_keys_of_others(name):
    rules = Rules()
    beside = ("suturegrasp/laboratory/camera/main/frames", "elsewhere", "@/router/local", "**", "suturegrasp/**")
    for flow in ("ingress", "egress"):
        outside = [(key,) for key, *_ in keys("other")] + [(key,) for key in beside]
        assert differing(rules, name, flow, outside, lambda *_: False) == []
    wide = ("**", "*/*/frames", "*/main/**", "camera/*/log", "robot_bridge/*/state", "*/*/*/@adv/**")
    wide = [f"suturegrasp/lab/{tail}" for tail in wide]
    assert [(m, key) for m, key in itertools.product(OUTGOING, wide) if rules.allow(name, "ingress", m, key)] == []


def test_who_has_no_rules_sends_and_hears_nothing():
    rules = Rules()
    assert (rules.told["enabled"], rules.told["default_permission"]) == (True, "deny")
    assert {one["id"]: one["cert_common_names"] for one in rules.told["subjects"]} == {n: [n] for n in NAMES}
    for flow in ("ingress", "egress"):
        assert differing(rules, "simulator.main", flow, keys("lab"), lambda *_: False) == []


def asks(message, history):
    """What is needed to read a rig of another site."""
    return message in READING or (message == "query" and history != "")


def attends(message, history):
    return message == "liveliness_token" and history == RECOVERY


READS, READ = Sites(("tls/10.0.0.1:7447",), reads=("north",)), Sites(read_by_others=True)


@pytest.mark.parametrize("name", NAMES)
def test_of_a_site_that_is_read_each_certificate_hears_all_and_sends_only_to_read_it(name):
    rules = Rules(READS)
    may_send = lambda m, *about: asks(m, about[-1]) or attends(m, about[-1])  # noqa: E731
    assert differing(rules, name, "ingress", keys("north"), may_send) == []
    assert differing(rules, name, "egress", keys("north"), lambda *_: True) == []
    for flow in ("ingress", "egress"):
        assert differing(rules, name, flow, keys("south"), lambda *_: False) == []


@pytest.mark.parametrize(("sites", "own", "told"), [(READS, False, True), (READ, True, False)])
def test_the_router_of_another_site_hears_what_it_may_read_and_speaks_for_what_is_read(sites, own, told):
    rules = Rules(sites)
    reads = lambda m, *about: asks(m, about[-1]) or attends(m, about[-1])  # noqa: E731
    speaks = lambda m, *_: m in OUTGOING  # noqa: E731
    # a router asks for what it reads, and is told it; where it is read itself, the other way round
    for rig, may_read, ways in (("lab", own, (reads, speaks)), ("north", told, (speaks, reads)), ("south", False, ())):
        for flow, may in zip(("ingress", "egress"), ways if may_read else [lambda *_: False] * 2, strict=True):
            assert differing(rules, "router.main", flow, keys(rig), may) == []
