"""A real router with mutual TLS and the rig's access rules: what is allowed arrives, what is not does not."""

import contextlib
import datetime
import threading

import pytest

from agents.deployment.certificates import issue
from agents.deployment.layout import ROUTER, Host, Layout, Process
from schemas.codec import decode, encode
from schemas.messages import CommandAnswer, Hold, Outcome
from schemas.topics import ANY_AGENT, MAIN, TOPICS, Delivery, key, key_root
from shared.clock import monotonic_s, now_ns
from shared.runtime.access import access_control
from shared.runtime.attachment import Attachment, pack
from shared.runtime.commands import new_header, send_command
from shared.runtime.connection import NoRouterError, open_when_there
from shared.runtime.delivery import declare_publisher, subscribe
from shared.runtime.identity import IdentityError, identity_in
from shared.runtime.session import SessionSettings, free_local_endpoint, open_router, open_session

RIG = "lab"
ARM = "psm1"
PROCESSES = (
    Process(ROUTER), Process("camera"), Process("perception"), Process("perception", ARM), Process("reconstruction"),
    Process("planner"), Process("robot_bridge", ARM), Process("simulator"), Process("recorder", "desk"),
    Process("operator", "desk"), Process("viewer", "desk"),
)  # fmt: skip
LISTENER = "viewer.desk"
"""Forges nothing: what a session publishes itself, its own subscribers hear without any router."""
ARRIVES_WITHIN_S = 5.0
NEVER_AFTER_S = 0.1


def now():
    return datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC)


class Secured:
    """A router with certificates, and whoever connects to it."""

    def __init__(self, folder, stack):
        self.endpoint = free_local_endpoint().replace("tcp/", "tls/")
        layout = Layout(RIG, self.endpoint, (Host("desk", "127.0.0.1", PROCESSES),), 30, 3650)
        issue(layout, folder, now())
        self.folder = folder / "desk" / "certificates"
        self._stack, self._sessions = stack, {}
        access = access_control(RIG, layout.common_names())
        stack.enter_context(open_router(self.endpoint, identity_in(self.folder, "router.main"), access))

    def session(self, name):
        if name not in self._sessions:
            settings = SessionSettings(RIG, self.endpoint, identity_in(self.folder, name))
            self._sessions[name] = self._stack.enter_context(open_session(settings))
        return self._sessions[name]


@pytest.fixture(scope="module")
def secured(tmp_path_factory):
    with contextlib.ExitStack() as stack:
        yield Secured(tmp_path_factory.mktemp("certificates"), stack)


def published():
    """Every topic that is published, with its owner and its instance."""
    for topic in TOPICS:
        if topic.delivery is Delivery.COMMAND or topic.agent == "replay":
            continue
        owner = "planner" if topic.agent == ANY_AGENT else topic.agent
        instance = ARM if topic.per_arm or owner == "robot_bridge" else MAIN
        yield topic, owner, instance


def certificate(kind, instance=MAIN):
    if instance == ARM and kind == "perception":
        return f"{kind}.{ARM}"
    return {"robot_bridge": f"robot_bridge.{ARM}", "operator": "operator.desk"}.get(kind, f"{kind}.main")


@pytest.mark.parametrize("row", tuple(published()), ids=lambda row: str(row[0]))
def test_a_topic_is_heard_from_its_owner_alone(secured, row):
    topic, owner, instance = row
    heard, arrived = [], threading.Event()

    def hear(sample):
        heard.append(sample.payload.to_bytes())
        if heard[-1] == b"own":
            arrived.set()

    name = key(RIG, topic, instance, owner)
    kept = subscribe(secured.session(LISTENER), name, topic, hear, lambda _: None)
    beside = pack(Attachment(1, 0, 0, 0.0))
    declared = []
    for process in PROCESSES[1:]:
        if process.kind != owner and process.common_name != LISTENER:
            declared.append(declare_publisher(secured.session(process.common_name), name, topic))
            declared[-1].put(b"forged", attachment=beside)
    own = declare_publisher(secured.session(certificate(owner, instance)), name, topic)
    declared.append(own)
    deadline_s = monotonic_s() + ARRIVES_WITHIN_S
    while not arrived.wait(0.02) and monotonic_s() < deadline_s:
        own.put(b"own", attachment=beside)
    threading.Event().wait(NEVER_AFTER_S)
    for gone in (*declared, *kept):
        gone.undeclare()
    assert set(heard) == {b"own"}


@pytest.mark.parametrize("delivery", [Delivery.STATE, Delivery.EVENT])
def test_whoever_comes_late_is_told_the_history_by_its_owner_alone(secured, delivery):
    topic, owner, instance = next(row for row in published() if row[0].delivery is delivery)
    name, beside = key(RIG, topic, instance, owner), pack(Attachment(1, 0, 0, 0.0))
    forger = declare_publisher(secured.session("perception.main"), name, topic)
    own = declare_publisher(secured.session(certificate(owner)), name, topic)
    for publisher, said in ((forger, b"forged"), (own, b"own")):
        publisher.put(said, attachment=beside)
    heard, arrived = [], threading.Event()

    def hear(sample):
        heard.append(sample.payload.to_bytes())
        arrived.set()

    late = subscribe(secured.session(LISTENER), name, topic, hear, lambda _: None)
    assert arrived.wait(ARRIVES_WITHIN_S)
    threading.Event().wait(NEVER_AFTER_S)
    for gone in (forger, own, *late):
        gone.undeclare()
    assert heard == [b"own"]


