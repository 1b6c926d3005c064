"""The golden recordings: what perception, reconstruction and planner make of them is what was blessed.

Compared within the tolerances of docs/recordings.md, since another processor rounds otherwise.
"""

import dataclasses
import shutil

import pytest

from agents.cli.recordings.config import recorded_config
from agents.cli.recordings.options import Recompute
from agents.cli.recordings.recompute import replayed
from agents.cli.recordings.recompute_report import report
from agents.launch.builders import build
from agents.reconstruction.agent import Reconstruction
from agents.replay.differences import compared
from agents.replay.through import Stage, replay_through
from schemas.codec import decode, encode
from schemas.messages import Status, StereoCalibration
from schemas.topics import CALIBRATION, FRAMES, OBSERVATIONS, PLAN, THREAD, topic_of
from shared.calibration.identity import calibration_id
from shared.recording.mcap_file import read_recording
from tests.goldens.bless import GOLDENS, THROUGH, blessed
from tests.goldens.record import SCENES
from tests.replay.conftest import of

every_golden = pytest.mark.parametrize("path", [GOLDENS / f"{name}.mcap" for name in SCENES], ids=SCENES)


@every_golden
def test_what_the_agents_say_from_images_to_plans_is_what_was_blessed(path):
    result = replayed(Recompute(path, through=THROUGH, tolerances="table"))
    hint = f"if that is meant to be so: make bless\n{chr(10).join(report(result))}"
    assert result.comparison.is_same, hint
    assert all(outcome.compared and not outcome.unrepeatable for outcome in result.outcomes)
    assert not sum(outcome.faults for outcome in result.outcomes)
    for topic, least in ((OBSERVATIONS, 2), (THREAD, 2), (PLAN, 2)):
        statuses = [message.status for message in of(result.before, topic)]
        assert len(statuses) >= least
        assert set(statuses) == {Status.OK}


@every_golden
def test_a_calibration_that_is_off_by_a_fifth_of_a_pixel_shows(path):
    """The least that must show: half a millimetre of depth, which decides about a grasp."""
    entries = list(read_recording(path))
    (calibration,) = of(entries, CALIBRATION)
    K_right = calibration.K_right.copy()
    K_right[0, 2] += 0.2
    off: StereoCalibration = dataclasses.replace(calibration, K_right=K_right)

    def turned(entry):
        if topic_of(entry.key) is FRAMES:
            frame = decode(FRAMES.message, entry.payload)
            stamp = dataclasses.replace(frame.stamp, calibration_id=calibration_id(off))
            return dataclasses.replace(entry, payload=encode(dataclasses.replace(frame, stamp=stamp)))
        return dataclasses.replace(entry, payload=encode(off)) if topic_of(entry.key) is CALIBRATION else entry

    perception = Stage("perception", lambda: build(recorded_config(path), "perception", "main"))
    outcomes, _ = replay_through([perception, Stage("reconstruction", Reconstruction)], list(map(turned, entries)))
    outputs = [output for outcome in outcomes for output in outcome.outputs]
    comparison = compared(outputs, lambda _: 0, exactly=False)
    assert {row.field for row in comparison.rows if row.beyond} >= {"curve", "ends"}


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
