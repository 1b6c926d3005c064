"""A real router with mutual TLS and the rig's access rules: what is allowed arrives, what is not does not.

The rules themselves, for every topic and certificate, `test_access_rules.py` tries; here is one topic of each kind.
"""

import contextlib
import datetime
import threading

import pytest

from agents.deployment.certificates import issue
from agents.deployment.layout import ROUTER, Host, Layout, Process
from schemas import topics
from schemas.codec import encode
from schemas.topics import ANY_AGENT, MAIN, key
from shared.clock import now_ns
from shared.runtime.access import access_control
from shared.runtime.commands import accepted
from shared.runtime.connection import NoRouterError, open_when_there
from shared.runtime.delivery import declare_publisher, subscribe
from shared.runtime.identity import identity_in
from shared.runtime.session import SessionSettings, free_local_endpoint, open_router, open_session
from tests.shared.runtime.conftest import beside

RIG, ARM = "lab", "psm1"
PROCESSES = (
    Process(ROUTER), Process("camera"), Process("perception", ARM), Process("planner"), Process("robot_bridge", ARM),
    Process("recorder", "desk"), Process("operator", "desk"), Process("viewer", "desk"),
)  # fmt: skip
CERTIFICATES = [process.common_name for process in PROCESSES[1:]]
LISTENER, OPERATOR = "viewer.desk", "operator.desk"
"""The listener forges nothing: what a session publishes itself, its own subscribers hear without any router."""
NEVER_AFTER_S = 0.1


class Secured:
    """A router with certificates, and whoever connects to it."""

    def __init__(self, folder, stack):
        self.endpoint = free_local_endpoint().replace("tcp/", "tls/")
        self.folder, self._stack, self._sessions = issued(self.endpoint, folder), stack, {}
        access = access_control(RIG, CERTIFICATES)
        stack.enter_context(open_router(self.endpoint, identity_in(self.folder, "router.main"), access))

    def session(self, name):
        if name not in self._sessions:
            settings = SessionSettings(RIG, self.endpoint, identity_in(self.folder, name))
            self._sessions[name] = self._stack.enter_context(open_session(settings))
        return self._sessions[name]


def issued(endpoint, folder):
    """Where the certificates of a layout lie, which an authority of its own has issued below that folder."""
    layout = Layout(RIG, endpoint, (Host("desk", "127.0.0.1", PROCESSES),), 30, 3650)
    issue(layout, folder, datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC))
    return folder / "desk" / "certificates"


@pytest.fixture(scope="module")
def secured(tmp_path_factory):
    with contextlib.ExitStack() as stack:
        yield Secured(tmp_path_factory.mktemp("certificates"), stack)


def key_of(topic):
    return key(RIG, topic, ARM if topic.per_arm else MAIN, "planner" if topic.agent == ANY_AGENT else "")


@pytest.mark.parametrize(
    ("topic", "owner"),
    [
        (topics.FRAMES, "camera.main"),
        (topics.PLAN, "planner.main"),
        (topics.ROBOT_STATE, f"robot_bridge.{ARM}"),
        (topics.HEARTBEAT, OPERATOR),
        (topics.LOG, "planner.main"),
        (topics.CALIBRATION, "camera.main"),
    ],
    ids=str,
)
def test_a_topic_and_its_history_are_heard_from_its_owner_alone(secured, topic, owner, until):
    heard, late, name = [], [], key_of(topic)

    def listen(to):
        return subscribe(secured.session(LISTENER), name, topic, lambda s: to.append(s.payload.to_bytes()), print)

    declared = [listen(heard)]
    for forger in {*CERTIFICATES} - {owner, LISTENER}:
        declared.append(declare_publisher(secured.session(forger), name, topic))
        declared[-1].put(b"forged", attachment=beside())
    declared.append(declare_publisher(secured.session(owner), name, topic))
    until(lambda: declared[-1].put(b"own", attachment=beside()) or b"own" in heard)
    if topic.delivery is not topics.Delivery.LATEST:
        # whoever comes late
        declared.append(listen(late))
        until(lambda: late)
    threading.Event().wait(NEVER_AFTER_S)
    for gone in declared:
        gone.undeclare()
    assert {*heard, *late} == {b"own"}


@pytest.mark.parametrize(
    ("topic", "receiver"),
    [(topics.GOAL, "planner.main"), (topics.HOLD, f"robot_bridge.{ARM}"), (topics.SET, "planner.main")],
    ids=str,
)
def test_a_command_is_obeyed_by_its_receiver_and_asked_by_operators_alone(secured, topic, receiver, until):
    asked, answering, name = [], {}, key_of(topic)

    def answerer(who):
        def answer(query):
            asked.append((who, query.payload.to_bytes()))
            query.reply(query.key_expr, encode(accepted(who)))
            query.drop()

        return answer

    def ask(who, payload):
        list(secured.session(who).get(name, payload=payload, timeout=0.3))
        return asked

    # an operator that could answer would answer for itself alone
    for who in {*CERTIFICATES} - {OPERATOR}:
        answering[who] = secured.session(who).declare_queryable(name, answerer(who), complete=True)
    until(lambda: ask(OPERATOR, b"operator"))
    for who in {*CERTIFICATES} - {OPERATOR, receiver}:
        # its own queryable would answer it within its own process
        answering.pop(who).undeclare()
        ask(who, b"intruder")
    threading.Event().wait(NEVER_AFTER_S)
    answering[receiver].undeclare()
    assert set(asked) == {(receiver, b"operator")}


def test_without_a_certificate_of_the_lab_nobody_gets_in(secured, tmp_path):
    forged = identity_in(issued(secured.endpoint, tmp_path), "camera.main")
    with pytest.raises(NoRouterError):
        open_when_there(SessionSettings(RIG, secured.endpoint, forged), within_s=0.5)