def commands():
    """Every command that is given to one receiver, and that every agent takes."""
    return [topic for topic in TOPICS if topic.delivery is Delivery.COMMAND]


@pytest.mark.parametrize("topic", commands(), ids=str)
def test_a_command_is_obeyed_by_its_receiver_and_asked_by_operators_alone(secured, topic):
    receiver = "planner" if topic.receiver == ANY_AGENT else topic.receiver
    agent = "planner" if topic.agent == ANY_AGENT else ""
    name = key(RIG, topic, ARM if topic.per_arm else MAIN, agent)
    asked, kept = [], []

    def answerer(who):
        def answer(query):
            asked.append((who, query.payload.to_bytes()))
            query.reply(query.key_expr, encode(CommandAnswer(who, Outcome.ACCEPTED, "", "")))
            query.drop()

        return answer

    for process in PROCESSES[1:]:
        # an operator that could answer would answer for itself alone
        if process.kind != "operator":
            session = secured.session(process.common_name)
            kept.append(session.declare_queryable(name, answerer(process.kind), complete=True))
    deadline_s = monotonic_s() + ARRIVES_WITHIN_S
    while not asked and monotonic_s() < deadline_s:
        _get(secured.session("operator.desk"), name, b"operator")
    for process in PROCESSES[1:]:
        if process.kind not in ("operator", receiver):
            # its own queryable would answer it within its own process
            kept[[p for p in PROCESSES[1:] if p.kind != "operator"].index(process)].undeclare()
            _get(secured.session(process.common_name), name, b"intruder")
    threading.Event().wait(NEVER_AFTER_S)
    for queryable in kept:
        with contextlib.suppress(Exception):
            queryable.undeclare()
    assert set(asked) == {(receiver, b"operator")}


def _get(session, name, payload):
    for _ in session.get(name, payload=payload, timeout=0.3):
        pass


def test_a_hold_reaches_its_arm_as_it_does_without_certificates(secured):
    topic = next(t for t in TOPICS if t.message is Hold)

    def answer(query):
        asked = decode(Hold, query.payload.to_bytes())
        query.reply(query.key_expr, encode(CommandAnswer(asked.header.id, Outcome.ACCEPTED, "", "")))
        query.drop()

    arm = secured.session(f"robot_bridge.{ARM}").declare_queryable(key(RIG, topic, ARM), answer, complete=True)
    # until the router has told the operator's session who answers, there is nobody to ask
    deadline_s, told, header = monotonic_s() + ARRIVES_WITHIN_S, None, new_header("desk")
    while (told is None or told.outcome is Outcome.UNKNOWN) and monotonic_s() < deadline_s:
        header = new_header("desk")
        told = send_command(secured.session("operator.desk"), RIG, topic, Hold(header, ARM), ARM)
    arm.undeclare()
    assert told is not None
    assert (told.id, told.outcome) == (header.id, Outcome.ACCEPTED)


def test_presence_cannot_be_pretended(secured):
    camera = secured.session("camera.main").liveliness()
    tokens = [camera.declare_token(key_root(RIG, MAIN, kind)) for kind in ("planner", "camera")]
    found = set()
    deadline_s = monotonic_s() + ARRIVES_WITHIN_S
    while not found and monotonic_s() < deadline_s:
        replies = secured.session("operator.desk").liveliness().get(f"suturegrasp/{RIG}/*/*", timeout=1.0)
        found = {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}
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
    other = Layout(RIG, secured.endpoint, (Host("desk", "127.0.0.1", PROCESSES),), 30, 3650)
    issue(other, tmp_path, now())
    forged = identity_in(tmp_path / "desk" / "certificates", "camera.main")
    with pytest.raises(NoRouterError):
        open_when_there(SessionSettings(RIG, secured.endpoint, forged), within_s=1.0)


def test_an_expired_certificate_is_told_by_name(tmp_path):
    layout = Layout(RIG, "tls/127.0.0.1:1", (Host("desk", "127.0.0.1", PROCESSES),), 30, 3650)
    issue(layout, tmp_path, now() - datetime.timedelta(days=31))
    expired = identity_in(tmp_path / "desk" / "certificates", "camera.main")
    with pytest.raises(IdentityError, match=r"camera\.main\.pem has expired; renew it"):
        open_session(SessionSettings(RIG, layout.endpoint, expired))


@pytest.mark.parametrize("endpoint", ["tcp/10.0.0.1:7447", "tls/10.0.0.1:7447", "tcp/[::]:7447", "udp/host:1"])
def test_nothing_leaves_this_machine_without_certificates(endpoint):
    with pytest.raises(IdentityError, match="mutual TLS"):
        open_session(SessionSettings(RIG, endpoint))
    with pytest.raises(IdentityError, match="mutual TLS"):
        open_router(endpoint)
