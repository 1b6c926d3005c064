"""Following a thread from frame to frame: rendered sequences of known material points, and centrelines made by hand."""

import dataclasses

import numpy as np
import pytest

from agents.reconstruction.agent import Reconstruction
from agents.reconstruction.methods import METHODS
from agents.reconstruction.refined import tracking
from agents.reconstruction.refined.following import Followed, LostError
from agents.reconstruction.refined.posterior import point_covariance
from agents.reconstruction.refined.tracking import track_refined
from benchmarks.tracking import on_curve
from schemas.codec import decode, encode
from schemas.messages import (
    Centrelines,
    FrameStamp,
    RectifiedStereo,
    Status,
    ThreadReconstruction,
    TrackStep,
    no_centrelines,
)
from schemas.topics import OBSERVATIONS, THREAD, key
from shared.calibration.uncertainty import ERRORS
from shared.runtime.agent import Received
from shared.splines import evaluate
from tests.agents.reconstruction.conftest import observations_of
from tests.agents.reconstruction.refined.conftest import centrelines_of
from tests.rigs.sequences import Kind, sequence

SMALL = RectifiedStereo(480, 270, 500.0, 500.0, 239.5, 134.5, 5.5, 1e-3)
CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 5.5, 1e-3)
FRAME_NS = 33_333_333
alone = METHODS["refined"]


def rendered(kind, frames=16, config="medium", seed=3):
    return list(sequence(config, seed, kind, frames, binary=False, camera=SMALL))


def tracked(frames):
    """The thread of each frame, each with the one before in mind."""
    threads, last = [], None
    for frame in frames:
        last = track_refined(frame, last)
        threads.append(last)
    return threads


def track_of(thread):
    assert thread.track is not None
    return thread.track


def figures(threads, frames):
    """Mean error of each frame, and where each material point is on the thread."""
    found = [on_curve(thread, frame.truth) for thread, frame in zip(threads, frames, strict=True)]
    return np.array([d.mean() for _, d in found]), np.array([s[20:-20] for s, _ in found])


@pytest.mark.renders
def test_a_moving_thread_is_followed_no_worse_than_alone():
    slow = rendered(Kind("slow", 2.0, 8.0))
    threads = tracked([frame.observations for frame in slow])
    assert [track_of(t).step for t in threads] == [TrackStep.STARTED] + [TrackStep.CONTINUED] * (len(slow) - 1)
    error, s = figures(threads, slow)
    error_alone, s_alone = figures([alone(frame.observations) for frame in slow], slow)
    assert np.median(error) <= 1.1 * np.median(error_alone)
    assert error.max() <= 1.5 * error_alone.max()
    assert s.std(axis=0).mean() <= 1.1 * s_alone.std(axis=0).mean()
    assert np.abs(s - np.linspace(0, 1, 401)[20:-20]).max() < 0.003


@pytest.mark.slow
def test_fast_motion_is_followed():
    frames = rendered(Kind("fast", 6.0, 25.0), frames=5)
    threads = tracked([frame.observations for frame in frames])
    assert {track_of(t).step for t in threads[1:]} == {TrackStep.CONTINUED}
    assert figures(threads, frames)[0].max() < 0.05


@pytest.mark.renders
def test_behind_a_tool_s_stays_the_same_piece_of_thread():
    behind_a_tool = rendered(Kind("tool passes", 2.0, 8.0, hidden=True), frames=40)
    threads = tracked([frame.observations for frame in behind_a_tool])
    _, s = figures(threads, behind_a_tool)
    by_itself = [(alone(frame.observations), frame) for frame in behind_a_tool]
    # by itself a frame of which the tool covers much shows no thread: nobody knows of a tool here
    _, s_alone = figures(
        *zip(*((thread, frame) for thread, frame in by_itself if thread.status is Status.OK), strict=True)
    )
    assert s.std(axis=0).mean() < 0.2 * s_alone.std(axis=0).mean()
    # 40 % of the thread stays there within a millimetre of its hundred
    assert np.abs(s - np.linspace(0, 1, 401)[20:-20])[:, 140].max() < 0.01
    assert any(len(thread.unseen) for thread in threads)


