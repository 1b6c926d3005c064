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


@pytest.mark.parametrize("name", NAMES)
def test_each_certificate_sends_what_is_its_own_and_reads_its_rig(name):
    rules, wrong = Rules(), []
    for (key, *about), message in itertools.product(keys("lab"), EVERY):
        if rules.allow(name, "ingress", message, key) != may_send(name, message, *about):
            wrong.append((message, key))
    assert wrong == []


@pytest.mark.parametrize("name", NAMES)
def test_each_certificate_is_told_all_of_its_rig(name):
    rules = Rules()
    denied = [
        (m, key) for (key, *_), m in itertools.product(keys("lab"), EVERY) if not rules.allow(name, "egress", m, key)
    ]
    assert denied == []


@pytest.mark.parametrize("name", NAMES)
def test_nothing_of_another_rig_or_of_none_passes(name):
    rules = Rules()
    beside = ("suturegrasp/laboratory/camera/main/frames", "elsewhere", "@/router/local", "**", "suturegrasp/**")
    outside = (*(key for key, *_ in keys("other")), *beside)
    tried = itertools.product(outside, ("ingress", "egress"), EVERY)
    assert [one for one in tried if rules.allow(name, one[1], one[2], one[0])] == []


@pytest.mark.parametrize("name", NAMES)
def test_no_message_for_many_keys_speaks_for_more_than_its_own(name):
    rules = Rules()
    wide = ("**", "*/*/frames", "*/main/**", "camera/*/log", "robot_bridge/*/state", "*/*/*/@adv/**")
    wide = [f"suturegrasp/lab/{tail}" for tail in wide]
    assert [(m, key) for m, key in itertools.product(OUTGOING, wide) if rules.allow(name, "ingress", m, key)] == []


def test_who_has_no_rules_sends_and_hears_nothing():
    rules = Rules()
    assert rules.told["enabled"] is True and rules.told["default_permission"] == "deny"
    assert {subject["id"]: subject["cert_common_names"] for subject in rules.told["subjects"]} == {
        n: [n] for n in NAMES
    }
    for (key, *_), flow, message in itertools.product(keys("lab"), ("ingress", "egress"), EVERY):
        assert not rules.allow("simulator.main", flow, message, key)


READS, READ = Sites(("tls/10.0.0.1:7447",), reads=("north",)), Sites(read_by_others=True)


@pytest.mark.parametrize("name", NAMES)
def test_of_a_site_that_is_read_each_certificate_hears_all_and_sends_only_to_read_it(name):
    rules = Rules(READS)
    for (key, _, _, _, history), message in itertools.product(keys("north"), EVERY):
        reads = message in READING or (message == "query" and bool(history))
        attends = message == "liveliness_token" and history == RECOVERY
        assert rules.allow(name, "ingress", message, key) == (reads or attends), (message, key)
        assert rules.allow(name, "egress", message, key), (message, key)
    third = itertools.product((key for key, *_ in keys("south")), ("ingress", "egress"), EVERY)
    assert not any(rules.allow(name, flow, message, key) for key, flow, message in third)


@pytest.mark.parametrize(("sites", "own", "told"), [(READS, False, True), (READ, True, False)])
def test_the_router_of_another_site_is_told_a_rig_that_it_may_read_and_speaks_for_the_one_that_is_read(
    sites, own, told
):
    rules = Rules(sites)
    for rig, may_read in (("lab", own), ("north", told), ("south", False)):
        for (key, _, _, _, history), message in itertools.product(keys(rig), EVERY):
            asks = message in READING or (message == "query" and bool(history))
            attends = message == "liveliness_token" and history == RECOVERY
            speaks = message in OUTGOING
            # a router asks for what it reads, and is told it; where it is read itself, the other way round
            heard, said = (speaks, asks or attends) if rig == "north" else (asks or attends, speaks)
            assert rules.allow("router.main", "ingress", message, key) == (may_read and heard), (message, key)
            assert rules.allow("router.main", "egress", message, key) == (may_read and said), (message, key)
