"""`suturegrasp replay` on a real router, with agents that listen; as a process where it is stopped or typed at."""

import signal
import subprocess
import sys
import threading
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.cli.main import main
from schemas.codec import decode
from schemas.messages import LogRecord, RectifiedStereo, TissueSurface
from schemas.topics import COMMANDS, FRAMES, LOG, PROMPT, ROBOT_STATE, SURFACE, TOPICS, Delivery, key
from shared.clock import now_ns
from shared.runtime.agent import Agent, Command, Input, Output, Tick
from shared.runtime.attachment import Attachment, pack
from shared.runtime.commands import accepted
from shared.runtime.connection import connected

SCRIPT = str(Path(sys.executable).with_name("suturegrasp"))
DEADLINE_S = 60.0
WIRE = tuple(topic for topic in TOPICS if topic.delivery is not Delivery.COMMAND)
CAMERA = RectifiedStereo(4, 2, 4.0, 4.0, 1.5, 0.5, 5e-3, 1.0)
NONE = np.zeros(0)


class Slow(Agent):
    """Takes a while for each message, and tells which it was."""

    instance, commands, tick_hz = "main", (), None

    def __init__(self, kind, listened, outputs=()):
        self.kind, self.inputs, self.outputs = kind, (Input(listened, only_newest_counts=True),), outputs
        self.taken = []

    def step(self, arrived: Any):
        threading.Event().wait(0.03)
        stamp = arrived.message.stamp
        self.taken.append(stamp.sequence)
        for topic in self.outputs:
            yield Output(topic, TissueSurface(stamp, CAMERA, NONE, NONE, np.zeros((0, 0)), np.zeros((0, 0), bool)))


class Prompted(Agent):
    """Accepts prompts, and notes the time of its ticks."""

    kind, instance, inputs, outputs, commands, tick_hz = "perception", "main", (), (), (PROMPT,), 50.0

    def __init__(self):
        self.now_ns, self.prompts = [], []

    def step(self, arrived):
        if isinstance(arrived, Command):
            self.prompts.append(arrived)
            yield accepted(arrived.message.header.id)
        elif isinstance(arrived, Tick):
            self.now_ns.append(arrived.now_ns)


@pytest.fixture
def config(settings, tmp_path):
    """A configuration file of the rig of the tests."""
    path = tmp_path / "rig.toml"
    path.write_text(f'rig = "{settings.rig}"\n[router]\nendpoint = "{settings.endpoint}"\nstart = false\n')
    return path


@pytest.fixture
def replayed(config, capfd):
    """Runs the command within this process: its status, what it said, what it complained of."""

    def run(path, *options):
        capfd.readouterr()
        with pytest.raises(SystemExit) as ended:
            main(["replay", str(path), "--config", str(config), *options])
        said = capfd.readouterr()
        return ended.value.code, said.out, said.err

    return run


@pytest.fixture
def replay(config):
    """The command as a process of its own; all that is started is ended."""
    started = []

    def start(path, *options, stdin=subprocess.DEVNULL):
        command = [SCRIPT, "replay", str(path), "--config", str(config), *options]
        pipe = subprocess.PIPE
        process = subprocess.Popen(command, stdin=stdin, stdout=pipe, stderr=pipe, text=True)
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.fixture
def heard(settings):
    """Every message on the rig's keys, as it is heard."""
    messages = []
    with connected(settings, DEADLINE_S) as connection:
        connection.listen(WIRE, messages.append)
        yield messages


def by_key(heard):
    """What was heard but for the replay's own, by key."""
    found = defaultdict(list)
    for message in [message for message in list(heard) if "/replay/" not in message.key]:
        found[message.key].append(message)
    return found


def of_recording(recording, rig):
    """Payloads and times of publication by key, as a replay with nobody else there gives them."""
    found = defaultdict(list)
    for entry in recording.entries:
        if not any(name in entry.key for name in ("planner/main/plan", "somebody")):
            found[entry.key.replace("/recorded/", f"/{rig}/")].append((entry.payload, entry.published_ns))
    return found


