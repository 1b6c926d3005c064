"""`suturegrasp recompute FILE --through AGENTS`: what it says, writes and ends with."""

import dataclasses
import hashlib
import json
import os
from typing import Any

import pytest

from agents.camera.scene_source import calibration_of
from agents.cli.main import main
from agents.cli.recordings.config import changed, in_force, recorded_config
from agents.cli.recordings.options import Recompute
from agents.cli.recordings.recompute import (
    EXIT_DIFFERENT,
    EXIT_SAME,
    replayed,
    write_recording,
)
from agents.cli.recordings.recompute_report import curves_of
from agents.configuration.rig import CameraSection, PerceptionSection, ReconstructionSection, simulated_rig
from agents.launch.process import EXIT_UNUSABLE
from agents.perception.agent import Perception
from agents.reconstruction.agent import Reconstruction
from agents.recorder.cutting import cut
from agents.replay.through import Stage, replay_through
from schemas.codec import decode, encode
from schemas.messages import ImageEncoding, RectifiedStereo, StereoFrame, ThreadObservations
from schemas.topics import CALIBRATION, FRAMES, OBSERVATIONS, THREAD, topic_of
from shared.images import encode_image
from shared.recording.completeness import completeness
from shared.recording.mcap_file import read_attachments, read_recording
from shared.runtime.agent import Output
from shared.runtime.config import ConfigError
from shared.runtime.replay import Lockstep
from tests.goldens.bless import GOLDENS, THROUGH, blessed
from tests.replay.conftest import of
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


@pytest.fixture
def ran(capsys):
    """Runs it: the status, what it said, what it complained of."""

    def recompute(path, through=THROUGH, **options):
        given = [(name, value if isinstance(value, tuple) else (value,)) for name, value in options.items()]
        more = [word for name, values in given for value in values for word in (f"--{name}", str(value))]
        with pytest.raises(SystemExit) as ended:
            main(["recompute", str(path), "--through", through, *more])
        status, said = ended.value.code, capsys.readouterr()
        assert status != EXIT_UNUSABLE or (said.out, said.err.count("\n")) == ("", 1)
        return status, said.out, said.err

    return recompute


def without(topic, number=None):
    return lambda e: None if topic_of(e.key) is topic and number in (None, e.sequence) else e


def test_the_same_ends_with_0_and_says_how_long_it_took(golden, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["recompute", str(golden), "--through", "reconstruction,planner", "--tolerances", "none"])
    said = capsys.readouterr()
    assert (ended.value.code, said.err) == (EXIT_SAME, "")
    assert "reconstruction: 2 of 2 outputs repeated, 2 byte for byte the same" in said.out
    assert "all that was compared is the same" in said.out
    assert "times as long" in said.out.splitlines()[-1]


def test_what_a_replay_writes_is_the_recording_and_what_was_done_to_it(golden, tmp_path, ran):
    file = tmp_path / "a.mcap"
    assert ran(golden, "perception,reconstruction", output=file)[0] == EXIT_SAME
    assert list(read_recording(file)) == list(read_recording(golden))
    (told,) = completeness(file).derived
    assert (told.source, told.sha256) == (golden.name, hashlib.sha256(golden.read_bytes()).hexdigest())
    assert (list(told.agents), told.settings) == (["perception", "reconstruction"], {})
    assert (told.agents["perception"].step_ms_p50 or 0) > 0
    assert read_attachments(file).keys() == read_attachments(golden).keys()
    assert recorded_config(file) == recorded_config(golden)


