"""Following a thread from frame to frame: rendered sequences of known material points, and centrelines made by hand."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from agents.reconstruction.agent import Reconstruction
from agents.reconstruction.methods import METHODS
from agents.reconstruction.refined.tracking import track_refined
from benchmarks.tracking import on_curve
from schemas.codec import decode, encode
from schemas.messages import FrameStamp, RectifiedStereo, Status, ThreadReconstruction, TrackStep, no_centrelines
from schemas.topics import OBSERVATIONS, THREAD, key
from shared.calibration.uncertainty import ERRORS
from shared.runtime.agent import Received
from shared.splines import evaluate
from tests.agents.reconstruction.threads import lines_of, observed_curve, observed_lines
from tests.rigs.sequences import Kind, sequence

SMALL = RectifiedStereo(480, 270, 500.0, 500.0, 239.5, 134.5, 5.5, 1e-3)
CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 5.5, 1e-3)
FRAME_NS = 33_333_333
STARTED, CONTINUED, RESTARTED, LOST = (
    TrackStep.STARTED,
    TrackStep.CONTINUED,
    TrackStep.RESTARTED,
    TrackStep.LOST,
)
alone = METHODS["refined"]


def rendered(kind, frames=16):
    return list(sequence("medium", 3, kind, frames, binary=False, camera=SMALL))


def tracked(frames, last=None) -> list[Any]:
    """The thread of each frame, each with the one before in mind."""
    threads = []
    for frame in frames:
        last = track_refined(frame, last)
        threads.append(last)
    return threads


def followed(last, frame) -> Any:
    return track_refined(frame, last)


def steps_of(threads):
    return [thread.track.step for thread in threads]


def figures(threads, frames):
    """Mean error of each frame, and where each material point is on the thread."""
    found = [on_curve(thread, frame.truth) for thread, frame in zip(threads, frames, strict=True)]
    return np.array([d.mean() for _, d in found]), np.array([s[20:-20] for s, _ in found])


MATERIAL = np.linspace(0, 1, 401)[20:-20]


@pytest.mark.renders
def test_a_moving_thread_is_followed_no_worse_than_alone():
    slow = rendered(Kind("slow", 2.0, 8.0))
    threads = tracked(frame.observations for frame in slow)
    assert steps_of(threads) == [STARTED] + [CONTINUED] * (len(slow) - 1)
    error, s = figures(threads, slow)
    error_alone, s_alone = figures([alone(frame.observations) for frame in slow], slow)
    assert np.median(error) <= 1.1 * np.median(error_alone)
    assert error.max() <= 1.5 * error_alone.max()
    assert s.std(axis=0).mean() <= 1.1 * s_alone.std(axis=0).mean()
    assert np.abs(s - MATERIAL).max() < 0.003


@pytest.mark.renders
def test_behind_a_tool_s_stays_the_same_piece_of_thread():
    behind_a_tool = rendered(Kind("tool passes", 2.0, 8.0, hidden=True), frames=40)
    threads = tracked(frame.observations for frame in behind_a_tool)
    assert RESTARTED not in steps_of(threads)
    _, s = figures(threads, behind_a_tool)
    by_itself = [(alone(frame.observations), frame) for frame in behind_a_tool]
    # by itself a frame of which the tool covers much shows no thread: nobody knows of a tool here
    shown = [(thread, frame) for thread, frame in by_itself if thread.status is Status.OK]
    _, s_alone = figures(*zip(*shown, strict=True))
    assert s.std(axis=0).mean() < 0.2 * s_alone.std(axis=0).mean()
    # 40 % of the thread stays there within a millimetre of its hundred
    assert np.abs(s - MATERIAL)[:, 140].max() < 0.01
    assert any(len(thread.unseen) for thread in threads)


@pytest.mark.slow
def test_fast_motion_is_followed_and_a_thread_that_is_laid_elsewhere_is_begun_anew():
    fast = rendered(Kind("fast", 6.0, 25.0), frames=5)
    threads = tracked(frame.observations for frame in fast)
    assert steps_of(threads[1:]) == 4 * [CONTINUED]
    assert figures(threads, fast)[0].max() < 0.05
    moved = rendered(Kind("moved", 2.0, 8.0, jump_at=3), frames=6)
    threads = tracked(frame.observations for frame in moved)
    assert steps_of(threads) == [STARTED, *2 * [CONTINUED], RESTARTED, *2 * [CONTINUED]]
    assert "of the thread in both images lies within" in threads[3].track.reason
    error, s = figures(threads, moved)
    assert error.max() < 0.1
    assert np.abs(s - MATERIAL).max() < 0.01


def winding(t):
    return np.column_stack((-20 + 40 * t, 14 * np.sin(5 * t), 95 + 6 * np.cos(4 * t)))


def at_frame(number):
    return {"stamp": FrameStamp(number, number * FRAME_NS, number * FRAME_NS, "")}


def seen(shape=winding, shown=((0.0, 1.0),), number=0, camera=CAMERA, **changes):
    """Observations of a thread of which these stretches are shown."""
    return observed_curve(shape, shown, camera, **at_frame(number), **changes)


def observed(left, right, number=0):
    return observed_lines(left, right, CAMERA, **at_frame(number))


def place(thread, s):
    return evaluate(thread.knots, thread.control_points_camera, 3, np.array([s]))[0]


def off_mm(thread, s, point):
    return np.linalg.norm(place(thread, s) - point)


def backing(number):
    """The thread, nearer to the cameras from frame to frame."""
    return lambda t: winding(t) - (0.0, 0.0, 0.1 * number)


def test_no_number_of_frames_makes_certain_what_the_calibration_leaves_open():
    def oblique(t):
        # rows that are apart are not told from depth
        return np.column_stack((-20 + 40 * t, 12 - 24 * t, 95 + 2 * np.sin(3 * t)))

    variance = []
    for stated in (None, np.zeros((len(ERRORS), len(ERRORS)))):
        threads = tracked(seen(oblique, number=n, calibration_covariance=stated) for n in range(12))
        assert steps_of(threads[1:]) == 11 * [CONTINUED]
        variance.append(np.array([np.median(thread.posterior_covariance[:, 2, 2]) for thread in threads]))
    left_open = variance[0] - variance[1]
    assert left_open[1] > 0.005
    assert left_open[-1] > 0.8 * left_open[1]


def test_out_of_sight_is_a_failure_and_the_track_goes_on_after_it():
    nothing = no_centrelines()
    frames = [seen(backing(n), number=n) if n not in (2, 3) else observed(nothing, nothing, n) for n in range(6)]
    threads = tracked(frames)
    assert steps_of(threads) == [STARTED, CONTINUED, LOST, LOST, CONTINUED, CONTINUED]
    assert [thread.status is Status.OK for thread in threads] == [True] * 2 + [False] * 2 + [True] * 2
    assert threads[2].track.reason == threads[2].reason
    without_a_track = track_refined(frames[2], None)
    assert (without_a_track.status, without_a_track.track) == (Status.FAILED, None)


def test_a_course_is_kept_from_frame_to_frame_and_looked_at_again_when_the_frame_is_judged_alone():
    threads = tracked(seen(backing(number), ((0.0, 0.4), (0.5, 1.0)), number) for number in range(40))
    assert set(steps_of(threads[1:])) == {CONTINUED}
    assert threads[1].course is threads[0].course
    assert len({id(thread.course) for thread in threads}) == 2
    for thread in threads:
        assert thread.course.joins == pytest.approx(np.array([[0, 0], [0.4, 0.5], [1, 1]]), abs=0.03)


def test_the_last_thread_holds_all_that_the_next_goes_on_from():
    def fed(agent, message):
        (output,) = agent.step(Received(OBSERVATIONS, key("lab", OBSERVATIONS), 0, message))
        return output.message

    frames = [seen(backing(number), number=number) for number in range(6)]
    agent = Reconstruction()
    threads = [fed(agent, frame) for frame in frames]
    assert encode(dataclasses.replace(threads[0], track=None)) == encode(alone(frames[0]))
    for number in (0, 4):
        other = Reconstruction()
        last = decode(ThreadReconstruction, encode(threads[number]))
        assert list(other.step(Received(THREAD, key("lab", THREAD), 0, last))) == []
        assert encode(fed(other, frames[number + 1])) == encode(threads[number + 1])


def turned_by(angle):
    """The thread at 60 % of its size, turned about the line of sight."""
    c, s = 0.6 * np.cos(angle), 0.6 * np.sin(angle)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 0.6]])
    return lambda t: (winding(t) - (0, 0, 95)) @ turn.T + (0, 0, 95)


@pytest.mark.slow
def test_a_thread_is_followed_past_the_place_where_its_ends_change_sides():
    """The first end lies left in the first frame; turned by half a circle it lies right, and is the first still."""
    last = tracked(seen(turned_by(np.pi * number / 22), number=number) for number in range(23))[-1]
    turned = turned_by(np.pi)
    assert place(last, 0.0)[0] > place(last, 1.0)[0]
    assert off_mm(last, 0.0, turned(np.zeros(1))[0]) < 0.3
    assert followed(last, seen(turned, number=28)).track.step is CONTINUED
    late = followed(last, seen(turned, number=58))
    assert (late.track.step, "s ago" in late.track.reason) == (RESTARTED, True)
    assert place(late, 0.0)[0] > place(late, 1.0)[0]


def test_an_end_that_a_tool_hides_stays_part_of_the_thread():
    last = tracked(seen(shown=((0.0, 1.0 - 0.03 * number),), number=number) for number in range(12))[-1]
    assert last.track.step is CONTINUED
    assert off_mm(last, 1.0, winding(np.ones(1))[0]) < 1.0
    assert last.unseen[-1] == pytest.approx((0.67, 1.0), abs=0.06)


def test_more_thread_that_comes_into_view_gets_places_beyond_the_first_ones_until_ten_seconds_are_over():
    first = followed(None, seen(shown=((0.0, 0.6),)))
    more = followed(first, seen(number=1))
    assert more.track.step is RESTARTED
    assert "past the end of the last curve" in more.track.reason
    low, high = more.track.material_s
    assert low == pytest.approx(0.0, abs=0.02)
    assert high > 1.3
    # what was the last place of the first curve
    assert off_mm(more, (1.0 - low) / (high - low), winding(np.array([0.6]))[0]) < 1.0
    for number, kept in ((290, True), (310, False)):
        late = followed(first, seen(number=number)).track
        assert late.step is RESTARTED
        assert (late.material_s.tolist() != [0.0, 1.0], late.length == first.track.length) == (kept, kept)
    other = dataclasses.replace(CAMERA, baseline=5.0)
    assert followed(first, seen(number=1, camera=other)).track.step is STARTED


@pytest.mark.parametrize("eye", [0, 1])
def test_a_thread_that_one_eye_alone_shows_is_lost(eye):
    first, frame = followed(None, seen(backing(0))), seen(backing(1), number=1)
    lines = [frame.centrelines_left, frame.centrelines_right]
    speck = lines_of(np.array([(800.0, 40.0), (830.0, 60.0)]))
    for nothing, reason in ((no_centrelines(), "too little thread"), (speck, "")):
        lines[eye] = nothing
        thread = followed(first, observed(*lines, number=1))
        assert (thread.status, thread.track.step) == (Status.FAILED, LOST)
        assert reason in thread.reason


@pytest.mark.slow
@pytest.mark.parametrize("eye", [0, 1])
def test_what_one_eye_alone_shows_is_unseen_and_its_depth_soon_doubted(eye):
    frames = [seen(backing(0))]
    for number in range(1, 31):
        whole, part = (seen(backing(number), shown, number) for shown in (((0.0, 1.0),), ((0.0, 0.6),)))
        shown = (part, whole) if eye == 0 else (whole, part)
        frames.append(observed(shown[0].centrelines_left, shown[1].centrelines_right, number))
    threads = tracked(frames)
    last = threads[-1]
    assert {thread.status for thread in threads} == {Status.OK}
    along = np.linalg.norm(np.diff(winding(np.linspace(0, 1, 1001)), axis=0), axis=1).cumsum()
    assert last.unseen.tolist() == [pytest.approx((along[599] / along[-1], 1.0), abs=0.03)]
    at, truth = np.linspace(0, 1, 50), backing(30)(np.linspace(0, 1, 2001))
    points = evaluate(last.knots, last.control_points_camera, 3, at)
    off = np.linalg.norm(points[:, None] - truth, axis=2).min(axis=1)
    assert np.interp(at, last.confidence_s, last.confidence)[off > 1.0].max(initial=0.0) < 0.5
    assert off[at < last.unseen[0, 0]].max() < 1.0


def test_a_frame_alone_that_shows_no_thread_ends_a_track_of_one_eye():
    """Three tenths of the thread are what a frame alone needs of the right image; a track goes on with less."""
    first, part = followed(None, seen()), seen(shown=((0.0, 0.25),)).centrelines_right
    # a frame is looked at alone once in thirty
    first = dataclasses.replace(first, track=dataclasses.replace(first.track, frames=27))
    threads = tracked([observed(seen().centrelines_left, part, number) for number in range(1, 5)], first)
    assert steps_of(threads) == [CONTINUED, CONTINUED, LOST, LOST]
    assert followed(threads[-1], seen(number=5)).status is Status.OK
