"""Why a pull stops, each by what is seen: its tail, its free end, its strand, and where the jaws are."""

import dataclasses

import numpy as np
import pytest

from agents.planner.config import PlannerConfig
from agents.planner.curve import NoGraspError
from agents.planner.pulling.stopping import at_least, decide, seen_again, straight
from agents.planner.pulling.strands import Meant, strands_of
from schemas.messages import EndSight, PullGrip, PullStop, TailLength
from tests.agents.planner import bench
from tests.agents.planner.pulling.bench import BITE_MM, ENTRY_MM, path, threaded

CONFIG = PlannerConfig()
EXIT_PX = np.array((479.5 + 1000 * (ENTRY_MM[0] - BITE_MM) / 80, 269.5))
JAW_MM = ENTRY_MM + np.array((10.0, 2.0, 0.0))


def seen(tail_mm=25.0, sight=EndSight.SEEN, deviation_mm=0.3):
    thread = threaded(30.0)
    told = strands_of(thread, CONFIG, Meant(EXIT_PX))
    tail = TailLength(1e-3 * tail_mm, 1e-3 * deviation_mm, at_least=sight is not EndSight.SEEN)
    return dataclasses.replace(told, tail=tail, free_end=dataclasses.replace(told.free_end, sight=sight))


def grip(tail_mm=30.0, strand_mm=10.0):
    entry = ENTRY_MM / 1e3
    return PullGrip(JAW_MM / 1e3, entry, 1e-3 * strand_mm, 1e-4, TailLength(1e-3 * tail_mm, 3e-4, False), entry + 0.04)


def away(mm):
    return (ENTRY_MM + np.array((0.0, 0.0, -mm))) / 1e3


@pytest.mark.parametrize(
    ("strands", "gripped", "away_mm", "is_straight", "stop", "said"),
    [
        (seen(25.0), grip(), 15.0, True, None, "shortened by 5.0 mm where the jaws took 5.0"),
        (seen(30.0), grip(), 9.0, False, None, "where the jaws took 0.0"),
        # the lower bound of a tail known to ± 0.6 mm, and of one known to ± 1.5 mm the upper one, within 2 mm
        (seen(21.0), grip(), 20.0, True, PullStop.REACHED, "20.0 mm were asked for"),
        (seen(21.2), grip(), 19.4, True, None, ""),
        (seen(20.9, deviation_mm=0.75), grip(), 20.0, True, PullStop.REACHED, "20.0 mm were asked for"),
        (seen(21.1, deviation_mm=0.75), grip(), 20.0, True, None, ""),
        (seen(21.0, deviation_mm=1.1), grip(), 20.0, True, PullStop.END_UNSEEN, "not known well enough"),
        (seen(27.0), grip(), 15.0, True, None, ""),
        (seen(27.0), grip(), 20.0, True, PullStop.TENSION, "it is held in the tissue"),
        (seen(27.0), grip(), 20.0, False, PullStop.NOT_RUNNING, "slips through the jaws"),
        (seen(27.0, deviation_mm=1.5), grip(), 20.0, True, None, ""),
        (seen(29.0, EndSight.OUT_OF_VIEW), grip(), 15.0, True, None, "drew the entry by 0.0 mm"),
        (seen(29.0, EndSight.HIDDEN), grip(), 15.0, True, None, "drew the entry by 0.0 mm"),
        (seen(19.0, EndSight.HIDDEN), grip(20.0), 15.0, True, PullStop.END_UNSEEN, "is hidden: the tail is at least"),
        (seen(25.0, EndSight.OUT_OF_VIEW), None, 15.0, True, PullStop.END_UNSEEN, "is out of view"),
        (seen(27.0), None, 15.0, True, None, ""),
    ],
)
def test_each_reason_to_stop_has_its_own_sentence(strands, gripped, away_mm, is_straight, stop, said):
    verdict = decide(0.02, strands, gripped, away(away_mm), is_straight, CONFIG)
    assert (verdict.stop, said in verdict.sentence) == (stop, True), verdict.sentence


def test_the_free_end_stops_before_the_tissue_by_all_that_is_not_known_of_it():
    for deviation_mm, stop in ((0.3, None), (1.2, PullStop.FREE_END_NEAR)):
        assert decide(0.0055, seen(7.0, deviation_mm=deviation_mm), None, away(9), False, CONFIG).stop is stop


def drawn_by(strands, mm):
    """The entry so much farther towards the jaws."""
    at = strands.entry.point_camera - np.array((0, 0, 1e-3 * mm))
    return dataclasses.replace(strands, entry=dataclasses.replace(strands.entry, point_camera=at))


@pytest.mark.parametrize("sight", [EndSight.SEEN, EndSight.OUT_OF_VIEW])
def test_tissue_that_follows_the_jaws_counts_as_thread_that_does_not_run(sight):
    assert decide(0.02, drawn_by(seen(30.0, sight), 8.0), grip(), away(15.0), True, CONFIG).stop is PullStop.TENSION


