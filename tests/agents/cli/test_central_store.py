"""A rig that is recorded at another site: two linked routers with certificates, an agent here, the recorder there."""

import contextlib
import datetime
import signal
import subprocess

import pytest

from agents.cli.live.up import write_config
from agents.configuration.hosts import SecuritySection
from agents.configuration.rig import RecorderSection, RigConfig, RouterSection
from agents.deployment.certificates import issue
from agents.deployment.layout import ROUTER, Host, Layout, Process
from agents.planner.agent import Planner
from schemas.codec import decode
from schemas.topics import LOG, key, topic_of
from shared.clock import now_ns
from shared.recording.entry import RecordingError
from shared.recording.mcap_file import read_recording
from shared.runtime.access import Sites, access_control
from shared.runtime.identity import identity_in
from shared.runtime.session import SessionSettings, free_local_endpoint, open_router
from tests.agents.cli.conftest import SCRIPT

pytestmark = pytest.mark.rig

RUNS = {"north": Process("planner"), "store": Process("recorder")}
DEADLINE_S = 60.0
WANTED = {"*/health", "*/log", "*/configuration"}
"""Newest messages, events of before anybody recorded, and what is told to whoever comes late."""


@pytest.fixture
def sites(tmp_path):
    """The routers of a rig and of the site that stores; certificates of one authority, and the endpoints."""
    endpoints = {site: free_local_endpoint().replace("tcp/", "tls/") for site in RUNS}
    at = datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC)
    across = {"north": Sites(read_by_others=True), "store": Sites((endpoints["north"],), ("north",))}
    with contextlib.ExitStack() as stack:
        for site, process in RUNS.items():
            host = Host(site, "127.0.0.1", (Process(ROUTER), process))
            issue(Layout(site, endpoints[site], (host,), 30, 3650), tmp_path, at)
            access = access_control(site, [process.common_name], across[site])
            identity = identity_in(tmp_path / site / "certificates", "router.main")
            stack.enter_context(open_router(endpoints[site], identity, access, across[site].connect))
        yield endpoints


def held(file):
    """The topics of which a recording holds something, also while it is written."""
    with contextlib.suppress(RecordingError, FileNotFoundError):
        return {str(topic_of(entry.key)) for entry in read_recording(file)}
    return set()


def test_a_recorder_at_another_site_holds_a_rigs_events_of_before_and_what_comes(sites, in_threads, until, tmp_path):
    at_north = identity_in(tmp_path / "north" / "certificates", "planner.main")
    config, file = tmp_path / "north-from-store.json", tmp_path / "north.mcap"
    rig = RigConfig(
        rig="north",
        router=RouterSection(endpoint=sites["store"], start=False),
        security=SecuritySection(certificates=tmp_path / "store" / "certificates"),
        recorder=RecorderSection(),
    )
    write_config(config, rig)
    with in_threads(SessionSettings("north", sites["north"], at_north), Planner()):
        command = [SCRIPT, "record", "--config", str(config), "--output", str(file), "--no-foxglove"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as recorder:
            try:
                until(lambda: recorder.poll() is not None or held(file) >= WANTED, "what the agent tells")
                recorder.send_signal(signal.SIGINT)
                said, complaints = recorder.communicate(timeout=DEADLINE_S)
            finally:
                recorder.kill()
    assert (recorder.returncode, complaints) == (0, ""), said
    entries = list(read_recording(file))
    assert held(file) >= WANTED
    assert {entry.key.split("/")[1] for entry in entries} == {"north"}
    told = [decode(LOG.message, e.payload).text for e in entries if e.key == key("north", LOG, agent="planner")]
    assert told[0].startswith("started, version")
