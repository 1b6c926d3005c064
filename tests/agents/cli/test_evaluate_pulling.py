"""`suturegrasp evaluate pulling`: whole pulls by true curves, how they are judged, and its journal."""

import json
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest

from agents.cli.evaluate import pulling
from agents.cli.evaluate.pulling import bench_of
from agents.cli.evaluate.pulling_field import Eyes, PullField
from agents.cli.evaluate.trials import rig_for, speed_limits
from agents.simulated_trials.look import Look
from agents.simulated_trials.pulling.driving import ArmState, Measured, Said, Segment, Stepwise, Stop, Task, Waypoint
from agents.simulated_trials.pulling.protocol import PullCame, PullProtocol, PullTrial, asked_mm
from agents.simulated_trials.pulling.results import overview, shares
from agents.simulated_trials.pulling.trial import Bench, pulled
from agents.simulator.field import MM
from schemas.messages import Status, TrackStep
from schemas.topics import OBSERVATIONS, THREAD
from shared.arc_length import length
from shared.camera import project
from shared.rigid_transforms import transform
from shared.splines import evaluate
from tests.agents.cli.conftest import refused
from tests.agents.cli.pulling_stand_in import TruePuller, parked

EXACT = PullProtocol(puller="true", seed=1, trials=20, tool_error_mm=0, hand_eye_mm=0, hand_eye_deg=0)
NOTHING = Look((), None)  # pyright: ignore[reportArgumentType]


def pulled_by_truth(number, protocol=EXACT, heedless=False):
    """A whole pull by a puller that knows the true strands, without images."""
    trial = PullTrial(number=number)
    drawn = PullField(protocol, trial)
    goal_mm = asked_mm(protocol, trial, drawn.world.state.tail_mm)
    puller = TruePuller(drawn.world, heedless)
    driver = Stepwise(puller, MM * goal_mm, parked(drawn), speed_limits())
    return pulled(trial, protocol, Bench(drawn.move, lambda *_: NOTHING, driver, goal_mm, drawn.stitch.knot_mm))


@pytest.mark.slow
def test_a_pull_by_true_curves_ends_within_a_millimetre_the_same_each_time():
    came = pulled_by_truth(4)
    assert (came.outcome, came.code, came.wrongly_told, came.end_covered) == ("completed", "COMPLETED", False, True)
    assert abs(came.tail - came.asked) < 1.0 and came.tail_before > came.asked + 10.0
    assert 0.1 < came.peak_tension < came.peak_force + 0.1 and came.peak_force < 1.0
    assert came.frames > 20 and came.slipped == 0.0
    assert pulled_by_truth(4) == came


@pytest.mark.slow
def test_with_errors_of_tool_and_registration_the_thread_is_pulled_as_well():
    off = EXACT.model_copy(update={"tool_error_mm": 0.5, "hand_eye_mm": 1.0, "hand_eye_deg": 1.0})
    assert pulled_by_truth(5, off).outcome == "completed"


@pytest.mark.slow
def test_a_knot_ends_a_pull_before_the_tail_is_short_and_that_is_no_failure_to_pull():
    came = pulled_by_truth(10)
    assert came.code == "AT_KNOT" and came.knot == pytest.approx(came.tail, abs=0.1) and came.tail > came.asked + 2.0
    assert shares([came])[0].of == 0


@pytest.mark.slow
def test_a_tail_that_is_pulled_out_is_told():
    came = pulled_by_truth(4, heedless=True)
    assert (came.outcome, came.code, came.pulled_out, came.tail) == ("failed", "PULLED_OUT", True, 0.0)


@dataclass
class Faked:
    """A thread whose tail is as long as is said, and a driver that does nothing but end after some frames."""

    tail_mm: float
    end: Stop | None
    tissue_n: float = 0.2
    pulled_out: bool = False
    at_knot: bool = False
    jaw_n: float = 0.1
    slipped_mm: float = 0.0
    moves: bool = True
    told: Measured | None = None
    seen: int = 0
    at_s: float = 0.0
    began_ns: int = 0

    def advance(self, elapsed_s):
        self.at_s += elapsed_s
        return ArmState(transform(np.eye(3), np.array((0.01 * self.at_s * self.moves, 0.0, 0.1))), 0.0)

    def see(self, look):
        self.seen += 1
        return self.told

    @property
    def ended(self):
        return self.end if self.seen >= 3 else None