@pytest.mark.slow
def test_a_thread_that_is_laid_elsewhere_is_begun_anew():
    frames = rendered(Kind("moved", 2.0, 8.0, jump_at=3), frames=6)
    threads = tracked([frame.observations for frame in frames])
    steps = [track_of(thread).step for thread in threads]
    assert steps == [TrackStep.STARTED] + 2 * [TrackStep.CONTINUED] + [TrackStep.RESTARTED] + 2 * [TrackStep.CONTINUED]
    assert "of the thread in both images lies within" in track_of(threads[3]).reason
    error, s = figures(threads, frames)
    assert error.max() < 0.1
    assert np.abs(s - np.linspace(0, 1, 401)[20:-20]).max() < 0.01


def test_no_number_of_frames_makes_certain_what_the_calibration_leaves_open():
    nothing = np.zeros((len(ERRORS), len(ERRORS)))
    best = {}

    def oblique(t):
        # rows that are apart are not told from depth
        return np.column_stack((-20 + 40 * t, 12 - 24 * t, 95 + 2 * np.sin(3 * t)))

    for name, stated in (("usual", None), ("exact", nothing)):
        threads = tracked(
            [dataclasses.replace(seen(oblique, number=n), calibration_covariance=stated) for n in range(12)]
        )
        assert track_of(threads[-1]).step is TrackStep.CONTINUED
        best[name] = np.array([np.median(thread.posterior_covariance[:, 2, 2]) for thread in threads])
    left_open = best["usual"] - best["exact"]
    assert left_open[1] > 0.005
    assert left_open[-1] > 0.8 * left_open[1]


def winding(t):
    return np.column_stack((-20 + 40 * t, 14 * np.sin(5 * t), 95 + 6 * np.cos(4 * t)))


def seen(shape=winding, shown=((0.0, 1.0),), number=0, camera=CAMERA):
    """Observations of a thread of which these stretches are shown."""
    left, right = (centrelines_of(shape, eye, shown, camera) for eye in (0, 1))
    return observed(left, right, number=number, camera=camera)


def observed(left, right, number=0, camera=CAMERA):
    stamp = FrameStamp(number, number * FRAME_NS, number * FRAME_NS, "")
    return observations_of(np.zeros((0, 3)), camera, stamp=stamp, centrelines_left=left, centrelines_right=right)


def place(thread, s):
    return evaluate(thread.knots, thread.control_points_camera, 3, np.array([s]))[0]


def fed(agent, message):
    (output,) = agent.step(Received(OBSERVATIONS, key("lab", OBSERVATIONS), 0, message))
    return output.message


def backing(number):
    """The thread, nearer to the cameras from frame to frame."""
    return lambda t: winding(t) - (0.0, 0.0, 0.1 * number)


def test_out_of_sight_is_a_failure_and_the_track_goes_on_after_it():
    nothing = no_centrelines()
    frames = [seen(backing(n), number=n) if n not in (2, 3) else observed(nothing, nothing, n) for n in range(6)]
    threads = tracked(frames)
    assert [thread.status is Status.OK for thread in threads] == [True] * 2 + [False] * 2 + [True] * 2
    assert {track_of(thread).step for thread in threads[2:4]} == {TrackStep.LOST}
    assert track_of(threads[2]).reason == threads[2].reason
    assert track_of(threads[4]).step is TrackStep.CONTINUED


def test_a_course_is_kept_from_frame_to_frame_and_looked_at_again_when_the_frame_is_judged_alone():
    parted = (0.0, 0.4), (0.5, 1.0)
    threads = tracked([seen(backing(number), parted, number) for number in range(40)])
    assert {track_of(thread).step for thread in threads[1:]} == {TrackStep.CONTINUED}
    told = [thread.course for thread in threads]
    assert told[1] is told[0]
    assert len({id(course) for course in told}) == 2
    for thread in threads:
        assert thread.course.joins == pytest.approx(np.array([[0, 0], [0.4, 0.5], [1, 1]]), abs=0.03)


