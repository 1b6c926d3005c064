"""Two real routers of two sites, linked, with certificates: what is read across arrives, and nothing else crosses."""

import contextlib
import datetime
import threading

import pytest

from agents.deployment.certificates import issue
from agents.deployment.layout import ROUTER, Host, Layout, Process
from schemas.topics import CALIBRATION, FRAMES, LOG, MAIN, SET, Delivery, key, key_root
from shared.clock import now_ns
from shared.runtime.access import Sites, access_control
from shared.runtime.attachment import Attachment, pack
from shared.runtime.delivery import declare_publisher, subscribe
from shared.runtime.identity import identity_in
from shared.runtime.session import SessionSettings, free_local_endpoint, open_router, open_session

PROCESSES = (
    Process(ROUTER), Process("camera"), Process("planner"), Process("viewer", "desk"), Process("operator", "desk"),
)  # fmt: skip
NAMES = [process.common_name for process in PROCESSES if process.kind != ROUTER]
HOSTS = {"north": "n", "south": "s"}
"""Two sites, each with a rig of the same name and one host."""
TOPICS = (FRAMES, CALIBRATION, LOG)
NEVER_AFTER_S = 0.2


class Linked:
    """Rig north may be read by others; south connects to its router and reads it."""

    def __init__(self, folder, stack):
        self._folder, self._stack = folder, stack
        self.endpoints = {site: free_local_endpoint().replace("tcp/", "tls/") for site in HOSTS}
        at = datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC)
        for site, host in HOSTS.items():
            issue(Layout(site, self.endpoints[site], (Host(host, "127.0.0.1", PROCESSES),), 30, 3650), folder, at)
        self._start("south", Sites((self.endpoints["north"],), ("north",)))
        self._start("north", Sites(read_by_others=True))

    def _start(self, site, sites):
        access = access_control(site, NAMES, sites)
        identity = self.identity(site, "router.main")
        self._stack.enter_context(open_router(self.endpoints[site], identity, access, sites.connect))

    def identity(self, site, name):
        return identity_in(self._folder / HOSTS[site] / "certificates", name)

    def session(self, rig, site, name):
        """Of a process at a site, which looks at a rig."""
        settings = SessionSettings(rig, self.endpoints[site], self.identity(site, name))
        return self._stack.enter_context(open_session(settings))


@pytest.fixture(scope="module")
def linked(tmp_path_factory):
    with contextlib.ExitStack() as stack:
        yield Linked(tmp_path_factory.mktemp("sites"), stack)


def camera_key(rig, topic):
    return key(rig, topic, agent="camera")


def published(linked, rig, site):
    """Publishers of a camera, by topic, under the keys of a rig."""
    session = linked.session(rig, site, "camera.main")
    return {topic: declare_publisher(session, camera_key(rig, topic), topic) for topic in TOPICS}


def test_a_rig_is_read_at_the_other_site_with_its_history_and_from_its_owner_alone(linked, until):
    own, forged = published(linked, "north", "north"), published(linked, "north", "south")

    def publish(by, payload, sequence):
        for topic in TOPICS:
            by[topic].put(payload, attachment=pack(Attachment(1, sequence, 0, 0.0)))

    publish(own, b"before", 0)
    heard, viewer, kept = {topic: [] for topic in TOPICS}, linked.session("north", "south", "viewer.desk"), []
    for topic in TOPICS:
        hear = lambda sample, topic=topic: heard[topic].append(sample.payload.to_bytes())  # noqa: E731
        kept += subscribe(viewer, camera_key("north", topic), topic, hear, lambda _: None)
    kept_for_others = [topic for topic in TOPICS if topic.delivery is not Delivery.LATEST]
    until(lambda: all(heard[topic] == [b"before"] for topic in kept_for_others))
    sequences = iter(range(1, 10**6))

    def all_came():
        sequence = next(sequences)
        publish(forged, b"forged", sequence)
        publish(own, b"after", sequence)
        return all(b"after" in heard[topic] for topic in TOPICS)

    until(all_came)
    threading.Event().wait(NEVER_AFTER_S)
    for declared in (*kept, *own.values(), *forged.values()):
        declared.undeclare()
    assert not any(b"forged" in heard[topic] for topic in TOPICS)


def test_what_is_not_to_be_read_stays_at_its_site(linked, until):
    own, heard, at_home = published(linked, "south", "south"), [], []
    with (
        linked.session("south", "north", "viewer.desk").declare_subscriber("suturegrasp/**", heard.append),
        linked.session("south", "south", "viewer.desk").declare_subscriber("suturegrasp/south/**", at_home.append),
    ):
        until(lambda: own[FRAMES].put(b"own") or at_home)
        threading.Event().wait(NEVER_AFTER_S)
    assert [str(sample.key_expr) for sample in heard] == []


def test_presence_is_seen_across_and_commands_are_not_obeyed(linked, until):
    asked = []

    def answer(query):
        asked.append(query.payload.to_bytes())
        query.reply(query.key_expr, b"done")
        query.drop()

    planner, command = linked.session("north", "north", "planner.main"), key("north", SET, MAIN, "planner")
    token = planner.liveliness().declare_token(key_root("north", MAIN, "planner"))
    queryable = planner.declare_queryable(command, answer, complete=True)
    operators = {site: linked.session("north", site, "operator.desk") for site in HOSTS}

    def present():
        replies = operators["south"].liveliness().get("suturegrasp/north/*/*", timeout=1.0)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]

    until(present)

    def obeyed():
        for site in ("south", "north"):
            list(operators[site].get(command, payload=site.encode(), timeout=0.5))
        return asked

    until(obeyed)
    token.undeclare()
    queryable.undeclare()
    assert set(asked) == {b"north"}