def judged(**changes):
    reached = Stop(True, "REACHED", "as long as asked", Measured(0.0155, 0.0005))
    faked = replace(Faked(15.0, reached, told=Measured(0.0152, 0.0005)), **changes)
    bench = Bench(lambda *_: faked, lambda *_: NOTHING, faked, 15.0, None)
    return pulled(PullTrial(number=1), EXACT.model_copy(update={"longest_s": 2.0}), bench)


def test_what_has_become_of_a_thread_is_judged_by_what_is_true_of_it():
    came = judged()
    assert (came.outcome, came.end_covered, came.frames, came.measured, came.covered) == ("completed", True, 3, 3, 3)
    assert (came.told, came.told_deviation) == (pytest.approx(15.5), pytest.approx(0.5))
    off = judged(tail_mm=17.1)
    assert (off.code, off.wrongly_told, off.end_covered, off.covered) == ("WRONG_LENGTH", True, False, 0)
    assert (judged(tissue_n=1.2).code, judged(tissue_n=1.2).outcome) == ("FORCE_EXCEEDED", "failed")
    assert judged(pulled_out=True).code == "PULLED_OUT"
    assert (judged(end=None).code, judged(end=None).took_s) == ("ENDLESS", pytest.approx(2.0, abs=0.03))
    gave_up = Stop(False, "NO_WAY", "no way")
    assert (judged(end=gave_up).outcome, judged(end=gave_up, at_knot=True).code) == ("failed", "AT_KNOT")
    assert judged(end=gave_up, moves=False).outcome == "declined"


def test_rates_have_wilsons_intervals_and_what_failed_is_named():
    trials = [judged(), judged(tail_mm=17.1), judged(tail_mm=17.0 - 1e-9), judged(pulled_out=True)]
    told = {share.what: share for share in shares(trials)}
    completed = told["completed, of pulls that no knot prevents"]
    assert (completed.count, completed.of) == (2, 4) and completed.interval == pytest.approx((0.150, 0.850), abs=1e-3)
    assert (told["pulled out"].count, told["told right and is not, of those told right"].count) == (1, 1)
    text = overview(EXACT, trials)
    assert "PULLED_OUT 1" in text and "| 2 of 4 | 50.0 % | 15.0 to 85.0 % |" in text
    assert "| 0 of 0 | - | - |" in overview(EXACT, [])


def test_a_tail_of_which_an_end_is_unseen_is_at_least_as_long_as_told():
    assert Measured(0.02, 0.001).covers(0.0219) and not Measured(0.02, 0.001).covers(0.0221)
    assert Measured(0.02, 0.001, at_least=True).covers(0.05) and not Measured(0.02, 0.001, True).covers(0.017)


def test_an_arm_goes_through_its_waypoints_no_faster_than_it_may():
    limits, start = speed_limits(), ArmState(np.eye(4), 0.0)
    to = (Waypoint(transform(np.eye(3), np.array((0.02, 0.0, 0.0))), 0.0), Waypoint(np.eye(4), 0.5))

    class Once:
        def seen(self, thread, arm, goal_m):
            return Said(None, None if arm.moves else Segment(to))

    driver = Stepwise(Once(), 0.01, start, limits)
    driver.see(NOTHING)
    states = [driver.advance(0.1) for _ in range(40)]
    places = np.array([0.0, *(state.T_camera_tool[0, 3] for state in states)])
    assert np.abs(np.diff(places)).max() == pytest.approx(0.1 * limits.speed * limits.contact_share)
    assert places.max() == pytest.approx(0.02, abs=2e-3) and states[-1].jaw_rad == pytest.approx(0.5)
    assert states[5].moves and not states[-1].moves


@dataclass
class SeesTwice:
    """A driver that notes what it is shown, and gives up."""

    task: Task
    began_ns: int = 0
    looks: list[Look] = field(default_factory=list[Look])

    def advance(self, elapsed_s):
        return ArmState(transform(np.eye(3), np.array((0.0, 0.0, 0.05))), 0.0)

    def see(self, look):
        self.looks.append(look)

    @property
    def ended(self):
        return Stop(False, "NO_WAY", "it was enough to look") if len(self.looks) >= 2 else None