def test_the_last_thread_holds_all_that_the_next_goes_on_from():
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

    def turned(t):
        x, y, z = (winding(t) - (0, 0, 95)).T
        return np.column_stack((c * x - s * y, s * x + c * y, 0.6 * z + 95))

    return turned


@pytest.mark.slow
def test_a_thread_is_followed_past_the_place_where_its_ends_change_sides():
    """The first end lies left in the first frame; turned by half a circle it lies right, and is the first still."""
    last = track_refined(seen(turned_by(0.0)), None)
    for number in range(1, 23):
        last = track_refined(seen(turned_by(np.pi * number / 22), number=number), last)
    turned = turned_by(np.pi)
    assert last.status is Status.OK
    assert place(last, 0.0)[0] > place(last, 1.0)[0]
    assert np.linalg.norm(place(last, 0.0) - turned(np.zeros(1))[0]) < 0.3
    again = track_refined(seen(turned, number=28), last)
    assert track_of(again).step is TrackStep.CONTINUED
    late = track_refined(seen(turned, number=58), last)
    assert track_of(late).step is TrackStep.RESTARTED
    assert "s ago" in track_of(late).reason
    assert place(late, 0.0)[0] > place(late, 1.0)[0]


def test_an_end_that_a_tool_hides_stays_part_of_the_thread():
    last = track_refined(seen(), None)
    for number in range(1, 12):
        last = track_refined(seen(shown=((0.0, 1.0 - 0.03 * number),), number=number), last)
    assert track_of(last).step is TrackStep.CONTINUED
    assert np.linalg.norm(place(last, 1.0) - winding(np.ones(1))[0]) < 1.0
    assert last.unseen[-1] == pytest.approx((0.67, 1.0), abs=0.06)


def test_more_thread_that_comes_into_view_gets_places_beyond_the_first_ones():
    first = track_refined(seen(shown=((0.0, 0.6),)), None)
    more = track_refined(seen(number=1), first)
    assert track_of(more).step is TrackStep.RESTARTED
    assert "past the end of the last curve" in track_of(more).reason
    low, high = track_of(more).material_s
    assert low == pytest.approx(0.0, abs=0.02)
    assert high > 1.3
    # what was the last place of the first curve
    assert np.linalg.norm(place(more, (1.0 - low) / (high - low)) - winding(np.array([0.6]))[0]) < 1.0


def one_eyed(number, right_shown, eye=1):
    """A frame of which one eye shows these stretches alone, the other everything."""
    both, part = seen(backing(number), number=number), seen(backing(number), right_shown, number=number)
    hidden = (both.centrelines_left, part.centrelines_right) if eye else (part.centrelines_left, both.centrelines_right)
    return observed(*hidden, number=number)


@pytest.mark.parametrize("eye", [0, 1])
def test_a_thread_that_one_eye_alone_shows_is_lost(eye):
    first, frame = track_refined(seen(backing(0)), None), seen(backing(1), number=1)
    lines = [frame.centrelines_left, frame.centrelines_right]
    at = np.linspace((800.0, 40.0), (830.0, 60.0), 36)
    speck = Centrelines(at, np.zeros(36, np.int64), np.full(36, 3.0), np.full(36, 0.1))
    for nothing, reason in ((no_centrelines(), "too little thread"), (speck, "")):
        lines[eye] = nothing
        thread = track_refined(observed(*lines, number=1), first)
        assert thread.status is Status.FAILED
        assert track_of(thread).step is TrackStep.LOST
        assert reason in thread.reason


