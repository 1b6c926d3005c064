"""An instrument followed from view to view: searched for, followed, lost, and why.

A track begins with several searches, of which each begins anew and with other random numbers, and by turns with what
instruments are taken to look like. What was found before is looked at again in each new view, in which the tool has
moved, so that a wrong fit does not last. Once two agree, or enough were made, the one whose outline fits best is
followed, by one refinement a view. In between the lumped error walks by WALK a root of a second: what joints are wrong
by changes with where the arm is.

A view counts as a miss where too little of the outline is found, or the correction would jump further than its
covariance allows; after MISSES of them on end the track is lost, says so, and is begun again.
"""

import enum
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64

from agents.tool_tracker.correction import Correction
from agents.tool_tracker.evidence import SHRINK, Table, learnt
from agents.tool_tracker.outline import silhouette
from agents.tool_tracker.refinement import LARGEST_SHIFT, Refined, View, elsewhere, refined
from agents.tool_tracker.search import Begin, Soft, acquired, looking, prior

PRIOR_M, PRIOR_RAD = 0.006, 0.045
"""Deviation of each axis before anything was seen: what registrations promise (5 to 10 mm), and 2.6 degrees."""
WALK = np.repeat((0.0004, 0.006), 3)
AGAIN = np.repeat((0.0015, 0.015), 3)
"""Deviation with which what was found before is looked at again."""
ATTEMPTS, BEST = 6, 3
AGREE_M = 0.0012
FOUND_SHARE, AGREED_SHARE, FOUND_POINTS = 0.65, 0.75, 50
KEPT_SHARE, KEPT_POINTS = 0.5, 35
STEPS_M = (-0.003, 0.006, 0.003, -0.006)
SURE = 0.8
"""A fit of less quality is compared with others along the shaft."""
MISSES = 5
LEARNING = 0.15


class Following(enum.Enum):
    """How it stands with a track."""

    SEARCHING = 1
    FOLLOWED = 2
    LOST = 3


@dataclass(frozen=True, eq=False)
class Candidate:
    """Something that was found, and with which colours."""

    found: Refined
    table: Table


@dataclass(frozen=True, eq=False)
class Track:
    """What is known after a view.

    Fields:
        reason: why the tool is not followed, or was not seen in this view; empty where all is well.
        refined: of the last view in which it was seen.
        views: how many were looked at.
    """

    pivot: Float64[np.ndarray, "3"]
    state: Following = Following.SEARCHING
    reason: str = "nothing was looked at yet"
    correction: Correction | None = None
    refined: Refined | None = None
    table: Table | None = None
    candidates: tuple[Candidate, ...] = field(default=())
    attempts: int = 0
    misses: int = 0
    views: int = 0

    @property
    def consistent(self) -> bool:
        """Whether the correction may be used."""
        return self.state is Following.FOLLOWED and self.misses == 0


def begun(view: View) -> Track:
    """A track that has seen nothing yet, its pivot the jaw's pin."""
    return Track((view.T_camera_base @ view.T_base_tool)[:3, 3].copy())


def followed(track: Track, soft: Soft, view: View, elapsed_s: float, seed: int) -> Track:
    """The track after one more view, so long after the one before; `view.eyes` is not looked at."""
    track = replace(track, views=track.views + 1)
    if track.state is Following.FOLLOWED and track.correction is not None and track.table is not None:
        return _followed(track, track.correction, track.table, soft, view, elapsed_s)
    if track.state is Following.LOST:
        track = replace(track, state=Following.SEARCHING, candidates=(), attempts=0)
    return _searched(track, soft, view, seed)


def missed(track: Track, why: str) -> Track:
    """The track after a view in which the tool was not seen."""
    if track.state is not Following.FOLLOWED:
        return replace(track, reason=why)
    if track.misses + 1 >= MISSES:
        return Track(track.pivot, Following.LOST, f"lost: {why}", views=track.views)
    return replace(track, misses=track.misses + 1, reason=why)


def _followed(track: Track, correction: Correction, table: Table, soft: Soft, view: View, elapsed_s: float) -> Track:
    before = correction.spread(elapsed_s, WALK)
    looked = looking(view, soft, table)
    seen = refined(looked, before)
    if seen.quality < SURE:
        # one start a view, so that a view takes no longer than two refinements
        seen = elsewhere(looked, seen, (STEPS_M[track.views % len(STEPS_M)],), before)
    if why := _doubt(seen):
        return missed(replace(track, correction=before), why)
    return replace(
        track, correction=seen.correction, refined=seen, misses=0, reason="", table=_relearnt(table, soft, view, seen)
    )


def _doubt(seen: Refined) -> str:
    """What speaks against a view's correction; empty where nothing does."""
    if seen.expected < KEPT_POINTS:
        return "too little of the instrument is in view"
    if seen.fits < KEPT_SHARE:
        return f"{seen.fits:.0%} of its outline is where it should be, of {KEPT_SHARE:.0%} needed"
    if seen.shift > LARGEST_SHIFT:
        return "the instrument is not where the robot's joints say it went"
    return ""


def _searched(track: Track, soft: Soft, view: View, seed: int) -> Track:
    """One search more, and what was found before looked at again."""
    steps_m = STEPS_M[:2] if track.views % 2 else STEPS_M[2:]
    again = [_again(candidate, soft, view, steps_m) for candidate in track.candidates]
    rng = np.random.default_rng([seed, track.views])
    begin = Begin(track.attempts % len(Begin))
    new = Candidate(*acquired(soft, view, prior(track.pivot, PRIOR_M, PRIOR_RAD), rng, begin))
    candidates = sorted((*again, new), key=lambda one: -one.found.quality)[:BEST]
    attempts = track.attempts + 1
    best, others = candidates[0], candidates[1:]
    good = best.found.fits >= FOUND_SHARE and best.found.expected >= FOUND_POINTS
    if good and (attempts >= ATTEMPTS or any(_agree(best, other) for other in others)):
        return Track(
            track.pivot, Following.FOLLOWED, "", best.found.correction, best.found, best.table, views=track.views
        )
    told = f"{best.found.fits:.0%} of an outline found, of {FOUND_SHARE:.0%} needed"
    return replace(track, reason=f"searching: {told}", candidates=tuple(candidates), attempts=attempts)


def _again(candidate: Candidate, soft: Soft, view: View, steps_m: tuple[float, ...]) -> Candidate:
    before = candidate.found.correction
    loose = Correction(before.twist, np.diag(AGAIN**2), before.pivot)
    looked = looking(view, soft, candidate.table)
    found = elsewhere(looked, refined(looked, loose), steps_m)
    return Candidate(found, _relearnt(candidate.table, soft, view, found))


def _agree(one: Candidate, other: Candidate) -> bool:
    a, b = one.found.correction, other.found.correction
    return (
        min(one.found.fits, other.found.fits) >= AGREED_SHARE
        and float(np.linalg.norm(a.twist[:3] - b.twist[:3])) < AGREE_M
    )


def _relearnt(table: Table, soft: Soft, view: View, seen: Refined) -> Table:
    """The colours with a little of those of this view."""
    camera = view.camera
    size = (camera.image_height // SHRINK, camera.image_width // SHRINK)
    parts = view.parts(seen.correction.matrix)
    left, right = (
        silhouette(camera, parts, eye_x, size).astype(np.float32) * 0.96 + 0.02 for eye_x in (0.0, camera.baseline)
    )
    new = learnt(soft, (left, right), False)
    return ((1 - LEARNING) * table + LEARNING * new).astype(np.float32)
