"""Whether a pull may go on, from how far the jaws went and how much shorter the tail became.

Of a strand that had the length a between entry and jaws when it was grasped, |jaw − entry| − a more must have run out
of the tissue once the jaws are farther away than that. The entry counts where it was then: tissue follows the jaws by
no more than running thread draws it (`gives_m`), while a knot draws it along as far as they go. No force is measured.
Thread that lags behind by more than that and all deviations together explain (95 %) does not run: it slips in the jaws
while the strand between entry and jaws is slack; where that is straight, it is held in the tissue and comes under
tension. What grew, or became shorter than the jaws can have made it, by more than the deviations is not the tail:
another course was taken for the thread's, and nothing is measured.

Where the free end is not seen any more, as where a stiff tail swings out of the view, the tail is still at least as
long as what is seen of it, and as what was left of it if all that the jaws can have taken ran (`at_least`). The entry,
which a knot draws along, tells whether thread is held. While more is to run by that bound, jaws pull on. Nothing is
claimed of such a tail but its bound.

How much may run, r, is what the lower bound of the tail's interval is above what was asked for; or what its upper bound
is above that and WITHIN_M, where that is more and the interval is so narrow that all of it lies within WITHIN_M then.
Where r is used up and it is wider, nothing is claimed. Of a tail whose end is not seen r is what its bound is above
what was asked for less WITHIN_M, so that it surely becomes no shorter than that.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from agents.planner.config import PlannerConfig
from agents.planner.curve import NoGraspError, unit_vectors
from agents.planner.pulling.strands import END_PX, SAMPLES, Strands
from agents.planner.pulling.tail import tail_length
from agents.planner.wedge import thread_covariance
from schemas.messages import EndSight, Pull, PullGrip, PullStop, TailLength
from schemas.messages.pulling import SIGMAS_95

NEAREST_M = 0.0005
"""An arm has arrived where it is so near to a place (the bridge confirms no less), and pulls no finer."""
WITHIN_M = 0.002
"""So near to what was asked for a tail has to be, to be told right."""
MM = 1e3


@dataclass(frozen=True)
class Verdict:
    """Why to stop, None where the pull may go on, and what that is judged by.

    Fields:
        ran_m: how much shorter the tail is than before the grasp; None while nothing is held.
        travelled_m: how much of the strand must have run out by where the jaws are; None likewise.
    """

    stop: PullStop | None
    sentence: str
    ran_m: float | None = None
    travelled_m: float | None = None


def at_least(
    tail: TailLength,
    grip: PullGrip | None,
    jaw_camera: Float64[np.ndarray, "3"],
    shortest_m: float | None,
    config: PlannerConfig,
) -> TailLength:
    """The tail, where its free end is not seen as long as it is at least by what was measured before.

    Args:
        grip: of what the jaws hold since it was measured; None while they hold nothing.
        shortest_m: as long as it was at least when they let go of it, deviations included; None before.
    """
    if not tail.at_least:
        return tail
    bounds = [tail]
    if grip is not None:
        bounds.append(_not_taken(grip, jaw_camera, config))
    elif shortest_m is not None:
        bounds.append(TailLength(shortest_m, 0.0, at_least=True))
    return max(bounds, key=lambda bound: bound.interval_m[0])


def shortest_after(pull: Pull, jaw_camera: Float64[np.ndarray, "3"], config: PlannerConfig) -> float | None:
    """As long as the tail is at least where the jaws let go: what they cannot have taken since they grasped."""
    if pull.grip is None:
        return pull.shortest_m
    return _not_taken(pull.grip, jaw_camera, config).interval_m[0]


def _not_taken(grip: PullGrip, jaw_camera: Float64[np.ndarray, "3"], config: PlannerConfig) -> TailLength:
    """What the jaws left of the tail if all that they can have taken ran.

    Tissue that followed them has run by that much less; no more is made of it, for what looks like it may be a glint.
    """
    deviation_m = np.linalg.norm([grip.tail.deviation_m, grip.deviation_m, config.tool_error_m])
    left = max(grip.tail.length_m - travelled_m(grip, jaw_camera), 0.0)
    return TailLength(left, float(deviation_m), at_least=True)


def decide(
    tail_m: float,
    strands: Strands,
    grip: PullGrip | None,
    jaw_camera: Float64[np.ndarray, "3"],
    is_straight: bool,
    config: PlannerConfig,
    begun: bool = False,
) -> Verdict:
    """Whether to go on pulling until the tail is so long.

    Args:
        strands: with the tail as `at_least` has it.
        grip: of what the jaws hold; None while they hold nothing.
        jaw_camera: where the held thread is now.
        is_straight: the strand between entry and jaws, as `straight` tells.
        begun: the tail was measured to its end before, in this pull; where jaws hold it, it was.

    Raises:
        NoGraspError: where what is taken for the tail cannot be it.
    """
    tail = strands.tail
    told, (low_m, high_m) = in_words(tail), tail.interval_m
    since = _NOTHING_HELD if grip is None else _since_grasp(strands, grip, jaw_camera, config)
    if since.is_drawn:
        return Verdict(PullStop.TENSION, f"{told}{since.drew}: it is held in the tissue", since.ran_m, since.took_m)
    if high_m is None:
        goes_on = (begun or grip is not None) and strands.entry.sight is EndSight.SEEN
        if goes_on and left_m(tail, tail_m, config) > NEAREST_M:
            return Verdict(None, f"{told}{since.drew}", None, since.took_m)
        why = "hidden" if strands.free_end.sight is EndSight.HIDDEN else "out of view"
        return Verdict(PullStop.END_UNSEEN, f"the free end is {why}: {told}, and whether it runs cannot be told")
    if low_m <= config.least_tail_m:
        return Verdict(PullStop.FREE_END_NEAR, f"the free end comes near the tissue: {told}")
    if left_m(tail, tail_m, config) <= NEAREST_M:
        return _arrived(low_m, high_m, tail_m, f"{told}, and {MM * tail_m:.1f} mm were asked for")
    told += since.ran
    if since.unsure_m > config.pull_segment_m:
        return Verdict(PullStop.END_UNSEEN, f"{told}, which is not known well enough to tell whether it runs")
    if since.ran_m is None or since.took_m is None or since.took_m - since.ran_m <= since.unsure_m + strands.gives_m:
        return Verdict(None, told, since.ran_m, since.took_m)
    if is_straight:
        held = f"{told}, and the strand that is pulled is straight: it is held in the tissue"
        return Verdict(PullStop.TENSION, held, since.ran_m, since.took_m)
    slips = f"{told}, and the strand that is pulled is slack: it slips through the jaws, or they missed it"
    return Verdict(PullStop.NOT_RUNNING, slips, since.ran_m, since.took_m)


def _arrived(low_m: float, high_m: float, tail_m: float, asked: str) -> Verdict:
    """What is said of a tail of which no more may run."""
    if high_m - low_m > 2.0 * WITHIN_M:
        return Verdict(PullStop.END_UNSEEN, f"{asked}, which is not known well enough: look from nearer")
    if low_m < tail_m - WITHIN_M - NEAREST_M:
        return Verdict(PullStop.TOO_SHORT, f"{asked}: it may be too short by more than {MM * WITHIN_M:.0f} mm")
    return Verdict(PullStop.REACHED, asked)


@dataclass(frozen=True)
class _Since:
    """What has happened since the strand was grasped.

    Fields:
        ran_m: how much shorter the tail became; None where its end was not seen then.
        took_m: what must have run out by where the jaws are; unsure_m: of both together, 95 %.
        is_drawn: the entry came nearer to the jaws than half a newton draws it; where the tail tells too whether thread
            runs, than a newton does.
        ran, drew: the same in words.
    """

    ran_m: float | None
    took_m: float | None
    unsure_m: float
    is_drawn: bool
    ran: str
    drew: str


_NOTHING_HELD = _Since(None, None, 0.0, False, "", "")


def _since_grasp(
    strands: Strands, grip: PullGrip, jaw_camera: Float64[np.ndarray, "3"], config: PlannerConfig
) -> _Since:
    """What the tail, the jaws, and the entry tell.

    Raises:
        NoGraspError: where what is taken for tail or entry cannot be it.
    """
    tail, took_m = strands.tail, travelled_m(grip, jaw_camera)
    deviations = tail.deviation_m, grip.tail.deviation_m, grip.deviation_m, config.tool_error_m
    unsure_m = SIGMAS_95 * float(np.linalg.norm(deviations))
    ran_m = grip.tail.length_m - tail.length_m
    took = f"{MM * took_m:.1f} (± {MM * unsure_m:.1f})"
    ran = f"; the tail shortened by {MM * ran_m:.1f} mm where the jaws took {took}"
    grew, shrank = ran_m < -unsure_m, ran_m > took_m + unsure_m
    if (grew and not grip.tail.at_least) or (shrank and not tail.at_least):
        raise NoGraspError(f"what is taken for the tail is not the one that is pulled: {in_words(tail)}{ran}")
    drawn_m, drawn_unsure_m = _drawn_m(strands, grip, jaw_camera)
    by_tail_too = not (tail.at_least or grip.tail.at_least)
    most_m = strands.gives_m + drawn_unsure_m
    if by_tail_too:
        most_m = max(most_m, 2.0 * strands.gives_m - drawn_unsure_m)
    is_drawn = strands.entry.sight is EndSight.SEEN and drawn_m > most_m
    drew = f", and the jaws drew the entry by {MM * drawn_m:.1f} mm"
    known = (None, "") if grip.tail.at_least else (ran_m, ran)
    return _Since(known[0], took_m, unsure_m, is_drawn, known[1], drew)


def segment_m(
    strands: Strands, grip: PullGrip | None, jaw_camera: Float64[np.ndarray, "3"], config: PlannerConfig
) -> float:
    """d: a knot that comes within a segment draws the entry no farther than the newton does that tissue is to bear.

    Raises:
        NoGraspError: where what is taken for the entry cannot be it.
    """
    gives_m = strands.gives_m
    drawn_m, unsure_m = (gives_m, 0.0) if grip is None else _drawn_m(strands, grip, jaw_camera)
    return min(config.pull_segment_m, 2.0 * gives_m - max(drawn_m, 0.0) - unsure_m)


def _drawn_m(strands: Strands, grip: PullGrip, jaw_camera: Float64[np.ndarray, "3"]) -> tuple[float, float]:
    """How far the entry has come towards the jaws, and how well that is known (95 %).

    Raises:
        NoGraspError: where it has moved elsewhere, and is another place.
    """
    entry, camera = strands.entry, strands.line.curve.camera
    moved = entry.point_camera - grip.entry_camera
    towards = unit_vectors(jaw_camera - grip.entry_camera)
    drawn_m = float(moved @ towards)
    end_m = END_PX * float(entry.point_camera[2]) / camera.fx_px
    # both times its place is as unsure as it is now
    variances = float(towards @ entry.covariance @ towards), float(np.linalg.eigvalsh(entry.covariance)[-1])
    unsure_m, most_aside_m = SIGMAS_95 * np.sqrt(2.0 * (np.array(variances) + end_m**2)) + (0.0, strands.gives_m)
    aside_m = float(np.linalg.norm(moved - max(drawn_m, 0.0) * towards))
    if entry.sight is EndSight.SEEN and aside_m > most_aside_m:
        raise NoGraspError(f"the entry is not seen where it was, but {MM * aside_m:.1f} mm beside the way to the jaws")
    return drawn_m, float(unsure_m)


def seen_again(grip: PullGrip, strands: Strands, jaw_camera: Float64[np.ndarray, "3"]) -> PullGrip:
    """A grip from where its tail is seen to its end now, which was not when it was grasped; else as it is."""
    if strands.tail.at_least or not grip.tail.at_least:
        return grip
    # from the nearer entry, so that later no less counts as taken than can have run
    places = grip.entry_camera, strands.entry.point_camera
    out_m = min(float(np.linalg.norm(jaw_camera - place)) for place in places)
    return replace(grip, strand_m=max(grip.strand_m, out_m), tail=strands.tail)


def travelled_m(grip: PullGrip, jaw_camera: Float64[np.ndarray, "3"]) -> float:
    """How much of the strand must have run out by where the jaws are."""
    return max(0.0, float(np.linalg.norm(jaw_camera - grip.entry_camera)) - grip.strand_m)


def left_m(tail: TailLength, tail_m: float, config: PlannerConfig) -> float:
    """r."""
    low_m, high_m = tail.interval_m
    if high_m is None:
        return low_m - max(tail_m - WITHIN_M, config.least_tail_m)
    if high_m - low_m > 2.0 * WITHIN_M:
        return low_m - tail_m
    return max(low_m, high_m - WITHIN_M) - tail_m


def straight(strands: Strands, jaw_camera: Float64[np.ndarray, "3"], config: PlannerConfig) -> bool:
    """Whether the strand from the entry to the jaws is no longer than the way; also where it is not seen so far."""
    if strands.standing is None:
        return True
    thread, curve = strands.line.thread, strands.line.curve
    s = np.linspace(*strands.standing, 4 * SAMPLES)
    points = curve.points(s)
    off_m = np.linalg.norm(points - jaw_camera, axis=1)
    nearest = int(np.argmin(off_m))
    if off_m[nearest] > config.goal_within_m or nearest < 2:
        return True
    covariance = thread_covariance(thread, curve, s[: nearest + 1])
    assert covariance is not None  # noqa: S101 - strands are of a thread that tells it
    strand = tail_length(points[: nearest + 1], covariance, config.correlation_m)
    way_m = float(np.linalg.norm(points[nearest] - points[0]))
    return strand.length_m - way_m <= SIGMAS_95 * strand.deviation_m


def in_words(tail: TailLength) -> str:
    """A tail's length with its interval."""
    low_m, high_m = tail.interval_m
    if high_m is None:
        return f"the tail is at least {MM * low_m:.1f} mm long"
    return f"the tail is {MM * tail.length_m:.1f} mm long ({MM * low_m:.1f} to {MM * high_m:.1f})"
