"""The tail and the standing strand of a thread that passes through tissue, and the three ends between them.

Tissue hides a few millimetres of the thread. On both sides of it two ends face each other: one is the tail's exit, the
other the standing strand's entry. They are the ends of an unseen gap in one reconstructed curve, or of two curves that
are nearer to each other than to any other end. Which is which is told by a pixel of the user's, by the frame before, by
the needle, or by which far end is seen; where none of these tells, nothing is guessed. While jaws hide the standing
strand the tail alone may be left, which ends where its exit was a frame ago.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64

from agents.planner.config import PlannerConfig
from agents.planner.curve import NoGraspError, ThreadCurve, curve_of, pixels, unit_vectors
from agents.planner.needle import NeedleAround
from agents.planner.pulling.tail import tail_length
from agents.planner.wedge import thread_covariance
from schemas.messages import SURE, EndSight, StrandEnd, TailLength, ThreadReconstruction
from shared.camera import project

SAMPLES = 81
LEAST_GAP_M, MOST_GAP_M = 0.002, 0.015
"""A bite is 3 to 10 mm of tissue; what is hidden over less is a glint, and over more no single bite."""
LEAST_BITE_M, MOST_BITE_M = 0.003, 0.010
GIVES_M = 0.0025
"""By so much tissue follows thread that runs through the longest bite: half a newton over 0.2 N/mm."""
END_PX = 3.0
"""The last point of a centreline is up to so far from where the thread ends, or tissue takes it in: over 20 simulated
pulls strands are told 0.2 to 0.7 mm too long."""
BORDER_PX = 10.0
"""What ends so near to the border of an image leaves it: thread is followed up to some 7 px from there."""
WHICH = "name the tail's exit by its pixel (--exit-pixel U V)"
NO_BITE = (
    "no place is seen at which the thread passes through tissue, so its tail cannot be measured: lay both strands so "
    "that both eyes see them up to where tissue takes them in, clear of each other, and ask again"
)


@dataclass(frozen=True)
class Meant:
    """Which exit is meant: that at a pixel, or where exit and entry were a frame ago; neither where nothing tells.

    Fields:
        shortest_m, longest_m: as long as the tail can be; None where nobody has measured it to its end.
    """

    exit_pixel: Float64[np.ndarray, "2"] | None = None
    exit_camera: Float64[np.ndarray, "3"] | None = None
    entry_camera: Float64[np.ndarray, "3"] | None = None
    shortest_m: float | None = None
    longest_m: float | None = None


@dataclass(frozen=True)
class Line:
    """One curve that is seen of a thread; `is_meant` where it is the message's own, and none of its strands."""

    thread: ThreadReconstruction
    curve: ThreadCurve
    is_meant: bool


@dataclass(frozen=True)
class Strands:
    """A thread on both sides of a bite of tissue.

    Fields:
        tail: from the free end to the exit.
        line: that the standing strand is a part of; the tail's own where that strand is not seen.
        standing: shares of that line's length at the entry and at the strand's other end; None where it is not seen.
        ends: that other end is where the strand ends, and not where it leaves the view or something hides it.
        tail_points: along the tail, where that is on another line; none else.
    """

    free_end: StrandEnd
    exit: StrandEnd
    entry: StrandEnd
    tail: TailLength
    line: Line
    standing: tuple[float, float] | None
    ends: bool
    tail_points: Float64[np.ndarray, "k 3"]

    @property
    def gives_m(self) -> float:
        """By so much tissue follows thread at half of the newton that it is to bear.

        A bite of length g gives as a disc of its size on an elastic half space, F / (E* g): the longest one by GIVES_M.
        """
        bite_m = _apart(self.exit, self.entry.point_camera)
        return GIVES_M * MOST_BITE_M / float(np.clip(bite_m, LEAST_BITE_M, MOST_BITE_M))


@dataclass(frozen=True)
class _Bite:
    """One way to take a gap.

    Fields:
        line, standing: as in `Strands`; of_tail: the line that the tail is a part of.
        far: the standing strand's other end.
        points, covariance: of the tail, from its free end to its exit.
    """

    free_end: StrandEnd
    exit: StrandEnd
    entry: StrandEnd
    far: StrandEnd
    of_tail: Line
    line: Line
    standing: tuple[float, float] | None
    points: Float64[np.ndarray, "n 3"]
    covariance: Float64[np.ndarray, "n 3 3"]


