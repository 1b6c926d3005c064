"""`suturegrasp record` as a process: what it is told, what it writes about the run, and events that a person makes."""

import contextlib
import json
import signal
import subprocess
import sys

import pytest

from agents.cli.live.options import Record
from agents.cli.recordings.record import section_of, settings_of
from agents.configuration.rig import RecorderSection, RigConfig
from schemas.codec import encode
from schemas.messages import LogLevel, LogRecord
from schemas.topics import LOG, key
from shared.recording.completeness import completeness
from shared.recording.mcap_file import is_finished, read_attachments, read_notes, read_recording
from shared.runtime.attachment import Attachment, pack
from shared.runtime.config import ConfigError
from shared.runtime.delivery import declare_publisher
from tests.agents.cli.conftest import SCRIPT


def test_the_command_line_goes_before_the_configuration_and_may_say_no_more():
    rig = RigConfig(recorder=RecorderSection(split_size_mb=100, protocol="p-1"))
    section = section_of(rig, Record(split_size=5.0, operator="op-7", foxglove=False))
    assert (section.split_size_mb, section.protocol, section.operator) == (5.0, "p-1", "op-7")
    settings = settings_of(section)
    assert (settings.files.split_bytes, settings.files.foxglove) == (5_000_000, False)
    assert section_of(RigConfig(), Record()) == RecorderSection()
    for options, named in ((Record(operator="Jane Doe"), "operator"), (Record(split_minutes=0.0), "split_minutes")):
        with pytest.raises(ConfigError, match=named):
            section_of(rig, options)
    # as many seconds are kept after an event as before, unless told
    both = (settings_of(RecorderSection(pre_trigger_s=30, post_trigger_s=after_s)).pre_trigger for after_s in (None, 0))
    assert [(kept.before_s, kept.after_s) for kept in both if kept] == [(30, 30), (30, 0)]


@pytest.fixture
def recording(settings, session, tmp_path, heard_by_others, rig_file):
    """Starts `suturegrasp record` on a real router and publishes to it; all is ended at the end."""
    name = key(settings.rig, LOG, agent="camera")
    with contextlib.ExitStack() as stack:

        def start(*options):
            command = [SCRIPT, "record", "--config", str(rig_file()), "--output", str(tmp_path / "a.mcap"), *options]
            process = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
            stack.callback(process.kill)
            heard_by_others(session, name)
            publisher = declare_publisher(session, name, LOG)
            stack.callback(publisher.undeclare)
            for number in range(20):
                text = encode(LogRecord(number, "camera", "main", LogLevel.INFO, "text"))
                publisher.put(text, attachment=pack(Attachment(1, number, number, 0.0)))
            return process

        yield start


@pytest.mark.rig
def test_a_recording_tells_of_what_run_and_study_it_is(recording, tmp_path, until):
    process = recording("--protocol", "p-1", "--operator", "op-7", "--consent", "research", "--retention-days", "10")
    path = tmp_path / "a.mcap"
    until(lambda: path.exists() and path.stat().st_size and len(list(read_recording(path))) == 20)
    process.send_signal(signal.SIGTERM)
    said, _ = process.communicate()
    assert said.strip().endswith("20 messages on 1 keys, complete")
    assert completeness(path).complete
    run, study = (read_notes(path, name) or {} for name in ("run", "study"))
    assert (run["rig"], run["python"]) == ("test", sys.version.split()[0])
    assert len(run["config_hash"]) == len(run["schema_hash"]) == 12
    told = {"protocol": "p-1", "operator": "op-7", "consent": "research", "retention_days": "10"}
    assert {name: study[name] for name in told} == told
    assert study["delete_after"] > run["began"][:10]
    assert json.loads(read_attachments(path)["configuration.json"])["rig"] == "test"


@pytest.mark.slow
def test_what_a_unit_runs_waits_for_room_and_says_so_where_a_person_is_told_at_once(rig_file, tmp_path, until):
    disk, full = tmp_path / "disk", tmp_path / "disk" / "full"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=8m", "tmpfs", str(disk)]
    if subprocess.run(mount, check=False).returncode != 0:
        pytest.skip("no disk can be mounted here")
    command = [SCRIPT, "record", "--config", str(rig_file()), "--output", str(disk / "a.mcap")]
    try:
        full.write_bytes(bytes(8_300_000))
        at_once = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (at_once.returncode, "nothing is recorded: " in at_once.stderr) == (2, True)
        with subprocess.Popen([*command, "--numbered"], stderr=subprocess.PIPE, text=True) as unit:
            assert unit.stderr is not None
            assert "nothing is recorded until there is room: " in unit.stderr.readline()
            full.unlink()
            until((disk / "a.mcap").exists)
            unit.send_signal(signal.SIGTERM)
            assert unit.wait() == 0, unit.stderr.read()
    finally:
        subprocess.run(["umount", "--lazy", str(disk)], check=True)  # noqa: S607


@pytest.mark.rig
def test_a_signal_keeps_the_last_seconds(recording, tmp_path, until):
    process = recording("--pre-trigger", "60", "--post-trigger", "0")

    def kept():
        """A file with all messages: those that a first signal came before are in the seconds before a later one."""
        process.send_signal(signal.SIGUSR1)
        files = [path for path in tmp_path.glob("a_*_asked.mcap") if is_finished(path)]
        return any([entry.sequence for entry in read_recording(path)] == list(range(20)) for path in files)

    until(kept)
    process.send_signal(signal.SIGTERM)
    said, _ = process.communicate()
    assert "asked: the " in said
    assert not (tmp_path / "a.mcap").exists()
