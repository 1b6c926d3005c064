"""The whole dataflow as real processes: the demo once, from image to judgement, and `up` with one agent killed."""

import contextlib
import re
import signal
import subprocess
import sys
from types import SimpleNamespace

import psutil
import pytest

from schemas.codec import decode
from schemas.messages import GraspJudgement, RobotMode, RobotState
from schemas.topics import (
    CALIBRATION,
    EXECUTION,
    FRAMES,
    JUDGEMENT,
    OBSERVATIONS,
    PLAN,
    ROBOT_STATE,
    THREAD,
    topic_of,
)
from shared.recording.mcap_file import read_recording
from shared.runtime.connection import connected
from shared.runtime.session import SessionSettings, free_local_endpoint
from tests.agents.cli.conftest import SCRIPT

pytestmark = pytest.mark.rig

AT_LEAST_RECORDED = {str(topic) for topic in (FRAMES, CALIBRATION, OBSERVATIONS, THREAD, PLAN, EXECUTION, ROBOT_STATE)}
DEADLINE_S = 60.0
FEWEST_LOOKS_HZ = 1.0
"""What yields to everything else on a busy machine has no processor left where it looks at fewer frames."""
PATIENT_DEMO = """
from agents.cli.demo import command as demo
from agents.cli.main import main
from agents.configuration.sections import ArmSection
demo.LONGEST_S, demo.FIRST_THREAD_S, demo.VERDICT_S = 130.0, 60.0, 30.0
usual = demo.demo_rig
patient = {"robot": {"psm1": ArmSection(maximum_frame_age_s=2.0)}}
demo.demo_rig = lambda options: usual(options).model_copy(update=patient)
main()
"""
"""The command on a machine that may stall."""


def ended(*command):
    """How a command ended, and what it said."""
    return subprocess.run(command, capture_output=True, text=True, timeout=2.5 * DEADLINE_S, check=False)


def processes_of(folder):
    """Every process that was started for a session in that folder."""
    found = []
    for process in psutil.process_iter(["cmdline"]):
        if any(str(folder) in argument for argument in process.info["cmdline"] or ()):
            found.append(process)
    return found


@pytest.mark.essential
def test_the_demo_ends_with_a_judged_grasp_and_leaves_files_and_no_process(tmp_path):
    done = ended(sys.executable, "-c", PATIENT_DEMO, "demo", "--seed", "1", "--sessions", str(tmp_path))
    assert processes_of(tmp_path) == []
    looks = re.search(r"perception/observations +\d+\.\d +\d+\.\d +\d+ +(\d+\.\d)", done.stdout)
    starved = looks is not None and float(looks[1]) < FEWEST_LOOKS_HZ
    # a thread that is seen too rarely is too old, or found anew each time
    rarely = re.search(r"no grasp was attempted: the thread was (?:seen|just found anew)", done.stdout)
    if starved or rarely is not None:
        pytest.skip(
            "a processor for perception: this machine is too busy just now, and frames are too old to plan from"
        )
    assert (done.returncode, done.stderr) == (0, ""), done.stdout + done.stderr
    verdicts = re.findall(r"^grasp (?:held|lost|missed): .*$", done.stdout, flags=re.M)
    assert len(verdicts) == 1, done.stdout
    assert re.search(r"perception/observations +\d+\.\d +\d+\.\d +\d+ +\d+\.\d", done.stdout)
    (folder,) = tmp_path.iterdir()
    assert str(folder) in done.stdout
    assert (folder / "rig.json").is_file()
    entries = list(read_recording(folder / "session.mcap"))
    assert {str(topic_of(entry.key)) for entry in entries} >= AT_LEAST_RECORDED
    judged = [decode(GraspJudgement, entry.payload) for entry in entries if topic_of(entry.key) is JUDGEMENT]
    assert verdicts[0] in [judgement.sentence for judgement in judged]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_demo_that_is_interrupted_stops_every_process(started, tmp_path, number):
    demo = started("demo", "--sessions", str(tmp_path), stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert "started 9 processes" in demo.stdout.readline()
    assert len(processes_of(tmp_path)) == 10
    demo.send_signal(number)
    _, complaint = demo.communicate(timeout=DEADLINE_S)
    assert (demo.returncode, len(complaint.splitlines())) == (130, 1)
    assert processes_of(tmp_path) == []


@pytest.fixture
def started():
    """Starts the command; what still runs in the end is killed, and what it has started ends with it."""
    with contextlib.ExitStack() as stack:

        def start(*arguments, **options):
            process = stack.enter_context(subprocess.Popen([SCRIPT, *arguments], text=True, **options))
            stack.callback(process.kill)
            return process

        yield start


@pytest.fixture
def up(started, tmp_path, until):
    """`up` of a small rig, its configuration and its log; a port that was free may be taken before it listens."""
    log, config = tmp_path / "up.log", tmp_path / "rig.toml"

    def begun():
        endpoint = free_local_endpoint()
        config.write_text(
            f'rig = "test"\n[router]\nendpoint = "{endpoint}"\n[planner]\n[robot.psm1]\n'
            f'[recorder]\nfolder = "{tmp_path / "sessions"}"\n'
        )
        with log.open("w") as out:
            process = started("up", "--config", str(config), stdout=out, stderr=subprocess.STDOUT)
        until(lambda: process.poll() is not None or "started 4 processes" in log.read_text())
        return process.poll() is None and (process, SessionSettings("test", endpoint))

    process, settings = until(begun, "a rig on a free port")
    return SimpleNamespace(process=process, settings=settings, config=config, log=log)


def test_up_starts_again_what_is_killed_tells_of_it_and_stops_all_of_it(up, tmp_path, until):
    modes = []
    with connected(up.settings, DEADLINE_S) as connection:
        connection.listen((ROBOT_STATE,), lambda tapped: modes.append(decode(RobotState, tapped.payload).mode))
        until(lambda: connection.present() == ["planner/main", "recorder/main", "robot_bridge/psm1"])
        second = ended(SCRIPT, "up", "--config", str(up.config))
        assert (second.returncode, second.stdout, len(second.stderr.splitlines())) == (2, "", 1)
        assert "listens on" in second.stderr
        (planner,) = [p for p in psutil.Process(up.process.pid).children() if "planner" in p.cmdline()]
        planner.kill()
        until(lambda: "planner was started again (restart 1)" in up.log.read_text())
        assert "planner was ended by SIGKILL; it starts again in 0.5 s" in up.log.read_text()
        until(lambda: "planner/main" in connection.present())
        before = len(modes)
        until(lambda: len(modes) > before)
    assert set(modes) <= {RobotMode.IDLE, RobotMode.HOLDING, RobotMode.DISABLED}
    up.process.send_signal(signal.SIGINT)
    assert up.process.wait(DEADLINE_S) == 0
    assert processes_of(tmp_path) == []
    said = up.log.read_text().splitlines()
    assert said[-2] == "every process was stopped"
    assert "session.mcap: " in said[-1]