def test_a_driver_is_shown_what_reconstruction_makes_of_the_drawn_stitch():
    looks: list[Look] = []
    trial, protocol = PullTrial(number=4), EXACT.model_copy(update={"puller": "looking"})
    drawn, tasks = PullField(protocol, trial), list[Task]()
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(pulling.DRIVERS, "looking", lambda task: tasks.append(task) or SeesTwice(task, looks=looks))
        came = pulled(trial, protocol, bench_of(protocol, trial, drawn))
    assert (came.outcome, came.frames) == ("declined", 2)
    exit_px = project(drawn.camera, drawn.stitch.holes)[0][0]
    assert 0.1 < np.linalg.norm(tasks[0].exit_px - exit_px) < 15.0 and tasks[0].goal_m == MM * came.asked
    for look in looks:
        thread = look.thread
        assert thread.status is Status.OK
        curve = evaluate(thread.knots, thread.control_points_camera, thread.degree, np.linspace(0.02, 0.98, 300)) / MM
        true = np.concatenate((drawn.world.state.tail, drawn.world.state.standing))
        off = np.linalg.norm(curve[:, None] - true[None], axis=2).min(axis=1)
        # nodes are 2 mm apart, and between the holes there is no truth to be near to
        assert np.percentile(off, 85) < 1.5
        assert look.said[-1].topic is THREAD
    assert looks[1].thread.track is not None and looks[1].thread.track.step is TrackStep.CONTINUED


@pytest.mark.slow
@pytest.mark.parametrize("shorter_mm", [0, 3], ids=["at rest", "by more than an end is followed"])
def test_both_strands_that_are_seen_apart_are_measured_in_every_frame_as_long_as_they_are_now(shorter_mm):
    drawn = PullField(EXACT.model_copy(update={"seed": 12}), PullTrial(number=1))
    eyes, arm, state = Eyes(rig_for("refined")), parked(drawn), drawn.world.state
    for frame in range(4):
        tail = state.tail[: len(state.tail) - frame * shorter_mm]
        drawn.world = SimpleNamespace(state=replace(state, tail=tail))  # pyright: ignore[reportAttributeAccessIssue]
        look = eyes.look(drawn.images(arm), 0.2 * frame)
        long_mm = [np.linalg.norm(np.diff(one, axis=0), axis=1).sum() for one in (tail, state.standing)]
        told_mm = [length(one.knots, one.control_points_camera, one.degree) / MM for one in look.thread.strands]
        np.testing.assert_allclose(sorted(told_mm), sorted(long_mm), atol=1.0)
        (observed,) = (said.message for said in look.said if said.topic is OBSERVATIONS)
        # where nothing moves, nothing is searched for
        assert shorter_mm or observed.segmented_sequence == 0


def test_a_journal_is_taken_up_again_and_results_are_written(suturegrasp, tmp_path, monkeypatch):
    monkeypatch.setitem(pulling.DRIVERS, "planner", lambda task: SeesTwice(task, looks=[NOTHING]))
    to = ("evaluate", "pulling", "--output", tmp_path, "--trials", "2", "--seed", "3", "--instrument")
    assert suturegrasp(*to).status == 0
    lines = (tmp_path / "journal.jsonl").read_text().splitlines()
    assert [json.loads(line)["outcome"] for line in lines[1:]] == ["declined", "declined"]
    ended = suturegrasp(*to)
    assert ended.status == 0 and "declined, of all" in ended.out
    assert (tmp_path / "journal.jsonl").read_text().splitlines() == lines
    assert len(json.loads((tmp_path / "results.json").read_text())["trials"]) == 2
    refused(suturegrasp(*to[:-2], "4", "--instrument"), "of another evaluation: seed 3, not 4")
    assert suturegrasp("evaluate", "pulling", "--output", tmp_path, "--report").status == 0


def test_what_cannot_be_tried_is_refused_in_one_sentence(suturegrasp, tmp_path):
    for options, told in ((("--puller", "nobody"), "--puller nobody"), (("--jobs", "0"), "give 1 or more")):
        refused(suturegrasp("evaluate", "pulling", "--output", tmp_path, *options), told)


def test_a_trial_that_raises_has_failed_and_says_why(monkeypatch):
    def broken(_task):
        raise ValueError("no arm")

    monkeypatch.setitem(pulling.DRIVERS, "true", broken)
    (came,) = pulling.tried_in(EXACT, PullTrial(number=4))
    assert isinstance(came, PullCame) and (came.code, came.sentence) == ("FAULT", "ValueError: no arm")