def test_another_setting_shows_where_and_by_how_much(golden, tmp_path, ran):
    output = tmp_path / "paper.mcap"
    status, out, err = ran(golden, "perception,reconstruction", set=("reconstruction.method=paper",), output=output)
    assert (status, err) == (EXIT_DIFFERENT, "")
    assert "otherwise than recorded: --set reconstruction.method=paper; compared within tolerances" in out
    row = next(line.split() for line in out.splitlines() if line.split()[:1] == ["points!"])
    assert row[1:4] == ["2", "2", "other"]
    # what fails now differs in all else too, which says nothing more
    assert "2 times ok → failed: " in out and "method!" not in out
    made = list(read_recording(output))
    assert [thread.method for thread in of(made, THREAD)] == ["paper"] * 2
    # what is attached is what is in force: for those that ran anew, and no others
    (told,) = completeness(output).derived
    assert told.settings["reconstruction.method"] == "refined -> paper"
    assert recorded_config(output).reconstruction == ReconstructionSection(method="paper")
    assert recorded_config(output).planner == recorded_config(golden).planner
    # the other method needs matched pixels, which perception of the same chain makes for it
    assert all(len(seen.matched_px) > 1000 for seen in of(made, OBSERVATIONS))


def test_the_configuration_in_force_says_what_perception_made_whoever_ran_anew():
    paper, refined = (changed(simulated_rig(), [f"reconstruction.method={method}"]) for method in ("paper", "refined"))
    # observations as they were, with matches, and a method that needs none; and the other way round
    assert in_force(paper, refined, ["reconstruction"]).perception == PerceptionSection(matching=True)
    assert in_force(refined, paper, ["perception", "reconstruction"]).perception == PerceptionSection()
    with pytest.raises(ConfigError, match="needs matches, which perception did not make"):
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
    assert (alone.comparison.is_same, chained.comparison.is_same) == (False, False)
    assert [e.payload for e in chained.after] == [e.payload for e in read_recording(golden)]


def test_what_lacks_inputs_is_said_and_no_difference_unless_nothing_can_be_repeated(copied, ran):
    status, out, _ = ran(copied(without(OBSERVATIONS, 0)), "reconstruction")
    assert status == EXIT_SAME
    assert "1 of 2 outputs repeated" in out
    assert "1 cannot be repeated: the recording lacks 1 of suturegrasp/golden/perception/main/observations" in out
    # one agent keeps no other from its replay
    path = copied(without(CALIBRATION))
    status, out, _ = ran(path, "perception,reconstruction")
    assert status == EXIT_SAME
    assert "perception: 0 of " in out and "reconstruction: 2 of 2 outputs repeated, 2 byte for byte the same" in out
    assert "no output of these agents can be repeated: of perception, the recording" in ran(path, "perception")[2]


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


def test_an_output_that_is_made_no_more_is_a_difference_and_steps_that_fail_are_counted(golden):
    class Silent(Reconstruction):
        """Says nothing of frame 1."""

        def step(self, arrived: Any):
            made = list(super().step(arrived))
            return [] if arrived.message.stamp.sequence == 1 else made

    class Failing(Reconstruction):
        """Cannot do what it should."""

        def step(self, arrived: Any):
            raise ZeroDivisionError(f"by {arrived.topic}")

    entries = list(read_recording(golden))
    (outcome,), after = replay_through([Stage("reconstruction", Silent)], entries)
    assert [output.now is None for output in outcome.outputs] == [False, True]
    assert len(after) == len(entries) - 1
    (outcome,), _ = replay_through([Stage("reconstruction", Failing)], entries)
    # fed with both observations, and with the recorded thread where it has made none of its own
    assert (outcome.faults, outcome.first_fault) == (3, "ZeroDivisionError: by perception/observations")


