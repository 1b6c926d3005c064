"""`suturegrasp page --start` begins a whole rig, as `make play` does, and serves the page that shows its thread."""

import re
import signal
import subprocess
import sys
import urllib.request

import pytest

from schemas.topics import THREAD
from shared.runtime.connection import connected
from shared.runtime.session import SessionSettings, free_local_endpoint

STARTS_S = 90.0
RIG = """
rig = "paged"
[router]
endpoint = "{endpoint}"
[camera]
rate_hz = 6
[perception]
[reconstruction]
[planner]
[robot.psm1]
[simulator]
config = "easy"
[recorder]
folder = "{folder}"
"""


@pytest.mark.rig
def test_a_rig_and_its_page_are_started_by_one_command(tmp_path, until):
    endpoint, config = free_local_endpoint(), tmp_path / "rig.toml"
    config.write_text(RIG.format(endpoint=endpoint, folder=tmp_path))
    command = [sys.executable, "-m", "agents.cli", "page", "--start", "--no-open", "--port", "0"]
    threads = []
    with subprocess.Popen([*command, "--config", str(config)], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            link = next(found[0] for line in process.stdout if (found := re.findall(r"http://\S+#token=\S+", line)))
            with connected(SessionSettings("paged", endpoint), STARTS_S) as connection:
                connection.listen((THREAD,), threads.append)
                until(lambda: threads, "a thread", STARTS_S)
            with urllib.request.urlopen(link.partition("#")[0]) as page:  # noqa: S310, it is ours
                assert b"SutureGrasp" in page.read()
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(STARTS_S)
    assert '"started"' in (tmp_path / "audit" / "operator-page.jsonl").read_text()
