"""A rig of four hosts rehearsed on this machine, as docs/deployment.md has it."""

import itertools
import re
import subprocess
import sys
from pathlib import Path

import pytest

from agents.cli.lab.rehearsal.network import PREFIX

LAB = Path(__file__).parents[2] / "deploy" / "lab.toml"
BREAKS = ("--cut", "video", "--kill", "perception", "--seconds", "8")
NAMED = {
    "video is cut off": "no router answers on tls/10.0.0.11:7447 on host video",
    "perception is killed": "perception on strong began anew",
}
"""What `status` calls each of them."""
pytestmark = [pytest.mark.hosts, pytest.mark.timeout(400)]


def rehearsed(*options):
    command = [sys.executable, "-m", "agents.cli", "deploy", "rehearse", "--config", str(LAB), *options]
    return subprocess.run(command, capture_output=True, text=True, timeout=380.0, check=False)


def test_four_hosts_come_up_and_every_break_is_named_and_over():
    done = rehearsed(*BREAKS)
    if "cannot be rehearsed here" in done.stderr:
        pytest.skip(done.stderr)
    assert (done.returncode, done.stderr) == (0, ""), done.stdout
    head, *parts = re.split(r"\n(?=\S.*, for 8 s:\n)", done.stdout)
    assert "all well after" in head
    # what it finds wrong beside that answers are late, for all hosts share processors, is another exit status
    assert re.search(r"doctor on desk: \d+ findings", head)
    assert len(parts) == len(NAMED)
    for part, (what, named) in zip(parts, NAMED.items(), strict=True):
        assert part.startswith(what)
        assert named in part
        assert "all well again" in part
    # what lies behind the router is not named in its place; a machine that is busy besides may be named before it
    told = re.findall(r"^ +\d+\.\d s +(.*)", parts[0], re.MULTILINE)
    before = list(itertools.takewhile(lambda line: "router" not in line, told))
    assert not [line for line in before if " is gone" in line or " is away" in line]
    assert not list(Path("/run/netns").glob(f"{PREFIX}*"))


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--cut", "kitchen"), "--cut kitchen is none of the rig's hosts video, strong, robot, desk"),
        (("--slow", "robot", "fast"), "--slow ... fast must read like 10Mbit"),
        (("--skew", "desk", "late"), "--skew ... late must read like 2s"),
        (("--kill", "surgeon"), "--kill 'surgeon' is nothing that the rig runs"),
    ],
)
def test_a_mistake_is_one_line(options, told):
    done = rehearsed(*options)
    assert (done.returncode, done.stderr.count("\n"), done.stdout) == (2, 1, "")
    assert told in done.stderr