def test_an_entry_that_is_elsewhere_than_towards_the_jaws_is_another_place():
    there = seen(30.0)
    at = dataclasses.replace(there.entry, point_camera=there.entry.point_camera + np.array((0.005, 0, 0)))
    with pytest.raises(NoGraspError, match="beside the way to the jaws"):
        decide(0.02, dataclasses.replace(there, entry=at), grip(), away(15.0), True, CONFIG)


@pytest.mark.parametrize("tail_mm", [32.0, 22.0])
def test_what_grew_or_became_shorter_than_the_jaws_can_have_made_it_is_not_the_tail(tail_mm):
    with pytest.raises(NoGraspError, match="is not the one that is pulled"):
        decide(0.015, seen(tail_mm), grip(), away(15.0), True, CONFIG)


def test_a_tail_whose_end_is_not_seen_is_as_long_as_what_the_jaws_cannot_have_taken_of_it_or_as_what_is_seen():
    gone = seen(12.0, EndSight.OUT_OF_VIEW).tail
    bound = at_least(gone, grip(), away(15.0), None, CONFIG)
    assert (bound.at_least, bound.length_m) == (True, pytest.approx(0.025, abs=2e-4))
    assert bound.deviation_m == pytest.approx(np.linalg.norm([3e-4, 1e-4, CONFIG.tool_error_m]))
    longer = seen(29.0, EndSight.OUT_OF_VIEW).tail
    assert at_least(longer, grip(), away(15.0), None, CONFIG) is longer
    assert at_least(seen(12.0).tail, grip(), away(15.0), None, CONFIG).length_m == 0.012
    assert at_least(gone, None, away(15.0), 0.02, CONFIG).interval_m == (0.02, None)
    assert at_least(gone, None, away(15.0), None, CONFIG) is gone


def test_a_pull_that_has_begun_goes_on_by_that_bound_and_knows_what_runs_once_the_end_is_seen_again():
    gone = seen(25.0, EndSight.OUT_OF_VIEW)
    assert decide(0.02, gone, None, away(15.0), False, CONFIG, begun=True).stop is None
    unsure = dataclasses.replace(grip(), tail=TailLength(0.022, 0.0, at_least=True))
    again = seen(27.0)
    assert decide(0.02, again, unsure, away(12.0), True, CONFIG).stop is None
    drawn = drawn_by(again, 6.0)
    assert decide(0.02, drawn, unsure, away(12.0), True, CONFIG).stop is PullStop.TENSION
    with pytest.raises(NoGraspError, match="is not the one that is pulled"):
        decide(0.008, seen(10.0), unsure, away(12.0), True, CONFIG)
    known = seen_again(unsure, again, away(12.0))
    assert (known.tail, known.strand_m) == (again.tail, pytest.approx(0.012, abs=2e-4))
    # thread that the tissue followed with has not run, and may yet
    assert seen_again(unsure, drawn_by(again, 1.5), away(12.0)).strand_m == pytest.approx(0.0105, abs=2e-4)
    assert seen_again(grip(), again, away(12.0)).tail == grip().tail


@pytest.mark.parametrize(("tail_mm", "stop"), [(19.0, PullStop.REACHED), (18.0, PullStop.TOO_SHORT)])
def test_a_tail_that_may_be_too_short_by_more_than_2_mm_is_not_told_right(tail_mm, stop):
    for gripped, at in ((grip(), away(21.0)), (None, away(9.0))):
        assert decide(0.02, seen(tail_mm), gripped, at, True, CONFIG).stop is stop


def test_a_strand_is_straight_where_it_is_no_longer_than_the_way_to_the_jaws_or_is_not_seen_up_to_them():
    def is_straight(jaw_mm, *corners):
        free = ENTRY_MM + np.array((-24.0, 15.0, 0.0))
        points, long_mm = path([free, ENTRY_MM - np.array((BITE_MM, 0, 0)), ENTRY_MM, *corners], 300)
        at = np.linalg.norm(points - ENTRY_MM, axis=1).argmin() / 299
        thread = bench.known(bench.polyline(*points, unseen=[(at - BITE_MM / long_mm, at)]), 0.1, 0.1, 0.3)
        return straight(strands_of(thread, CONFIG, Meant(EXIT_PX)), np.asarray(jaw_mm) / 1e3, CONFIG)

    end, loop = ENTRY_MM + np.array((20.0, 0.0, 0.0)), ENTRY_MM + np.array((10.0, 8.0, 0.0))
    assert is_straight(end, end)
    assert not is_straight(end, loop, end)
    assert is_straight(end + np.array((0, 0, -12.0)), loop, end), "nothing is seen of it up to the jaws"