@pytest.mark.slow
@pytest.mark.parametrize("eye", [0, 1])
def test_what_one_eye_alone_shows_is_unseen_and_its_depth_soon_doubted(eye):
    last = track_refined(seen(backing(0)), None)
    for number in range(1, 31):
        last = track_refined(one_eyed(number, ((0.0, 0.6),), eye), last)
        assert last.status is Status.OK
    along = np.linalg.norm(np.diff(winding(np.linspace(0, 1, 1001)), axis=0), axis=1).cumsum()
    assert last.unseen.tolist() == [pytest.approx((along[599] / along[-1], 1.0), abs=0.03)]
    at = np.linspace(0, 1, 50)
    off = np.linalg.norm(
        evaluate(last.knots, last.control_points_camera, 3, at)[:, None] - backing(30)(np.linspace(0, 1, 2001)), axis=2
    ).min(axis=1)
    confidence = np.interp(at, last.confidence_s, last.confidence)
    assert confidence[off > 1.0].max(initial=0.0) < 0.5
    hidden = ((at[:, None] > last.unseen[:, 0]) & (at[:, None] < last.unseen[:, 1])).any(axis=1)
    assert off[~hidden].max() < 1.0


def test_a_frame_alone_that_shows_no_thread_ends_a_track_of_one_eye():
    """Three tenths of the thread are what a frame alone needs of the right image; a track goes on with less."""
    first, part = track_refined(seen(), None), seen(shown=((0.0, 0.25),)).centrelines_right
    # a frame is looked at alone once in thirty
    last, steps = dataclasses.replace(first, track=dataclasses.replace(track_of(first), frames=27)), []
    for number in range(1, 5):
        last = track_refined(observed(seen().centrelines_left, part, number=number), last)
        steps.append(track_of(last).step)
    assert steps == 2 * [TrackStep.CONTINUED] + 2 * [TrackStep.LOST]
    assert track_refined(seen(number=5), last).status is Status.OK


def test_a_thread_along_the_rows_that_both_eyes_show_is_seen():
    def along_rows(t):
        return np.column_stack((-20 + 40 * t, 25 * np.maximum(t - 0.7, 0.0) ** 2, 95 + 2 * t))

    first = track_refined(seen(along_rows), None)
    second = track_refined(seen(along_rows, number=1), first)
    assert track_of(second).step is TrackStep.CONTINUED
    for thread in (first, second):
        assert thread.status is Status.OK
        assert np.diff(thread.unseen).sum() < 0.03


def rows_and_bends(t):
    """Along the rows for its middle, of whose depth both images say little."""
    bend = np.clip(np.abs(t - 0.5) - 0.25, 0.0, None)
    return np.column_stack((-20 + 40 * t, 150 * bend**2, 95 + 2 * t))


def test_a_curve_contradicts_its_frame_only_where_it_claims_more_and_the_frame_can_tell():
    frame = seen(rows_and_bends)
    before, fit = track_of(track_refined(frame, None)), tracking._alone(frame, None).fit
    at = np.linspace(0.0, 1.0, len(fit.curve.control_points))
    ray = fit.curve.control_points / fit.curve.control_points[:, 2:]
    middle = point_covariance(fit, CAMERA, np.array([0.5]))[0]
    deviation_mm = np.sqrt(np.linalg.eigvalsh(middle)[-1])
    assert 1.5 < deviation_mm < 2.0

    def followed(deviations, information, width):
        deeper_mm = deviations * deviation_mm * np.exp(-(((at - 0.5) / width) ** 2))
        elsewhere = fit.curve.moved(ray * deeper_mm[:, None])
        changed = dataclasses.replace(fit, loose=fit.loose * information, alone=fit.alone * information)
        return dataclasses.replace(changed, curve=elsewhere)

    with pytest.raises(LostError, match="lies farther away than the followed one was said to be off"):
        tracking._verified(frame, before, Followed(followed(2.0, 1e6, 0.25), 0.0, 1.0, False))
    for at_one in (followed(1.0, 1e6, 0.2), followed(2.0, 1e-6, 0.25), fit):
        tracking._verified(frame, before, Followed(at_one, 0.0, 1.0, False))
    assert tracking._claimed_too_much(fit, followed(1.0, 1e6, 0.2), CAMERA) == 0.0


