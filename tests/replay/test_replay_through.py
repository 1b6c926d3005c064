"""`suturegrasp replay FILE --through AGENTS`: what it says, writes and ends with."""

import dataclasses
import hashlib
import json
import os

import pytest
from mcap.writer import Writer

from agents.camera.scene_source import calibration_of
from agents.cli.main import main
from agents.cli.recordings.config import changed, in_force, recorded_config
from agents.cli.recordings.options import Recompute
from agents.cli.recordings.recompute import (
    EXIT_DIFFERENT,
    EXIT_SAME,
    EXIT_UNUSABLE,
    replayed,
    run,
    write_recording,
)
from agents.cli.recordings.side_by_side import curves_of
from agents.configuration.rig import CameraSection, PerceptionSection, ReconstructionSection, simulated_rig
from agents.perception.agent import Perception
from agents.reconstruction.agent import Reconstruction
from agents.recorder.cutting import cut
from agents.replay.through import Stage, replay_through
from schemas.codec import decode, encode
from schemas.messages import ImageEncoding, RectifiedStereo, StereoFrame, ThreadObservations, ThreadReconstruction
from schemas.topics import CALIBRATION, FRAMES, OBSERVATIONS, THREAD, topic_of
from shared.images import encode_image
from shared.recording.completeness import completeness
from shared.recording.mcap_file import read_attachments, read_recording
from shared.runtime.agent import Output, Received
from shared.runtime.config import ConfigError
from shared.runtime.replay import Lockstep
from tests.goldens.bless import GOLDENS, THROUGH, blessed
from tests.rigs.sequences import Kind, images_of, stamp_of


@pytest.fixture(scope="module")
def golden(tmp_path_factory):
    """A golden recording as this machine makes it, whatever it rounds."""
    path = tmp_path_factory.mktemp("golden") / "session.mcap"
    path.write_bytes((GOLDENS / "crossing.mcap").read_bytes())
    blessed(path)
    return path


@pytest.fixture
def copied(golden, tmp_path):
    """Writes a copy of the recording with each message changed by a function, or left out where that gives None."""

    def copy(change, attached=True):
        path = tmp_path / "changed.mcap"
        entries = [entry for entry in map(change, read_recording(golden)) if entry is not None]
        write_recording(path, entries, (), read_attachments(golden) if attached else {})
        return path

    return copy


def ran(capsys, path, through=THROUGH, **options):
    status = run(Recompute(path, through=through, **options))
    said = capsys.readouterr()
    return status, said.out, said.err


def without(topic, number=None):
    return lambda e: None if topic_of(e.key) is topic and number in (None, e.sequence) else e


@pytest.mark.slow
def test_the_command_ends_with_the_status(golden, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["recompute", str(golden), "--through", "planner"])
    said = capsys.readouterr()
    assert (ended.value.code, said.err) == (EXIT_SAME, "")
    assert "planner: 2 of 2 outputs repeated" in said.out


def test_the_same_ends_with_0_and_says_how_long_it_took(golden, capsys):
    status, out, err = ran(capsys, golden, "reconstruction,planner", tolerances="none")
    assert (status, err) == (EXIT_SAME, "")
    assert "reconstruction: 2 of 2 outputs repeated, 2 byte for byte the same" in out
    assert "all that was compared is the same" in out
    assert "times as long" in out.splitlines()[-1]


def test_what_a_replay_writes_is_the_recording_and_what_was_done_to_it(golden, tmp_path, capsys):
    file = tmp_path / "a.mcap"
    assert ran(capsys, golden, "perception,reconstruction", output=file)[0] == EXIT_SAME
    assert list(read_recording(file)) == list(read_recording(golden))
    (told,) = completeness(file).derived
    assert (told.source, told.sha256) == (golden.name, hashlib.sha256(golden.read_bytes()).hexdigest())
    assert (list(told.agents), told.settings) == (["perception", "reconstruction"], {})
    assert (told.agents["perception"].step_ms_p50 or 0) > 0
    assert read_attachments(file).keys() == read_attachments(golden).keys()
    assert recorded_config(file) == recorded_config(golden)


