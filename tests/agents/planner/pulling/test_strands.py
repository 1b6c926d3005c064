"""Which strand is the tail: one curve with a gap, or a curve beside another strand; and what is not guessed."""

import dataclasses

import numpy as np
import pytest

from agents.planner.config import PlannerConfig
from agents.planner.curve import NoGraspError, curve_of
from agents.planner.needle import NeedleAround
from agents.planner.pulling.strands import Meant, strands_of
from schemas.messages import EndSight, ThreadCourse
from tests.agents.planner import bench
from tests.agents.planner.pulling.bench import BITE_MM, ENTRY_MM, threaded

EXIT_MM = ENTRY_MM - np.array((BITE_MM, 0, 0))
FAR_MM, FREE_MM = ENTRY_MM + np.array((30, 6, 0)), EXIT_MM + np.array((-15, 18, 0))
EXIT_PX = np.array((479.5 + 1000 * EXIT_MM[0] / 80, 269.5))
ENTRY_PX = EXIT_PX + np.array((1000 * BITE_MM / 80, 0))


def found(thread, exit_pixel=None, needle=None, **meant):
    return strands_of(thread, PlannerConfig(), Meant(exit_pixel, **meant), needle)


def refused(*args, **rest):
    with pytest.raises(NoGraspError) as error:
        found(*args, **rest)
    return str(error.value)


def test_a_gap_in_one_curve_has_an_exit_and_an_entry_and_a_pixel_says_which():
    told = found(threaded(30.0), EXIT_PX)
    assert told.tail.length_m == pytest.approx(0.03, abs=5e-4)
    assert not told.tail.at_least
    np.testing.assert_allclose(1e3 * told.exit.point_camera, EXIT_MM, atol=0.3)
    np.testing.assert_allclose(1e3 * told.entry.point_camera, ENTRY_MM, atol=0.3)
    assert told.free_end.sight is EndSight.SEEN
    assert told.standing == (told.entry.s, 1.0)
    other = found(threaded(30.0), ENTRY_PX)
    assert other.standing == (told.exit.s, 0.0)
    assert "px from the pixel that was named" in refused(threaded(30.0), EXIT_PX - (0, 70))


def test_without_a_pixel_the_frame_before_the_needle_or_what_leaves_the_view_tells_and_nothing_is_guessed():
    thread = threaded(30.0, loose_mm=30.0)
    assert "which of both strands is the tail cannot be told: name the tail's exit by its pixel" in refused(thread)
    before = found(thread, EXIT_PX)
    at = {"exit_camera": before.exit.point_camera + 0.002, "entry_camera": before.entry.point_camera}
    assert found(thread, **at).standing == before.standing
    far = {"exit_camera": before.exit.point_camera + 0.02, "entry_camera": before.entry.point_camera}
    assert "not seen where they were" in refused(thread, **far)
    end = curve_of(thread).points(np.ones(1))
    assert found(thread, needle=NeedleAround(end + 0.001, np.full(1, 0.001))).standing == before.standing
    hidden = dataclasses.replace(thread, ends_hidden=np.array([False, True]))
    assert found(hidden).standing == before.standing
    assert "the tail cannot be told" in refused(dataclasses.replace(thread, ends_hidden=np.array([True, True])))


def apart(tail, standing, **changes):
    """Both strands as two curves, that of `standing` the one that is meant."""
    return dataclasses.replace(standing, strands=(standing.as_strand, tail.as_strand), **changes)


def straight(*ends, **changes):
    return dataclasses.replace(bench.known(bench.straight(*ends), 0.1, 0.1, 0.3), **changes)


TAIL, STANDING = straight(FREE_MM, EXIT_MM), straight(ENTRY_MM, FAR_MM)


@pytest.mark.parametrize("thread", [apart(TAIL, STANDING), apart(STANDING, TAIL)], ids=["standing", "tail"])
def test_two_curves_whose_ends_face_each_other_are_both_strands_whichever_is_meant(thread):
    told = found(thread, EXIT_PX)
    assert told.tail.length_m == pytest.approx(1e-3 * np.hypot(15, 18))
    assert not told.tail.at_least
    np.testing.assert_allclose(1e3 * told.exit.point_camera, EXIT_MM, atol=0.1)
    np.testing.assert_allclose(1e3 * told.entry.point_camera, ENTRY_MM, atol=0.1)
    np.testing.assert_allclose(1e3 * told.tail_points[[0, -1]], [FREE_MM, EXIT_MM], atol=0.1)
    np.testing.assert_allclose(1e3 * told.line.curve.points(np.array(told.standing)), [ENTRY_MM, FAR_MM], atol=0.1)
    # shares of a strand are none of the message's own curve
    assert (told.entry.s, told.exit.s, told.free_end.s) == (None, None, None)
    other = found(thread, ENTRY_PX)
    np.testing.assert_allclose(1e3 * other.exit.point_camera, ENTRY_MM, atol=0.1)


def test_ends_that_leave_the_view_or_an_instrument_hides_or_that_face_no_other_are_no_bite():
    none = "no place is seen at which the thread passes through tissue"
    shift = np.array((-EXIT_MM[0] - 37.9, 0, 0))
    gone = [straight(a + shift, b + shift) for a, b in ((FREE_MM, EXIT_MM), (ENTRY_MM, FAR_MM))]
    assert none in refused(apart(*gone), EXIT_PX)
    hidden = straight(ENTRY_MM, FAR_MM, ends_hidden=np.array([True, False]))
    assert none in refused(apart(TAIL, hidden), EXIT_PX)
    far = straight(ENTRY_MM + np.array((12, 0, 0)), FAR_MM + np.array((12, 0, 0)))
    assert none in refused(apart(TAIL, far), EXIT_PX)
    beside = straight(EXIT_MM + np.array((0, 3, 0)), EXIT_MM + np.array((-20, 10, 0)))
    three = dataclasses.replace(STANDING, strands=(STANDING.as_strand, TAIL.as_strand, beside.as_strand))
    assert np.linalg.norm(1e3 * found(three, EXIT_PX).entry.point_camera - EXIT_MM - (0, 3, 0)) < 0.1