@pytest.mark.slow
def test_a_frame_that_a_tool_hides_does_not_end_a_track_that_explains_more_of_it():
    frames = list(sequence("crossing", 4, Kind("tool passes", 3.0, 8.0, hidden=True), 45, binary=False))
    seen = [frame.observations for frame in frames]
    # perception takes the eyes for exchanged once
    assert seen[25].status is not Status.OK
    threads = tracked(seen)
    errors, _ = figures(threads[:25] + threads[26:], frames[:25] + frames[26:])
    assert TrackStep.RESTARTED not in [track_of(thread).step for thread in threads]
    assert errors.max() < 1.0


@pytest.mark.parametrize(("elapsed_s", "due"), [(0.001, 29), (1 / 30, 29), (0.1, 9), (0.4, 1), (2.0, 0)])
def test_a_frame_is_looked_at_alone_once_a_second_and_in_thirty(elapsed_s, due):
    track = track_of(track_refined(seen(), None))
    every = [n for n in range(60) if tracking._is_due(dataclasses.replace(track, frames=n), elapsed_s, 1.0)]
    assert every[0] == due
    assert set(np.diff(every)) == {due + 1}
    # a curve that leaves thread unexplained is doubted sooner
    doubted = [n for n in range(60) if tracking._is_due(dataclasses.replace(track, frames=n), elapsed_s, 0.9)]
    assert np.diff(doubted).max() <= 5


def hairpin(t):
    """Down, around and up again beside itself."""
    leg, width = 26.0, 8.0
    along = t * (2 * leg + np.pi * width / 2)
    angle = np.clip((along - leg) / (width / 2), 0.0, np.pi)
    x = -width / 2 * np.cos(angle)
    y = np.minimum(along, leg) + width / 2 * np.sin(angle) - np.maximum(along - leg - np.pi * width / 2, 0.0)
    return np.column_stack((x + 0.15 * y, y - leg / 2 - 4, 95 + 3 * np.sin(3 * t)))


@pytest.mark.parametrize("shown", [(0.0, 0.4), (0.3, 1.0)])
def test_a_part_that_is_begun_anew_keeps_direction_and_scale(shown):
    first = track_refined(seen(hairpin), None)
    late = track_refined(seen(hairpin, (shown,), number=60), first)
    assert track_of(late).step is TrackStep.RESTARTED
    turned = np.linalg.norm(place(first, 0.0) - hairpin(np.zeros(1))[0]) > 1.0
    truth = (1.0 - shown[1], 1.0 - shown[0]) if turned else shown
    assert track_of(late).material_s == pytest.approx(truth, abs=0.02)
    for s in (0.0, 1.0):
        t = np.interp(s, (0, 1), truth)
        assert np.linalg.norm(place(late, s) - hairpin(np.array([1.0 - t if turned else t]))[0]) < 1.0


def test_after_ten_seconds_nothing_is_kept():
    first = track_refined(seen(shown=((0.0, 0.6),)), None)
    for number, kept in ((290, True), (310, False)):
        late = track_refined(seen(number=number), first)
        assert track_of(late).step is TrackStep.RESTARTED
        assert (track_of(late).material_s.tolist() == [0.0, 1.0]) != kept
        assert (track_of(late).length == track_of(first).length) == kept


def test_another_camera_begins_another_track_and_a_failure_without_a_track_has_none():
    first = track_refined(seen(), None)
    other = dataclasses.replace(CAMERA, baseline=5.0)
    assert track_of(track_refined(seen(number=1, camera=other), first)).step is TrackStep.STARTED
    nothing = track_refined(observed(no_centrelines(), no_centrelines()), None)
    assert (nothing.status, nothing.track) == (Status.FAILED, None)