def test_another_setting_shows_where_and_by_how_much(golden, tmp_path, capsys):
    output = tmp_path / "paper.mcap"
    setting = ("reconstruction.method=paper",)
    status, out, err = ran(capsys, golden, "perception,reconstruction", set=setting, output=output)
    assert (status, err) == (EXIT_DIFFERENT, "")
    assert "otherwise than recorded: --set reconstruction.method=paper; compared within tolerances" in out
    row = next(line.split() for line in out.splitlines() if line.split()[:1] == ["points!"])
    assert row[1:4] == ["2", "2", "other"]
    # what fails now differs in all else too, which says nothing more
    assert "2 times ok → failed: " in out and "method!" not in out
    threads = [decode(ThreadReconstruction, e.payload) for e in read_recording(output) if topic_of(e.key) is THREAD]
    assert [t.method for t in threads] == ["paper"] * 2
    # what is attached is what is in force: for those that ran anew, and no others
    (told,) = completeness(output).derived
    assert told.settings["reconstruction.method"] == "refined -> paper"
    assert recorded_config(output).reconstruction == ReconstructionSection(method="paper")
    assert recorded_config(output).planner == recorded_config(golden).planner
    # the other method needs matched pixels, which perception of the same chain makes for it
    seen = [decode(ThreadObservations, e.payload) for e in read_recording(output) if topic_of(e.key) is OBSERVATIONS]
    assert all(len(observations.matched_px) > 1000 for observations in seen)


def test_the_configuration_in_force_says_what_perception_made_whoever_ran_anew():
    paper, refined = (changed(simulated_rig(), [f"reconstruction.method={method}"]) for method in ("paper", "refined"))
    # observations as they were, with matches, and a method that needs none; and the other way round
    assert in_force(paper, refined, ["reconstruction"]).perception == PerceptionSection(matching=True)
    assert in_force(refined, paper, ["perception", "reconstruction"]).perception == PerceptionSection()
    with pytest.raises(ConfigError, match=r"needs perception\.matching = true"):
        in_force(refined, paper, ["reconstruction"])


