"""The router as a process of its own with certificates: whom it refuses, it counts and names."""

import contextlib
import datetime
import socket
import ssl
import subprocess
import sys
import threading

import pytest

from agents.cli.lab.deploy import layout_of
from agents.configuration.rig import RigConfig
from agents.deployment.certificates import issue
from schemas.codec import decode
from schemas.topics import LOG
from shared.clock import now_ns
from shared.runtime.config import load_config
from shared.runtime.connection import connected
from shared.runtime.identity import identity_in
from shared.runtime.session import SessionSettings, free_local_endpoint

WAIT_S = 30.0
RIG = """
rig = "lab"
host = "desk"
[hosts.desk]
address = "{address}"
runs = ["planner", "operator"]
[router]
host = "desk"
port = {port}
[planner]
[security]
"""


def own_address():
    """An address of this machine that is not loopback, as an interface has it; none, and the test is skipped."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            # nothing is sent: this only asks by which address it would be
            probe.connect(("10.255.255.255", 1))
            address = probe.getsockname()[0]
        except OSError:
            address = "127.0.0.1"
    if address.startswith("127."):
        pytest.skip("this machine has no address but its loopback one")
    return address


@pytest.fixture
def secured(tmp_path):
    """The router of a rig on this machine's own address, running; its rig, its folder, and its process."""
    port = int(free_local_endpoint().rsplit(":", 1)[1])
    file = tmp_path / "rig.toml"
    file.write_text(RIG.format(address=own_address(), port=port))
    rig = load_config(file, RigConfig)
    at = datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC)
    issue(layout_of(rig.model_copy(update={"host": None})), tmp_path / "made", at)
    (tmp_path / "made" / "desk" / "certificates").rename(tmp_path / "certificates")
    command = [sys.executable, "-m", "agents.cli", "router", "--config", str(file)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == f"router on {rig.router_endpoint}\n"
    yield rig, tmp_path, process
    process.kill()
    process.communicate()


@pytest.mark.rig
def test_links_that_are_refused_are_counted_and_told_to_the_rig(secured):
    rig, folder, process = secured
    address, port = rig.hosts["desk"].address, rig.router.port
    settings = SessionSettings("lab", rig.router_endpoint, identity_in(folder / "certificates", "operator.desk"))
    heard, told = [], threading.Event()

    def hear(tapped):
        heard.append(decode(LOG.message, tapped.payload).text)
        told.set()

    with connected(settings, WAIT_S) as connection:
        connection.listen((LOG,), hear)
        context = ssl.create_default_context(cafile=folder / "certificates" / "authority.pem")
        with (
            contextlib.suppress(OSError),
            socket.create_connection((address, port), WAIT_S) as plain,
            context.wrap_socket(plain, server_hostname=address) as link,
        ):
            link.recv(1)
        assert told.wait(WAIT_S)
        with socket.create_connection((address, port), WAIT_S) as plain:
            plain.send(b"no handshake at all" * 20)
            plain.recv(1)
    process.terminate()
    _, err = process.communicate(timeout=WAIT_S)
    assert heard[0] == "a link was refused: peer sent no certificates (1 so far)"
    assert "a link was refused: received corrupt message of type InvalidContentType (1 so far)" in err
    assert "Traceback" not in err