def test_every_byte_is_published_again_in_order_under_a_run_of_its_own(replayed, recording, heard, settings):
    code, out, err = replayed(recording.path, "--fast")
    assert (code, err) == (0, "")
    messages = by_key(heard)
    expected = of_recording(recording, settings.rig)
    assert {k: [(m.payload, m.beside.published_ns) for m in ms] for k, ms in messages.items()} == expected
    (epoch,) = {m.beside.epoch for ms in messages.values() for m in ms}
    assert epoch != 7
    assert all([m.beside.sequence for m in ms] == list(range(len(ms))) for ms in messages.values())
    assert "left out, would be acted on: planner/plan, operator/prompt" in out
    assert any("/replay/main/clock" in m.key for m in heard)


@pytest.mark.slow
def test_at_its_own_spacing_nothing_is_changed_or_swapped_and_the_error_is_told(replayed, recording, heard, settings):
    code, out, _ = replayed(recording.path, "--from", "0.5", "--to", "1.51", "--rate", "2")
    assert code == 0
    assert "spacing error p50" in out
    expected, found = of_recording(recording, settings.rig), by_key(heard)
    # a busy machine may drop states and frames on their way; events and what holds are not dropped
    lines = [m.payload for m in found[key(settings.rig, LOG, agent="camera")]]
    assert lines == [f"line {n}".encode() for n in range(5, 16)]
    for name, messages in found.items():
        published = [m.beside.published_ns for m in messages]
        assert published == sorted(published)
        assert {(m.payload, m.beside.published_ns) for m in messages} <= set(expected[name])


@pytest.mark.slow
def test_fast_waits_for_all_that_follows_and_so_loses_nothing(replayed, recording, settings, in_threads, until):
    perception, reconstruction = Slow("perception", FRAMES, (SURFACE,)), Slow("reconstruction", SURFACE)
    with in_threads(settings, perception, reconstruction), connected(settings) as connection:
        until(lambda: {"perception/main", "reconstruction/main"} <= set(connection.present()))
        code, out, err = replayed(recording.path, "--fast", "--to", "0.8")
    assert (code, err) == (0, "")
    assert perception.taken == reconstruction.taken == list(range(16))
    assert "waited for perception/main, reconstruction/main" in out
    assert "left out, perception/main is live: perception/health, perception/command" in out


@pytest.mark.rig
def test_agents_live_in_its_time_until_it_dies_and_nobody_else_replays_meanwhile(
    replay, replayed, recording, settings, in_threads, heard, until
):
    def lines():
        return [decode(LogRecord, m.payload).text for m in list(heard) if "/perception/main/log" in m.key]

    agent = Prompted()
    with in_threads(settings, agent):
        first = replay(recording.path, "--loop", "--topics", "camera/frames", "camera/calibration")
        until(lambda: agent.now_ns and agent.now_ns[-1] < recording.begin_ns + 3 * 10**9, "the recording's time")
        since = len(agent.now_ns)
        until(
            lambda: any(b < a for a, b in zip(agent.now_ns[since:], agent.now_ns[since + 1 :], strict=False)), "a loop"
        )
        assert min(agent.now_ns) >= recording.begin_ns
        code, _, err = replayed(recording.path)
        assert code == 2
        assert "a recording is replayed on rig test already" in err
        first.kill()
        until(lambda: abs(agent.now_ns[-1] - now_ns()) < 10**9, "this machine's time")
        until(lambda: "ended or died" in lines()[-1])
    assert any("a recording is replayed" in line for line in lines())