def lines_of(thread: ThreadReconstruction) -> list[Line]:
    """All curves of a message, but for strands that are none of a thread; that of the thread where it has no strands.

    Raises:
        NoGraspError: where there is none.
    """
    strands: list[Line] = []
    for strand in thread.apart:
        with suppress(NoGraspError):
            strands.append(Line(strand, curve_of(strand), is_meant=False))
    return strands or [Line(thread, curve_of(thread), is_meant=True)]


def strands_of(
    thread: ThreadReconstruction, config: PlannerConfig, meant: Meant, needle: NeedleAround | None = None
) -> Strands:
    """The strands of a thread, its ends and its tail, in metres and the camera frame.

    Raises:
        NoGraspError: where the thread passes through no tissue that is seen, or which strand is the tail cannot be
            told.
    """
    lines = lines_of(thread)
    if any(thread_covariance(line.thread, line.curve, np.zeros(1)) is None for line in lines):
        raise NoGraspError("the reconstruction does not tell how well it knows the thread, so no tail can be measured")
    bites = [bite for line in lines for bite in _on_one_curve(line)] + [*_between(lines)]
    alone = [bite for line in lines for bite in _alone(line, meant, config)]
    bites, alone = ([_may_go_on(bite, lines) for bite in some] for some in (bites, alone))
    curve = lines[0].curve
    bite = _meant(bites, alone, curve, config, meant, needle)
    depth_m = float(np.mean([bite.free_end.point_camera[2], bite.exit.point_camera[2]]))
    hidden = bite.free_end.sight is not EndSight.SEEN
    # beyond the border nothing is seen, and what is told of it is a guess
    gone = np.flatnonzero(~inside(curve, bite.points)) if hidden else np.zeros(0, int)
    shown = slice(int(gone[-1]) + 1 if len(gone) else 0, None)
    tail = tail_length(
        bite.points[shown], bite.covariance[shown], config.correlation_m, END_PX * depth_m / curve.camera.fx_px, hidden
    )
    tail = replace(tail, deviation_m=float(np.hypot(tail.deviation_m, _beyond_m(bite, meant))))
    low_m, high_m = tail.interval_m
    if meant.longest_m is not None and low_m > meant.longest_m:
        at_most = f"a tail of {1e3 * meant.longest_m:.1f} mm at most"
        raise NoGraspError(f"what is taken for {at_most} is {1e3 * tail.length_m:.1f} mm long, and is another strand")
    if meant.shortest_m is not None and high_m is not None and high_m < meant.shortest_m:
        at_least = f"a tail of {1e3 * meant.shortest_m:.1f} mm at least"
        raise NoGraspError(f"of {at_least} only {1e3 * tail.length_m:.1f} mm are seen, though its end seems to be")
    apart = bite.points if bite.of_tail is not bite.line else np.zeros((0, 3))
    ends = bite.far.sight is EndSight.SEEN
    return Strands(bite.free_end, bite.exit, bite.entry, tail, bite.line, bite.standing, ends, apart)


def _on_one_curve(line: Line) -> Iterator[_Bite]:
    for start, end in _gaps(line.thread, line.curve):
        for free, out, into, far in ((0.0, start, end, 1.0), (1.0, end, start, 0.0)):
            yield _bite((line, free, out), (line, into, far))


def _between(lines: Sequence[Line]) -> Iterator[_Bite]:
    """Where ends of two curves face each other, as far apart as a bite is long, and nearer than to any other end."""
    ends = [(line, s) for line in lines for s in (0.0, 1.0) if _may_go_in(line, s)]
    if len(ends) < 2:
        return
    place = np.stack([line.curve.points(np.array([s]))[0] for line, s in ends])
    apart_m = np.linalg.norm(place[:, None] - place[None], axis=2)
    np.fill_diagonal(apart_m, np.inf)
    nearest = np.argmin(apart_m, axis=1)
    for k, other in enumerate(nearest.tolist()):
        (tail, out), (standing, into) = ends[k], ends[other]
        if tail is not standing and nearest[other] == k and LEAST_GAP_M <= apart_m[k, other] <= MOST_GAP_M:
            yield _bite((tail, 1.0 - out, out), (standing, into, 1.0 - into))


