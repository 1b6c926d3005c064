"""The operator's page opens a browser without its one-time token in a list of processes."""

import json
import os
import re
import signal
import subprocess

import pytest

from shared.runtime.session import free_local_endpoint, open_router
from tests.agents.cli.conftest import SCRIPT

STARTS_S = 60.0
BROWSER = """#!/bin/sh
echo "$1" > "$HOME/opened"
cat "${1#file://}" > "$HOME/read"
stat -c %a "${1#file://}" > "$HOME/mode"
"""


@pytest.mark.rig
def test_a_browser_is_led_to_the_page_by_a_file_that_its_user_alone_reads(tmp_path, until):
    browser, endpoint = tmp_path / "browser", free_local_endpoint()
    browser.write_text(BROWSER)
    browser.chmod(0o755)
    rig = tmp_path / "rig.json"
    rig.write_text(json.dumps({"router": {"endpoint": endpoint, "start": False}}))
    command = [SCRIPT, "page", "--port", "0", "--config", str(rig)]
    environment = {**os.environ, "HOME": str(tmp_path), "DISPLAY": ":99", "BROWSER": f"{browser} %s"}
    with (
        open_router(endpoint),
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment, cwd=tmp_path) as page,
    ):
        try:
            assert page.stdout is not None
            link = next(found[0] for line in page.stdout if (found := re.findall(r"http://\S+#token=\S+", line)))
            until(lambda: (tmp_path / "mode").exists() and (tmp_path / "mode").read_text(), "a browser", STARTS_S)
        finally:
            page.send_signal(signal.SIGINT)
            page.wait(STARTS_S)
    opened = (tmp_path / "opened").read_text().strip()
    assert opened.startswith("file://")
    assert "token" not in opened
    assert link in (tmp_path / "read").read_text()
    assert (tmp_path / "mode").read_text().strip() == "600"
    assert not list(tmp_path.glob("suturegrasp-page-*"))