def test_a_command_is_sent_again_where_that_is_confirmed_and_is_timely_in_the_recordings_time(
    replayed, recording, settings, in_threads, heard, until
):
    agent = Prompted()
    code, _, err = replayed(recording.path, "--topics", "operator/prompt")
    assert (code, "agents would act on operator/prompt: add --yes-execute" in err) == (2, True)
    with in_threads(settings, agent):
        code, out, _ = replayed(recording.path, "--topics", "operator/prompt", "--yes-execute", "--fast")
    assert code == 0
    assert "operator/prompt: accepted" in out
    (prompt,) = agent.prompts
    assert prompt.message.header.id == "p1"
    assert recording.begin_ns <= prompt.now_ns < recording.begin_ns + 2 * 10**9
    until(lambda: [m for m in list(heard) if m.key == key(settings.rig, COMMANDS, agent="perception")])


@pytest.mark.rig
def test_enter_steps_to_the_next_frame_and_the_end_of_input_ends_it(replay, recording, heard, settings, until):
    process = replay(recording.path, "--step", stdin=subprocess.PIPE)
    frames = lambda: by_key(heard)[key(settings.rig, FRAMES)]  # noqa: E731
    for count in (1, 2, 3):
        process.stdin.write("\n")
        process.stdin.flush()
        until(lambda count=count: len(frames()) == count, f"frame {count}")
    process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0
    assert len(frames()) == 3


@pytest.mark.rig
def test_a_replay_that_is_interrupted_says_what_was_sent(replay, recording, heard, until):
    process = replay(recording.path, "--rate", "0.1")
    until(lambda: len(heard) > 20, "the beginning")
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0
    assert "sent " in out


def test_two_publishers_of_a_topic_are_refused_before_anything_is_sent(
    replayed, recording, settings, session, in_threads, heard, until
):
    with in_threads(settings, Slow("camera", SURFACE)), connected(settings) as connection:
        until(lambda: "camera/main" in connection.present())
        code, _, err = replayed(recording.path, "--topics", "camera/*")
    assert (code, "camera/main is live on this rig and publishes camera/" in err) == (2, True)
    name, stopped = key(settings.rig, ROBOT_STATE, "psm1"), threading.Event()

    def publish():
        number = 0
        while not stopped.wait(0.02):
            session.put(name, b"mine", attachment=pack(Attachment(1, number := number + 1, 0, 0.0)))

    thread = threading.Thread(target=publish)
    thread.start()
    code, _, err = replayed(recording.path)
    stopped.set()
    thread.join()
    assert (code, "somebody publishes robot_bridge/state on this rig already: stop it" in err) == (2, True)
    assert not [m for m in heard if "/replay/" in m.key]


def test_of_a_damaged_recording_what_can_be_read_is_sent(replayed, recording, heard, settings, tmp_path):
    path, data = tmp_path / "damaged.mcap", bytearray(recording.path.read_bytes())
    data[len(data) // 3] ^= 0xFF
    path.write_bytes(data)
    code, _, err = replayed(path, "--fast", "--topics", "robot_bridge/state")
    assert code == 3
    assert "warning: " in err
    assert "not all was replayed: " in err
    states = [m.payload for m in by_key(heard)[key(settings.rig, ROBOT_STATE, "psm1")]]
    assert 20 < len(states) < 200
    assert states == [f"robot_bridge/state {n}".encode() for n in range(len(states))]


def test_what_cannot_be_replayed_is_said_in_one_line(recording, tmp_path, capsys):
    foreign = tmp_path / "notes.mcap"
    foreign.write_text("no recording")
    for path, options, said in (
        (tmp_path / "missing.mcap", (), "missing.mcap cannot be read: No such file"),
        (foreign, (), "is no recording"),
        (recording.path, ("--from", "60"), "--from 60 lies beyond the end of the recording, which lasts 2.0 s"),
        (recording.path, ("--rate", "0"), "--rate 0 must lie above 0"),
    ):
        with pytest.raises(SystemExit) as ended:
            main(["replay", str(path), *options])
        out, err = capsys.readouterr()
        assert (ended.value.code, out, err.count("\n")) == (2, "", 1)
        assert said in err