def _may_go_on(bite: _Bite, lines: Sequence[Line]) -> _Bite:
    """The same bite, its tail's free end hidden where that and an end of another curve face each other nearby."""
    tip, into = bite.points[0], unit_vectors(bite.points[0] - bite.points[1])
    for line in lines:
        for s, next_to in ((0.0, 1e-3), (1.0, 1.0 - 1e-3)):
            end, inner = line.curve.points(np.array([s, next_to]))
            way = end - tip
            faces = way @ into > 0 and way @ (inner - end) > 0 and np.linalg.norm(way) <= MOST_GAP_M
            if faces and line is not bite.of_tail and bite.free_end.sight is EndSight.SEEN:
                return replace(bite, free_end=replace(bite.free_end, sight=EndSight.HIDDEN))
    return bite


def _may_go_in(line: Line, s: float) -> bool:
    """Whether tissue may take in a curve at its end: where it leaves the view, or an instrument hides it, none does."""
    hidden = line.thread.ends_hidden is not None and bool(line.thread.ends_hidden[int(s)])
    return not hidden and _in_view(line.curve, line.curve.points(np.array([s]))[0]) is EndSight.SEEN


def _bite(tail: tuple[Line, float, float], standing: tuple[Line, float, float]) -> _Bite:
    """A bite between two stretches of curves: from free end to exit, and from entry to the other end."""
    (line, free, out), (on, into, far) = tail, standing
    s = np.linspace(free, out, SAMPLES)
    covariance = thread_covariance(line.thread, line.curve, s)
    assert covariance is not None  # noqa: S101 - looked at before
    # what tissue takes in ends there, whatever else might hide how it goes on
    exit_, entry = (
        replace(_end(*end), sight=_in_view(end[0].curve, _end(*end).point_camera)) for end in ((line, out), (on, into))
    )
    return _Bite(_end(line, free), exit_, entry, _end(on, far), line, on, (into, far), line.curve.points(s), covariance)


def _gaps(thread: ThreadReconstruction, curve: ThreadCurve) -> Iterator[tuple[float, float]]:
    """Unseen stretches between two seen ones as long as a bite is, where no instrument hides them."""
    joins = np.zeros((0, 2)) if thread.course is None else thread.course.joins[1:-1]
    stretches = np.concatenate((curve.unseen, joins))
    hidden = np.zeros((0, 2)) if thread.hidden is None else np.sort(thread.hidden, axis=1)
    reach = -1.0
    merged: list[list[float]] = []
    for start, end in stretches[np.argsort(stretches[:, 0], kind="stable")].tolist():
        if merged and start <= reach:
            merged[-1][1] = max(merged[-1][1], end)
        else:
            merged.append([start, end])
        reach = merged[-1][1]
    for start, end in merged:
        covered = np.clip(np.minimum(hidden[:, 1], end) - np.maximum(hidden[:, 0], start), 0.0, None).sum()
        long_m = (end - start) * curve.length_m
        if start > 0 and end < 1 and LEAST_GAP_M <= long_m <= MOST_GAP_M and covered < 0.5 * (end - start):
            yield start, end


def _alone(line: Line, meant: Meant, config: PlannerConfig) -> Iterator[_Bite]:
    """A tail that ends where its exit was, and nearer to that than to where the entry was."""
    if meant.exit_camera is None or meant.entry_camera is None:
        return
    s = np.linspace(0.0, 1.0, SAMPLES)
    points, covariance = line.curve.points(s), thread_covariance(line.thread, line.curve, s)
    assert covariance is not None  # noqa: S101 - looked at before
    for mine in (0, -1):
        off_m = float(np.linalg.norm(points[mine] - meant.exit_camera))
        if off_m <= min(config.goal_within_m, float(np.linalg.norm(points[mine] - meant.entry_camera))):
            here = replace(_end(line, float(s[mine])), sight=EndSight.SEEN)
            entry = StrandEnd(meant.entry_camera, here.covariance, EndSight.HIDDEN)
            order = slice(None, None, -1) if mine == 0 else slice(None)
            tip = _end(line, float(s[-1 - mine]))
            yield _Bite(tip, here, entry, entry, line, line, None, points[order], covariance[order])


