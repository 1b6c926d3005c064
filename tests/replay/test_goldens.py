"""The golden recordings: what perception, reconstruction and planner make of them is what was blessed.

Compared within the tolerances of docs/recordings.md, since another processor rounds otherwise.
"""

import dataclasses
import shutil

import pytest

from agents.cli.recordings.options import Recompute
from agents.cli.recordings.recompute import replayed
from agents.cli.recordings.recompute_report import report
from agents.reconstruction.agent import Reconstruction
from agents.replay.differences import compared
from agents.replay.through import Stage, replay_through
from schemas.codec import decode, encode
from schemas.messages import GraspPlan, Status, StereoCalibration, StereoFrame, ThreadObservations, ThreadReconstruction
from schemas.topics import CALIBRATION, FRAMES, OBSERVATIONS, PLAN, THREAD, topic_of
from shared.calibration.identity import calibration_id
from shared.recording.mcap_file import read_recording
from tests.goldens.bless import GOLDENS, THROUGH, blessed
from tests.goldens.record import SCENES

PATHS = sorted(GOLDENS.glob("*.mcap"))
every_golden = pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
MOST_BYTES = 1_000_000


def of(entries, topic, message):
    return [decode(message, e.payload) for e in entries if topic_of(e.key) is topic]


@pytest.fixture(scope="module")
def results():
    """Each golden recording replayed once, as it was recorded."""
    return {path: replayed(Recompute(path, through=THROUGH, tolerances="table")) for path in PATHS}


@every_golden
def test_what_the_agents_say_is_what_was_blessed(path, results):
    result = results[path]
    hint = f"if that is meant to be so: make bless\n{chr(10).join(report(result))}"
    assert result.comparison.is_same, hint
    assert all(outcome.compared and not outcome.unrepeatable for outcome in result.outcomes)
    assert not sum(outcome.faults for outcome in result.outcomes)


@every_golden
def test_a_golden_recording_leads_from_images_to_plans(path, results):
    entries = results[path].before
    assert len(of(entries, FRAMES, FRAMES.message)) >= 2
    assert all(o.status is Status.OK for o in of(entries, OBSERVATIONS, ThreadObservations))
    assert all(t.status is Status.OK for t in of(entries, THREAD, ThreadReconstruction))
    assert [plan.status for plan in of(entries, PLAN, GraspPlan)] == [Status.OK, Status.OK]


def test_the_golden_recordings_are_those_that_can_be_made_and_small():
    assert {path.stem for path in PATHS} == set(SCENES)
    assert sum(path.stat().st_size for path in PATHS) < MOST_BYTES


@every_golden
def test_a_calibration_that_is_off_by_a_fifth_of_a_pixel_shows(path, results):
    """The least that must show: half a millimetre of depth, which decides about a grasp."""

    recorded = next(e for e in results[path].before if topic_of(e.key) is CALIBRATION)
    calibration = decode(StereoCalibration, recorded.payload)
    K_right = calibration.K_right.copy()
    K_right[0, 2] += 0.2
    off = dataclasses.replace(calibration, K_right=K_right)

    def turned(entry):
        if topic_of(entry.key) is FRAMES:
            frame = decode(StereoFrame, entry.payload)
            stamp = dataclasses.replace(frame.stamp, calibration_id=calibration_id(off))
            return dataclasses.replace(entry, payload=encode(dataclasses.replace(frame, stamp=stamp)))
        return dataclasses.replace(entry, payload=encode(off)) if topic_of(entry.key) is CALIBRATION else entry

    stages = [Stage("perception", lambda: _built(path, "perception")), Stage("reconstruction", Reconstruction)]
    outcomes, _ = replay_through(stages, [turned(entry) for entry in results[path].before])
    outputs = [output for outcome in outcomes for output in outcome.outputs]
    comparison = compared(outputs, lambda _: 0, exactly=False)
    assert {row.field for row in comparison.rows if row.beyond} >= {"curve", "ends"}


def _built(path, kind):
    from agents.cli.recordings.config import recorded_config
    from agents.launch.builders import build

    return build(recorded_config(path), kind, "main")


def test_a_blessed_recording_repeats_byte_for_byte_and_keeps_what_it_is_fed(tmp_path):
    path = tmp_path / "crossing.mcap"
    shutil.copy(GOLDENS / path.name, path)
    before = list(read_recording(path))
    blessed(path)
    again = replayed(Recompute(path, through=THROUGH, tolerances="none"))
    assert again.comparison.is_same
    made = {OBSERVATIONS, THREAD, PLAN}
    fed = [[e for e in entries if topic_of(e.key) not in made] for entries in (before, again.before)]
    assert fed[0] == fed[1]
    once = path.read_bytes()
    blessed(path)
    assert path.read_bytes() == once