@pytest.mark.slow
def test_what_one_agent_says_otherwise_reaches_the_next(golden, copied):
    def cut_short(entry):
        """A recording whose observations were worse than what perception makes of its frames."""
        if topic_of(entry.key) is not OBSERVATIONS:
            return entry
        seen = decode(ThreadObservations, entry.payload)
        left = seen.centrelines_left
        half = dataclasses.replace(left, **{f: getattr(left, f)[: len(left.piece) // 2] for f in left.__annotations__})
        return dataclasses.replace(entry, payload=encode(dataclasses.replace(seen, centrelines_left=half)))

    path = copied(cut_short)
    # whatever the order in which they are named
    backwards = ",".join(reversed(THROUGH.split(",")))
    alone, chained = (replayed(Recompute(path, through=names)) for names in ("reconstruction", backwards))
    good = {(e.key, e.sequence): e.payload for e in read_recording(golden)}
    repaired = {(e.key, e.sequence): e.payload for e in chained.after}
    assert not alone.comparison.is_same
    assert not chained.comparison.is_same
    assert {key for key in good if repaired[key] != good[key]} == set()


def test_what_lacks_an_input_or_holds_an_unreadable_one_is_unusable(copied, capsys):
    def spoilt(entry):
        return dataclasses.replace(entry, payload=b"\xff\xff") if topic_of(entry.key) is THREAD else entry

    for change, through, said in (
        (without(CALIBRATION), "perception", "no output of these agents can be repeated: of perception, the recording"),
        (spoilt, "reconstruction", "ThreadReconstruction cannot be read"),
    ):
        status, _, err = ran(capsys, copied(change), through)
        assert (status, err.count("\n")) == (EXIT_UNUSABLE, 1)
        assert said in err


def test_one_agent_that_lacks_its_inputs_keeps_no_other_from_its_replay(copied, capsys):
    status, out, _ = ran(capsys, copied(without(CALIBRATION)), "perception,reconstruction")
    assert status == EXIT_SAME
    assert "perception: 0 of " in out and "reconstruction: 2 of 2 outputs repeated, 2 byte for byte the same" in out


@pytest.mark.parametrize("only_used_frames", [False, True])
def test_a_stretch_goes_through_agents_as_the_whole(golden, tmp_path, only_used_frames):
    entries = [entry for entry in read_recording(golden) if not entry.repeated]
    frames = [entry.received_ns for entry in entries if topic_of(entry.key) is FRAMES]
    stretch = tmp_path / "stretch.mcap"
    # what follows from the first frame is made of what came before
    cut(golden, stretch, frames[0] + 1, entries[-1].received_ns, only_used_frames)
    result = replayed(Recompute(stretch, through=THROUGH))
    assert [outcome.unrepeatable for outcome in result.outcomes] == [[]] * len(result.outcomes)
    assert all(outcome.compared for outcome in result.outcomes)
    assert result.comparison.is_same


def test_what_cannot_be_repeated_is_said_and_no_difference(copied, capsys):
    status, out, _ = ran(capsys, copied(without(OBSERVATIONS, 0)), "reconstruction")
    assert status == EXIT_SAME
    assert "1 of 2 outputs repeated" in out
    assert "1 cannot be repeated: the recording lacks 1 of suturegrasp/golden/perception/main/observations" in out


def test_an_output_that_is_made_no_more_is_a_difference(golden):
    class Silent(Reconstruction):
        """Says nothing of frame 1."""

        def step(self, arrived):
            assert isinstance(arrived, Received)
            made = list(super().step(arrived))
            return [] if arrived.message.stamp.sequence == 1 else made

    entries = list(read_recording(golden))
    (outcome,), after = replay_through([Stage("reconstruction", Silent)], entries)
    assert [output.now is None for output in outcome.outputs] == [False, True]
    assert len(after) == len(entries) - 1


def test_steps_that_fail_are_counted_with_their_first_reason(golden):
    class Failing(Reconstruction):
        """Cannot do what it should."""

        def step(self, arrived):
            assert isinstance(arrived, Received)
            raise ZeroDivisionError(f"by {arrived.topic}")

    (outcome,), _ = replay_through([Stage("reconstruction", Failing)], list(read_recording(golden)))
    # fed with both observations, and with the recorded thread where it has made none of its own
    assert (outcome.faults, outcome.first_fault) == (3, "ZeroDivisionError: by perception/observations")


@pytest.fixture(scope="module")
def tracked():
    """A session of perception and reconstruction, each of which consumes what the other says."""
    camera = RectifiedStereo(480, 270, 500.0, 500.0, 239.5, 134.5, 5.5, 1e-3)
    lockstep = Lockstep(Perception(), Reconstruction(), rig="tracked")
    lockstep.tell([Output(CALIBRATION, calibration_of(camera))])
    for number, drawn in enumerate(images_of("medium", 3, Kind("slow", 2.0, 5.0), 4, camera, "tissue")):
        left, right = (encode_image(image, ImageEncoding.RAW) for image in drawn.images)
        lockstep.tell([Output(FRAMES, StereoFrame(stamp_of(number), left, right))])
    return lockstep.entries


def test_agents_that_consume_each_others_outputs_are_replayed_together(tracked):
    def stages(method="refined"):
        return [Stage("perception", Perception), Stage("reconstruction", lambda: Reconstruction(method))]

    outcomes, after = replay_through(stages(), tracked)
    assert all(output.same for outcome in outcomes for output in outcome.outputs)
    assert after == tracked
    listed = [decode(ThreadObservations, entry.payload) for entry in tracked if topic_of(entry.key) is OBSERVATIONS]
    assert [any(topic_of(c.key) is THREAD for c in one.consumed) for one in listed] == [False, True, True, True]
    # threads of another method have no track, so that perception is told nothing of where the curve is
    (observed, _), _ = replay_through(stages("paper"), tracked)
    assert [output.same for output in observed.outputs if topic_of(output.key) is OBSERVATIONS] == [
        True,
        False,
        False,
        False,
    ]


def test_both_sides_and_the_differences_are_in_one_rerun_file(golden, tmp_path, capsys):
    from rerun.chunk import RrdReader

    output = tmp_path / "diff.rrd"
    changes = ("reconstruction.tracking=false",)
    status, out, _ = ran(capsys, golden, "reconstruction", set=changes, output=output)
    assert (status, f"wrote {output}" in out) == (EXIT_DIFFERENT, True)
    result = replayed(Recompute(golden, through="reconstruction", set=changes))
    paths = {str(chunk.entity_path) for chunk in RrdReader(output).stream()}
    for side in ("recorded", "replayed"):
        assert {f"/{side}/world/left/image", f"/{side}/world/thread/curve", f"/{side}/world/left"} <= paths
    assert {f"/difference/{curve}" for curve in curves_of(result.comparison)} <= paths


def foreign(path):
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="other")
        writer.finish()


@pytest.mark.parametrize(
    ("through", "options", "says"),
    [
        ("perseption", {}, "'perseption' is no agent that can be replayed; choose from camera, perception"),
        ("planner/left", {}, "has no planner/left"),
        ("robot_bridge", {}, "has no robot_bridge; give another one by --config"),
        ("perception", {"tolerances": "few"}, "--tolerances few is unknown; choose from auto, none, table"),
        (
            "perception",
            {"set": ("perception.segmentor=ridge",)},
            "perception.segmentor is unknown; did you mean segmenter?",
        ),
        ("perception", {"set": ("rig.name=x",)}, "rig is no section with keys of its own"),
    ],
)
def test_what_cannot_be_replayed_is_said_in_one_line(through, options, says, golden, capsys):
    status, out, err = ran(capsys, golden, through, **options)
    assert (status, out, err.count("\n")) == (EXIT_UNUSABLE, "", 1)
    assert says in err


def test_a_file_that_cannot_be_used_is_said_in_one_line(tmp_path, capsys):
    bad = {
        "text.mcap": (b"no recording at all", "is no recording"),
        "empty.mcap": (b"", "is no recording"),
    }
    for name, (data, says) in bad.items():
        path = tmp_path / name
        path.write_bytes(data)
        status, out, err = ran(capsys, path)
        assert (status, out, err.count("\n"), says in err) == (EXIT_UNUSABLE, "", 1, True), err
    foreign(tmp_path / "foreign.mcap")
    for path, says in (
        (tmp_path / "foreign.mcap", "MCAP file of another program"),
        (tmp_path / "none.mcap", "No such file"),
    ):
        status, out, err = ran(capsys, path)
        assert (status, out, err.count("\n"), says in err) == (EXIT_UNUSABLE, "", 1, True), err


@pytest.mark.parametrize("share", [0.3, 0.95])
def test_a_recording_that_was_cut_off_is_replayed_as_far_as_it_goes(share, golden, tmp_path, capsys):
    path = tmp_path / "session.mcap"
    path.write_bytes(golden.read_bytes()[: int(share * golden.stat().st_size)])
    (tmp_path / "rig.json").write_text(simulated_rig().model_dump_json())
    status, out, err = ran(capsys, path, "perception")
    assert status in (EXIT_SAME, EXIT_UNUSABLE)
    assert (status == EXIT_UNUSABLE) == ("suturegrasp:" in err)
    assert (status == EXIT_SAME) == ("warning: cut off at" in err)
    assert status == EXIT_SAME or out == ""


def test_an_output_is_not_written_over_the_recording_nor_into_nowhere(golden, tmp_path, capsys):
    link = tmp_path / "link.mcap"
    os.link(golden, link)
    for output in (golden, link, tmp_path / "none" / "a.rrd", tmp_path / "a.txt"):
        status, _, err = ran(capsys, golden, "reconstruction", output=output)
        assert (status, err.count("\n"), f"--output {output}" in err) == (EXIT_UNUSABLE, 1, True)


def test_the_configuration_is_the_attached_one_or_lies_beside(golden, copied):
    assert recorded_config(golden).rig == "golden"
    bare = copied(lambda entry: entry, attached=False)
    with pytest.raises(ConfigError, match="holds no configuration, and no rig"):
        recorded_config(bare)
    (bare.parent / "rig.json").write_text(json.dumps({"rig": "beside"}))
    assert recorded_config(bare).rig == "beside"


def test_settings_are_read_as_in_toml_or_as_words():
    settings = ("reconstruction.tracking=false", "camera.rate_hz = 12.5", "perception.segmenter=network")
    rig = changed(simulated_rig(), settings)
    assert rig.reconstruction == ReconstructionSection(tracking=False)
    assert rig.camera == CameraSection(rate_hz=12.5)
    assert rig.perception == PerceptionSection(segmenter="network")
    assert changed(simulated_rig(), ()) == simulated_rig()