def _beyond_m(bite: _Bite, meant: Meant) -> float:
    """Deviation of the tail where more is unseen than a bite takes, so that a part of the tail may be.

    The exit lies anywhere in what the shortest bite leaves of the gap.
    """
    gap_m = _apart(bite.exit, bite.entry.point_camera)
    most_m = MOST_BITE_M + (0.0 if meant.exit_camera is None else GIVES_M)
    return 0.0 if gap_m <= most_m else (gap_m - LEAST_BITE_M) / np.sqrt(3.0)


def _meant(
    bites: list[_Bite],
    alone: list[_Bite],
    curve: ThreadCurve,
    config: PlannerConfig,
    meant: Meant,
    needle: NeedleAround | None,
) -> _Bite:
    if meant.exit_camera is not None and meant.entry_camera is not None:
        were = meant.exit_camera, meant.entry_camera
        off_m = [max(_apart(b.exit, were[0]), _apart(b.entry, were[1])) for b in bites]
        if bites and min(off_m) <= config.goal_within_m:
            return bites[int(np.argmin(off_m))]
        if alone:
            return min(alone, key=lambda bite: _apart(bite.exit, were[0]))
        if bites:
            raise NoGraspError(f"exit and entry are not seen where they were: {1e3 * min(off_m):.0f} mm off")
    if not bites:
        raise NoGraspError(NO_BITE)
    if meant.exit_pixel is not None:
        at, _ = project(curve.camera, np.stack([bite.exit.point_camera for bite in bites]))
        off_px = np.linalg.norm(at - meant.exit_pixel, axis=1)
        nearest, next_ = np.argsort(off_px, kind="stable")[:2]
        # the pixel means a hole as long as no other one is as near
        within_px = 0.5 * float(np.linalg.norm(at[nearest] - at[next_]))
        if off_px[nearest] > within_px:
            near = f"the nearest exit is {off_px[nearest]:.0f} px from the pixel that was named"
            raise NoGraspError(f"{near}, and at most {within_px:.0f} px are accepted here: {WHICH}")
        return bites[int(nearest)]
    held = [b for b in bites if needle is not None and _apart(b.far, needle.swage_camera) <= config.goal_within_m]
    likely = held or [b for b in bites if b.free_end.sight is EndSight.SEEN and b.far.sight is not EndSight.SEEN]
    if len(likely) == 1:
        return likely[0]
    if len(bites) > 2:
        raise NoGraspError(f"the thread passes through tissue at several places: {WHICH}")
    raise NoGraspError(f"which of both strands is the tail cannot be told: {WHICH}")


def _apart(end: StrandEnd, place_camera: Float64[np.ndarray, "3"]) -> float:
    return float(np.linalg.norm(end.point_camera - place_camera))


def _end(line: Line, s: float) -> StrandEnd:
    """An end of the curve, or of what is seen of it."""
    at = np.array([s])
    point, covariance = line.curve.points(at)[0], thread_covariance(line.thread, line.curve, at)
    assert covariance is not None  # noqa: S101 - looked at before
    sight = _in_view(line.curve, point)
    if sight is EndSight.SEEN and s in (0.0, 1.0) and _hides(line.thread, line.curve, int(s)):
        sight = EndSight.HIDDEN
    return StrandEnd(point, covariance[0], sight, s if line.is_meant else None)


def _hides(thread: ThreadReconstruction, curve: ThreadCurve, which: int) -> bool:
    """Whether something hides an end of the thread, or the thread may go on from there to another piece in view."""
    if thread.course is not None and len(thread.course.probability) and thread.course.probability[-which] < SURE:
        return True
    if thread.ends_hidden is not None and bool(thread.ends_hidden[which]):
        return True
    stretches = curve.unseen if thread.hidden is None else np.concatenate((curve.unseen, thread.hidden))
    return bool(((stretches[:, 0] <= which) & (stretches[:, 1] >= which)).any())


def _in_view(curve: ThreadCurve, point: Float64[np.ndarray, "3"]) -> EndSight:
    return EndSight.SEEN if inside(curve, point[None])[0] else EndSight.OUT_OF_VIEW


def inside(curve: ThreadCurve, points: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, "n"]:
    """Which places lie in both images, and not at the border of one."""
    last = np.array([curve.camera.image_width, curve.camera.image_height]) - 1.0 - BORDER_PX
    left, right = pixels(curve, points)
    inside = (left >= BORDER_PX) & (left <= last) & (right >= BORDER_PX) & (right <= last)
    return inside[:, 0] & inside[:, 1]
