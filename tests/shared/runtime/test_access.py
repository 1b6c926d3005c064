"""A real router with mutual TLS and the rig's access rules: what is allowed arrives, what is not does not.

The rules themselves, for every topic and certificate, `test_access_rules.py` tries; here is one topic of each kind.
"""

import contextlib
import datetime
import threading

import pytest

from agents.deployment.certificates import issue
from agents.deployment.layout import ROUTER, Host, Layout, Process
from schemas.codec import encode
from schemas.topics import (
    ANY_AGENT,
    CALIBRATION,
    FRAMES,
    GOAL,
    HEARTBEAT,
    HOLD,
    LOG,
    MAIN,
    PLAN,
    ROBOT_STATE,
    SET,
    key,
    key_root,
)
from shared.clock import now_ns
from shared.runtime.access import access_control
from shared.runtime.attachment import Attachment, pack
from shared.runtime.commands import accepted
from shared.runtime.connection import NoRouterError, open_when_there
from shared.runtime.delivery import declare_publisher, subscribe
from shared.runtime.identity import identity_in
from shared.runtime.session import SessionSettings, free_local_endpoint, open_router, open_session

RIG = "lab"
ARM = "psm1"
PROCESSES = (
    Process(ROUTER), Process("camera"), Process("perception", ARM), Process("planner"), Process("robot_bridge", ARM),
    Process("recorder", "desk"), Process("operator", "desk"), Process("viewer", "desk"),
)  # fmt: skip
CERTIFICATES = [process.common_name for process in PROCESSES[1:]]
LISTENER, OPERATOR = "viewer.desk", "operator.desk"
"""The listener forges nothing: what a session publishes itself, its own subscribers hear without any router."""
NEVER_AFTER_S = 0.1
BESIDE = pack(Attachment(1, 0, 0, 0.0))


class Secured:
    """A router with certificates, and whoever connects to it."""

    def __init__(self, folder, stack):
        self.endpoint = free_local_endpoint().replace("tcp/", "tls/")
        layout = issued(self.endpoint, folder)
        self.folder = folder / "desk" / "certificates"
        self._stack, self._sessions = stack, {}
        access = access_control(RIG, layout.common_names())
        stack.enter_context(open_router(self.endpoint, identity_in(self.folder, "router.main"), access))

    def session(self, name):
        if name not in self._sessions:
            settings = SessionSettings(RIG, self.endpoint, identity_in(self.folder, name))
            self._sessions[name] = self._stack.enter_context(open_session(settings))
        return self._sessions[name]


def issued(endpoint, folder):
    """A layout of which the certificates, of an authority of its own, lie in that folder."""
    layout = Layout(RIG, endpoint, (Host("desk", "127.0.0.1", PROCESSES),), 30, 3650)
    issue(layout, folder, datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC))
    return layout


@pytest.fixture(scope="module")
def secured(tmp_path_factory):
    with contextlib.ExitStack() as stack:
        yield Secured(tmp_path_factory.mktemp("certificates"), stack)


@pytest.mark.parametrize(
    ("topic", "owner"),
    [
        (FRAMES, "camera.main"),
        (PLAN, "planner.main"),
        (ROBOT_STATE, f"robot_bridge.{ARM}"),
        (HEARTBEAT, OPERATOR),
        (LOG, "planner.main"),
    ],
    ids=str,
)
def test_a_topic_is_heard_from_its_owner_alone(secured, topic, owner, until):
    heard = []
    name = key(RIG, topic, ARM if topic.per_arm else MAIN, "planner" if topic.agent == ANY_AGENT else "")
    declared = subscribe(secured.session(LISTENER), name, topic, lambda s: heard.append(bytes(s.payload)), print)
    for forger in set(CERTIFICATES) - {owner, LISTENER}:
        declared.append(declare_publisher(secured.session(forger), name, topic))
        declared[-1].put(b"forged", attachment=BESIDE)
    declared.append(declare_publisher(secured.session(owner), name, topic))
    until(lambda: declared[-1].put(b"own", attachment=BESIDE) or b"own" in heard)
    threading.Event().wait(NEVER_AFTER_S)
    for gone in declared:
        gone.undeclare()
    assert set(heard) == {b"own"}


@pytest.mark.parametrize(("topic", "owner"), [(CALIBRATION, "camera.main"), (PLAN, "planner.main")], ids=str)
def test_whoever_comes_late_is_told_the_history_by_its_owner_alone(secured, topic, owner, until):
    name, heard = key(RIG, topic), []
    forger, own = (declare_publisher(secured.session(who), name, topic) for who in (f"perception.{ARM}", owner))
    for publisher, said in ((forger, b"forged"), (own, b"own")):
        publisher.put(said, attachment=BESIDE)
    late = subscribe(secured.session(LISTENER), name, topic, lambda s: heard.append(bytes(s.payload)), print)
    until(lambda: heard)
    threading.Event().wait(NEVER_AFTER_S)
    for gone in (forger, own, *late):
        gone.undeclare()
    assert heard == [b"own"]


@pytest.mark.parametrize(
    ("topic", "receiver"),
    [(GOAL, "planner.main"), (HOLD, f"robot_bridge.{ARM}"), (SET, "planner.main")],
    ids=str,
)
def test_a_command_is_obeyed_by_its_receiver_and_asked_by_operators_alone(secured, topic, receiver, until):
    name = key(RIG, topic, ARM if topic.per_arm else MAIN, "planner" if topic.agent == ANY_AGENT else "")
    asked, answering = [], {}

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
    for who in set(CERTIFICATES) - {OPERATOR}:
        answering[who] = secured.session(who).declare_queryable(name, answerer(who), complete=True)
    until(lambda: ask(OPERATOR, b"operator"))
    for who in set(CERTIFICATES) - {OPERATOR, receiver}:
        # its own queryable would answer it within its own process
        answering.pop(who).undeclare()
        ask(who, b"intruder")
    threading.Event().wait(NEVER_AFTER_S)
    answering[receiver].undeclare()
    assert set(asked) == {(receiver, b"operator")}


def test_presence_cannot_be_pretended(secured, until):
    camera = secured.session("camera.main").liveliness()
    tokens = [camera.declare_token(key_root(RIG, MAIN, kind)) for kind in ("planner", "camera")]

    def present():
        replies = secured.session(OPERATOR).liveliness().get(f"suturegrasp/{RIG}/*/*", timeout=1.0)
        return {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}

    found = until(present)
    for token in tokens:
        token.undeclare()
    assert found == {key_root(RIG, MAIN, "camera")}


def test_another_rigs_keys_are_nobodys(secured):
    heard = []
    with secured.session(LISTENER).declare_subscriber("suturegrasp/**", heard.append):
        secured.session("camera.main").put("suturegrasp/other/camera/main/frames", b"x")
        secured.session("camera.main").put("elsewhere", b"x")
        threading.Event().wait(NEVER_AFTER_S)
    assert heard == []


def test_without_a_certificate_of_the_lab_nobody_gets_in(secured, tmp_path):
    issued(secured.endpoint, tmp_path)
    forged = identity_in(tmp_path / "desk" / "certificates", "camera.main")
    with pytest.raises(NoRouterError):
        open_when_there(SessionSettings(RIG, secured.endpoint, forged), within_s=0.5)
