"""Everything on the page for those who extend the project runs as it is written."""

import contextlib
import re
import subprocess
import sys
import tomllib

import numpy as np
import pytest

from agents.camera.plugin import GROUP, PluginSource
from agents.camera.sources import SourceError
from agents.configuration.rig import RigConfig
from agents.launch.builders import build
from schemas.codec import decode, encode
from schemas.messages import StereoCalibration, StereoFrame
from schemas.topics import CALIBRATION, FRAMES, MAIN, PLAN, THREAD, key, topic_of
from shared.calibration import write_calibration
from shared.clock import now_ns
from shared.recording.mcap_file import read_recording
from shared.runtime.agent import Output, Tick, awaited
from shared.runtime.attachment import Attachment, pack
from shared.runtime.connection import connected
from shared.runtime.delivery import declare_publisher
from shared.runtime.identity import identity_in
from shared.runtime.session import SessionSettings
from tests.agents.cli.conftest import REPOSITORY
from tests.shared.runtime.test_access import LISTENER, RIG, Secured

PAGE = (REPOSITORY / "docs" / "extending.md").read_text(encoding="utf-8")
READS, OF_STATES, SHOWS_CERTIFICATE, CAMERA = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
PACKAGE, RIG_FILE = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
K = np.array([[600.0, 0, 319.5], [0, 600.0, 239.5], [0, 0, 1]])


def recorded(topic):
    """The first message of a topic in a golden recording."""
    entries = read_recording(REPOSITORY / "tests" / "goldens" / "crossing.mcap")
    return next(decode(topic.message, e.payload) for e in entries if topic_of(e.key) is topic)


@pytest.fixture
def first_line(tmp_path):
    """The words of the first line that a program prints on a rig."""

    def run(program, settings, *arguments):
        (tmp_path / "program.py").write_text(program)
        command = [sys.executable, str(tmp_path / "program.py"), settings.endpoint, settings.rig, *arguments]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=REPOSITORY) as process:
            assert process.stdout is not None
            line = process.stdout.readline()
            process.kill()
        return line.split()

    return run


@contextlib.contextmanager
def repeated(settings, topic):
    """A recorded message of a topic, which is told again and again meanwhile."""
    message = recorded(topic)
    with connected(settings, 10.0) as connection, connection.repeating(topic, MAIN, 20.0, lambda _: message):
        yield message


def test_a_program_of_a_dozen_lines_reads_threads_and_a_state_that_was_said_before(first_line, settings, session):
    with repeated(settings, THREAD) as thread:
        line = first_line(READS, settings)
    assert line[:3] == [f"suturegrasp/{settings.rig}/reconstruction/main/thread", str(thread.stamp.sequence), "ok"]
    message = recorded(CALIBRATION)
    publisher = declare_publisher(session, key(settings.rig, CALIBRATION), CALIBRATION)
    publisher.put(encode(message), attachment=pack(Attachment(1, 1, now_ns(), 0.0)))
    line = first_line(READS.partition("with zenoh.open")[0] + OF_STATES, settings)
    assert line == [key(settings.rig, CALIBRATION), str(message.image_width), str(message.image_height)]


def test_on_a_rig_with_certificates_it_shows_that_of_a_viewer(first_line, tmp_path):
    of_plans = READS.replace("reconstruction/main/thread", "planner/main/plan")
    begin, opens, rest = of_plans.replace("ThreadReconstruction", "GraspPlan").partition("with zenoh.open")
    with contextlib.ExitStack() as stack:
        secured = Secured(tmp_path, stack)
        owner = SessionSettings(RIG, secured.endpoint, identity_in(secured.folder, "planner.main"))
        plan = stack.enter_context(repeated(owner, PLAN))
        line = first_line(begin + SHOWS_CERTIFICATE + opens + rest, owner, str(secured.folder), LISTENER)
    assert line[:2] == [f"suturegrasp/{RIG}/planner/main/plan", str(plan.stamp.sequence)]


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """The page's camera package, as pip would leave it; where it lies."""
    project = tomllib.loads(PACKAGE)["project"]
    (tmp_path / "triggered.py").write_text(CAMERA)
    told = tmp_path / f"{project['name']}-{project['version']}.dist-info"
    told.mkdir()
    (told / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    ((group, entries),) = project["entry-points"].items()
    assert group == GROUP
    lines = "".join(f"{name} = {where}\n" for name, where in entries.items())
    (told / "entry_points.txt").write_text(f"[{group}]\n{lines}")
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    sys.modules.pop("triggered", None)


def test_a_camera_of_ones_own_films_with_its_own_times(installed, monkeypatch):
    T = np.eye(4)
    T[0, 3] = -0.005
    calibration = StereoCalibration(960, 540, K, K, np.zeros(0), np.zeros(0), T, 1.0)
    write_calibration(installed / "calibration.json", calibration)
    monkeypatch.chdir(installed)
    camera = build(RigConfig.model_validate(tomllib.loads(RIG_FILE)), "camera", MAIN)
    said = [output for _ in range(2) for output in awaited(camera.step(Tick(now_ns()))) if isinstance(output, Output)]
    assert {output.topic for output in said} >= {CALIBRATION, FRAMES}
    frame = next(output.message for output in said if output.topic is FRAMES)
    assert isinstance(frame, StereoFrame)
    assert (frame.left.width, frame.left.height) == (960, 540)
    # four milliseconds before it was asked for, which is not long ago
    assert 3e6 < now_ns() - frame.stamp.capture_left_ns < 5e9


@pytest.mark.usefixtures("installed")
def test_what_is_not_installed_fails_or_gives_no_pair_is_named():
    with pytest.raises(SourceError, match=r"camera.plugin 'pylon' is not installed here; .*: triggered"):
        PluginSource("pylon", {})
    with pytest.raises(SourceError, match="'triggered' does not open: ValueError"):
        PluginSource("triggered", {"width": "wide"})
    source = PluginSource("triggered", {"width": 64, "height": 48})
    eye, narrow = np.zeros((48, 64, 3), np.uint8), np.zeros((48, 32, 3), np.uint8)

    def broken():
        raise OSError("the cable is out")

    for read, told in (
        (lambda: (narrow, eye, 1, 1), r"the left image is uint8 of shape \(48, 32, 3\), not uint8 of shape \(48, 64,"),
        (lambda: (eye, eye, 1, now_ns() + 10**9), r"the clock of its camera is (1\.\d+|0\.9\d+) s or more ahead"),
        (broken, "'triggered': OSError: the cable is out"),
    ):
        source._source.read = read
        with pytest.raises(SourceError, match=told):
            source.read()