def test_agents_that_consume_each_others_outputs_are_replayed_together():
    camera = RectifiedStereo(480, 270, 500.0, 500.0, 239.5, 134.5, 5.5, 1e-3)
    lockstep = Lockstep(Perception(), Reconstruction(), rig="tracked")
    lockstep.tell([Output(CALIBRATION, calibration_of(camera))])
    for number, drawn in enumerate(images_of("medium", 3, Kind("slow", 2.0, 5.0), 4, camera, "tissue")):
        left, right = (encode_image(image, ImageEncoding.RAW) for image in drawn.images)
        lockstep.tell([Output(FRAMES, StereoFrame(stamp_of(number), left, right))])
    tracked = lockstep.entries

    def stages(method="refined"):
        return [Stage("perception", Perception), Stage("reconstruction", lambda: Reconstruction(method))]

    outcomes, after = replay_through(stages(), tracked)
    assert all(output.same for outcome in outcomes for output in outcome.outputs)
    assert after == tracked
    listened = [any(topic_of(c.key) is THREAD for c in one.consumed) for one in of(tracked, OBSERVATIONS)]
    assert listened == [False, True, True, True]
    # threads of another method have no track, so that perception is told nothing of where the curve is
    (observed, _), _ = replay_through(stages("paper"), tracked)
    same = [output.same for output in observed.outputs if topic_of(output.key) is OBSERVATIONS]
    assert same == [True, False, False, False]


def test_both_sides_and_the_differences_are_in_one_rerun_file(golden, tmp_path, ran):
    from rerun.chunk import RrdReader

    output, changes = tmp_path / "diff.rrd", ("reconstruction.tracking=false",)
    status, out, _ = ran(golden, "reconstruction", set=changes, output=output)
    assert (status, f"wrote {output}" in out) == (EXIT_DIFFERENT, True)
    result = replayed(Recompute(golden, through="reconstruction", set=changes))
    paths = {str(chunk.entity_path) for chunk in RrdReader(output).stream()}
    for side in ("recorded", "replayed"):
        assert {f"/{side}/world/left/image", f"/{side}/world/thread/curve", f"/{side}/world/left"} <= paths
    assert {f"/difference/{curve}" for curve in curves_of(result.comparison)} <= paths


@pytest.mark.parametrize(
    ("through", "options", "says"),
    [
        ("perseption", {}, "'perseption' is no agent that can be replayed; choose from camera, perception"),
        ("planner/left", {}, "has no planner/left"),
        ("robot_bridge", {}, "has no robot_bridge; give another one by --config"),
        ("perception", {"set": ("perception.segmentor=ridge",)}, "is unknown; did you mean segmenter?"),
        ("perception", {"set": ("rig.name=x",)}, "rig is no section with keys of its own"),
    ],
)
def test_what_cannot_be_replayed_is_said_in_one_line(through, options, says, golden, ran):
    status, _, err = ran(golden, through, **options)
    assert (status, says in err) == (EXIT_UNUSABLE, True)


def test_a_file_that_cannot_be_used_or_written_is_said_in_one_line(golden, tmp_path, copied, ran):
    def spoilt(entry):
        return dataclasses.replace(entry, payload=b"\xff\xff") if topic_of(entry.key) is THREAD else entry

    (tmp_path / "text.mcap").write_text("no recording at all")
    for path, says in (
        (tmp_path / "text.mcap", "is no recording"),
        (tmp_path / "none.mcap", "No such file"),
        (copied(spoilt), "ThreadReconstruction cannot be read"),
    ):
        status, _, err = ran(path, "reconstruction")
        assert (status, says in err) == (EXIT_UNUSABLE, True)
    # neither over the recording, nor into nowhere
    link = tmp_path / "link.mcap"
    os.link(golden, link)
    for output in (golden, link, tmp_path / "none" / "a.rrd", tmp_path / "a.txt"):
        status, _, err = ran(golden, "reconstruction", output=output)
        assert (status, f"--output {output}" in err) == (EXIT_UNUSABLE, True)


@pytest.mark.parametrize(("share", "status"), [(0.3, EXIT_UNUSABLE), (0.95, EXIT_SAME)])
def test_a_recording_that_was_cut_off_is_replayed_as_far_as_it_goes(share, status, golden, tmp_path, ran):
    path = tmp_path / "session.mcap"
    path.write_bytes(golden.read_bytes()[: int(share * golden.stat().st_size)])
    (tmp_path / "rig.json").write_text(simulated_rig().model_dump_json())
    ended, _, err = ran(path, "perception")
    assert (ended, "warning: cut off at" in err) == (status, status == EXIT_SAME)


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