def test_a_tail_is_measured_while_what_is_pulled_is_lost_and_nothing_is_where_both_are():
    were = {"exit_camera": EXIT_MM / 1e3, "entry_camera": ENTRY_MM / 1e3}
    lost = dataclasses.replace(bench.failed(), strands=(TAIL.as_strand,))
    told = found(lost, **were)
    assert (told.standing, told.tail.length_m) == (None, pytest.approx(1e-3 * np.hypot(15, 18)))
    assert "there is no thread" in refused(bench.failed(), **were)
    speck = straight(FAR_MM, FAR_MM + np.array((1.9, 0, 0)))
    three = tuple(one.as_strand for one in (speck, STANDING, TAIL))
    assert found(dataclasses.replace(STANDING, strands=three), **were).standing


def test_a_tail_that_seems_shorter_than_the_jaws_can_have_made_it_is_only_a_part_of_it():
    were = {"exit_camera": EXIT_MM / 1e3, "entry_camera": ENTRY_MM / 1e3}
    assert "only 23.4 mm are seen" in refused(apart(TAIL, STANDING), **were, shortest_m=0.03)
    assert found(apart(TAIL, STANDING), **were, shortest_m=0.023).tail.length_m > 0.023


def test_an_end_is_seen_or_hidden_or_out_of_view_or_may_lead_on():
    def sight(**changes):
        told = found(dataclasses.replace(threaded(30.0), **changes), EXIT_PX)
        return told.free_end.sight, told.tail.at_least

    assert sight() == (EndSight.SEEN, False)
    assert sight(ends_hidden=np.array([True, False])) == (EndSight.HIDDEN, True)
    assert sight(hidden=np.array([[0.0, 0.05]])) == (EndSight.HIDDEN, True)
    course = ThreadCourse(np.array([[0.0, 0.0], [1.0, 1.0]]), np.array([0.9, 1.0]), np.zeros((0, 2)))
    assert sight(course=course) == (EndSight.HIDDEN, True)
    assert found(threaded(40.0), EXIT_PX).free_end.sight is EndSight.OUT_OF_VIEW


def test_an_end_that_faces_the_end_of_another_curve_nearby_may_go_on_there():
    along = (FREE_MM - EXIT_MM) / np.linalg.norm(FREE_MM - EXIT_MM)

    def sight(begins_mm, ends_mm):
        other = straight(FREE_MM + begins_mm * along, FREE_MM + ends_mm * along)
        three = (STANDING.as_strand, TAIL.as_strand, other.as_strand)
        return found(dataclasses.replace(STANDING, strands=three), EXIT_PX).free_end.sight

    assert sight(10.0, 16.0) is EndSight.HIDDEN
    assert sight(16.0, 17.0) is EndSight.SEEN, "farther than tissue or a glint hides"


def test_what_an_instrument_hides_is_no_bite_of_tissue_nor_is_what_is_too_short_or_too_long():
    thread = threaded(30.0)
    gap = thread.unseen[0]
    none = "no place is seen at which the thread passes through tissue"
    assert none in refused(dataclasses.replace(thread, hidden=gap[None]), EXIT_PX)
    assert none in refused(dataclasses.replace(thread, unseen=np.array([[gap[0], gap[0] + 0.01]])), EXIT_PX)
    assert none in refused(dataclasses.replace(thread, unseen=np.array([[gap[0], gap[0] + 0.3]])), EXIT_PX)
    assert "does not tell how well" in refused(bench.polyline((0, 0, 80), (20, 0, 80)), EXIT_PX)


def test_where_more_is_unseen_than_a_bite_takes_the_exit_may_be_anywhere_in_it_and_the_interval_says_so():
    thread = threaded(30.0)
    (start, end), long_mm = thread.unseen[0], 1e3 * curve_of(thread).length_m
    glint = dataclasses.replace(thread, unseen=np.array([[start - 5 / long_mm, end]]))
    told = found(glint, EXIT_PX - np.array((50, 0))).tail
    low_m, high_m = told.interval_m
    assert told.length_m == pytest.approx(0.025, abs=5e-4)
    assert low_m < 0.02
    assert (high_m or 0.0) > 0.03


def test_a_tail_that_is_left_alone_is_known_by_where_its_exit_was_and_the_standing_strand_is_not_taken_for_it():
    tail = bench.known(bench.straight(FREE_MM, EXIT_MM), 0.1, 0.1, 0.3)
    were = {"exit_camera": EXIT_MM / 1e3 + 0.001, "entry_camera": ENTRY_MM / 1e3}
    told = found(tail, **were)
    assert told.tail.length_m == pytest.approx(1e-3 * np.hypot(15, 18))
    assert (told.standing, told.entry.sight) == (None, EndSight.HIDDEN)
    assert "is another strand" in refused(tail, **were, longest_m=0.02)
    standing = bench.known(bench.straight(ENTRY_MM, FAR_MM), 0.1, 0.1, 0.3)
    none = "no place is seen at which the thread passes through tissue"
    assert none in refused(standing, **were)
    assert none in refused(tail)
