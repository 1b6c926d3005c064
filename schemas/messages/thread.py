"""What is known of the thread: observations, and the reconstructed curve."""

import enum
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from schemas.checks import Number, SInt64, UInt32, UInt64, check_message, require
from schemas.messages.imaging import FrameStamp, Image, RectifiedStereo
from schemas.messages.running import Consumed

_CUBIC = 3


class Status(enum.Enum):
    """Whether a stage has a result. A failure always has a reason beside it."""

    OK = 1
    FAILED = 2


class Severity(enum.Enum):
    """What a finding means for the result: good to know, less trust, or not to be used."""

    NOTE = 1
    WARNING = 2
    FAULT = 3


@dataclass(frozen=True)
class Judgement:
    """A finding about the input: a stable code, a plain sentence, and what to do about it."""

    code: str
    severity: Severity
    finding: str
    remedy: str


@dataclass(frozen=True)
class Centrelines:
    """The middle of the thread in one rectified image: points in order along unbranched pieces, of unknown sequence.

    Fields:
        point_px: (u, v) of each point, sub-pixel; neighbours on a piece lie about two pixels apart, in older
            recordings one.
        piece: number of the piece that each point belongs to, never decreasing.
        width_px: apparent width of the thread there.
        deviation_px: standard deviation of the point across the thread.
    """

    point_px: Float64[np.ndarray, "n 2"]
    piece: Int64[np.ndarray, "n"]
    width_px: Float64[np.ndarray, "n"]
    deviation_px: Float64[np.ndarray, "n"]

    def __post_init__(self) -> None:
        check_message(self)
        require(bool((self.piece[:1] >= 0).all()), "pieces are numbered from 0")
        require(bool((np.diff(self.piece) >= 0).all()), "the points of each piece must follow each other")
        require(bool((self.width_px > 0).all()), "the width of the thread must be positive")
        require(bool((self.deviation_px > 0).all()), "the deviation of a point must be positive")


GIVEN_MASKS = "mask"
"""The `segmenter` of observations whose masks were given: somebody has said what is thread."""


def no_centrelines() -> Centrelines:
    """Centrelines of an image that shows no thread."""
    return Centrelines(np.zeros((0, 2)), np.zeros(0, np.int64), np.zeros(0), np.zeros(0))


@dataclass(frozen=True)
class ThreadCandidate:
    """One of the threads that a pair shows.

    Fields:
        score: from 0 to 1, the higher the surer; no probability.
        left_px, right_px: (u, v) of places along its middle in either rectified image, in order, as far as it is seen.
        width_px: apparent width, median.
        colour_bgr: of its middle, median; blue, green, red, 0 to 255.
    """

    score: float
    left_px: Float64[np.ndarray, "n 2"]
    right_px: Float64[np.ndarray, "m 2"]
    width_px: float
    colour_bgr: Int64[np.ndarray, "3"]

    def __post_init__(self) -> None:
        check_message(self)
        require(0 <= self.score <= 1, "the score of a candidate must lie within 0 and 1")
        require(self.width_px > 0, "the width of the thread must be positive")


class Occluder(enum.Enum):
    """What may hide thread; UNKNOWN is something that does, and of which nobody can tell what it is."""

    TOOL = 1
    NEEDLE = 2
    UNKNOWN = 3


@dataclass(frozen=True)
class Occluders:
    """What may hide thread: smaller copies of both rectified images, each pixel the number of an `Occluder`, or 0.

    Fields:
        sequence: of the frame in which they were looked for.
    """

    left: Image
    right: Image
    sequence: UInt64

    def __post_init__(self) -> None:
        check_message(self)


@dataclass(frozen=True)
class Trail:
    """What the next frame finds the centrelines of one image again by.

    Fields:
        loose_start, loose_end: whether each piece begins and ends at an end of the thread; else a crossing cuts it.
        length_px: of each piece.
        colour_bgr: of the thread and of the ground on either side, at every fourth point of each piece and at its last.
        told_start, told_end: whether the image itself shows that a piece ends there.
    """

    loose_start: Bool[np.ndarray, "k"]
    loose_end: Bool[np.ndarray, "k"]
    length_px: Float64[np.ndarray, "k"]
    colour_bgr: UInt8[np.ndarray, "m 3 3"]
    told_start: Bool[np.ndarray, "k"]
    told_end: Bool[np.ndarray, "k"]

    def __post_init__(self) -> None:
        check_message(self)
        parts = self.loose_start, self.loose_end, self.length_px, self.told_start, self.told_end
        require(len({len(part) for part in parts}) == 1, "every piece has two ends and a length")


@dataclass(frozen=True)
class StrandLines:
    """The centrelines of a thread beside the one that is meant, which looks like it.

    Fields:
        trail_left, trail_right: what the next frame follows them by.
    """

    centrelines_left: Centrelines
    centrelines_right: Centrelines
    trail_left: Trail
    trail_right: Trail

    def __post_init__(self) -> None:
        check_message(self)


@dataclass(frozen=True)
class RightEye:
    """By how much the rectified right image is out of line with the left one, as the pair itself shows.

    Fields:
        rows_px: by how many rows what corresponds lies lower in it, before it is turned.
        turned_deg: about the principal point, clockwise as it is looked at.
        magnified: as a ratio.
    """

    rows_px: float
    turned_deg: float
    magnified: float

    def __post_init__(self) -> None:
        check_message(self)
        require(0.5 <= self.magnified <= 2.0, "no eye shows things half or twice as large")
        require(abs(self.rows_px) <= 1e4 and abs(self.turned_deg) <= 360, "no eye is so far out of line")


@dataclass(frozen=True)
class ThreadObservations:
    """What perception saw of the thread in one stereo pair: ordered points, and the matches behind them.

    Fields:
        points_camera: the observations, ordered along the thread.
        half_size_px: half the size (u, v) of the segmented region around each observation's left projection.
        matched_px: left u, left v and disparity of every matched pixel, of which `inlier` marks those kept and
            `match_cost` gives the cost of the best and of the second-best match.
        mask_left, mask_right: coverage by thread in the rectified images, 0 to 255.
        gaps: indices j where no segmented pixels lead from observation j to the next one.
        centrelines_left, centrelines_right: the middle of the thread in each rectified image, without depth.
        looked_sequence: of the frame whose whole images were last looked at, with the segmenter chosen; later frames
            are looked at near the thread, and in parts (`glances`).
        is_bright: whether the thread is brighter than what lies beside it, as seen then.
        prompt_px: (u, v) in the rectified left image, on the thread that an operator means; None where any is meant.
        right_eye: by how much the rectified right image was out of line before anything was looked for in it; None
            where it was in line. Masks and centrelines are of the image put in line.
        disparities_px: least and greatest disparity at which thread may be, by what the ground of the pair shows; None
            where it shows too little.
        calibration_covariance: of the calibration's errors (`shared.calibration.uncertainty`), as its file states or as
            is usual; None where it is taken for exact.
        rows_moved_up: the same as `right_eye.rows_px` where that is all: older recordings have nothing else.
        picture_left, picture_right: checksums of the frame's pictures, by which one is known that stands still.
        picture_left_since, picture_right_since: sequence of the first frame in turn with the same picture.
        candidates: the threads that the pair shows, the one that is meant first, the others by score. The centrelines
            leave out those that are certainly not meant.
        occluders: None where nobody has looked for any, or the image does not tell.
        score_map: how much of a pixel of the left image the segmenter takes for thread, 0 to 255, in a smaller copy.
        surface_sequence: of the frame of the newest surface of the tissue; None where none has been made yet.
        trail_left, trail_right: what the next frame follows the centrelines by; None where it is to look for thread.
        segmented_sequence: of the frame in which thread was last looked for pixel by pixel. Where that is another one,
            the centrelines were followed from it, frame by frame, the masks are drawn along them, and no thread that
            has come into view since is told; None where nobody says.
        frames_since_look: how many frames were looked at since that of looked_sequence, this one included.
        judged_sequence: of the frame whose pair was last judged; None where that is the one of looked_sequence.
        glanced_sequence: of the frame in which a part of one image was last segmented beside a thread that was
            followed, so that thread elsewhere is seen; None where there was none since the last look at the whole.
        glances: how many parts were segmented like that since then.
        strands: the centrelines of the candidates that are certainly not meant and look like the one that is, so that
            tissue may hide how they go on to it; measured in this frame, as those of the one that is meant are.
    """

    stamp: FrameStamp
    camera: RectifiedStereo
    status: Status
    reason: str
    segmenter: str
    points_camera: Float64[np.ndarray, "n 3"]
    half_size_px: Float64[np.ndarray, "n 2"]
    matched_px: Float64[np.ndarray, "p 3"]
    match_cost: Float64[np.ndarray, "p 2"]
    inlier: Bool[np.ndarray, "p"]
    mask_left: Image
    mask_right: Image
    judgements: tuple[Judgement, ...] = ()
    gaps: Int64[np.ndarray, "g"] = field(default_factory=lambda: np.zeros(0, np.int64))
    centrelines_left: Centrelines = field(default_factory=no_centrelines)
    centrelines_right: Centrelines = field(default_factory=no_centrelines)
    looked_sequence: UInt64 = 0
    is_bright: bool = False
    prompt_px: Float64[np.ndarray, "2"] | None = None
    rows_moved_up: SInt64 = 0
    picture_left: UInt32 = 0
    picture_right: UInt32 = 0
    picture_left_since: UInt64 = 0
    picture_right_since: UInt64 = 0
    candidates: tuple[ThreadCandidate, ...] = ()
    occluders: Occluders | None = None
    score_map: Image | None = None
    surface_sequence: UInt64 | None = None
    trail_left: Trail | None = None
    trail_right: Trail | None = None
    segmented_sequence: UInt64 | None = None
    frames_since_look: UInt64 = 0
    judged_sequence: UInt64 | None = None
    glanced_sequence: UInt64 | None = None
    glances: UInt64 = 0
    right_eye: RightEye | None = None
    disparities_px: Float64[np.ndarray, "2"] | None = None
    calibration_covariance: Float64[np.ndarray, "8 8"] | None = None
    strands: tuple[StrandLines, ...] = ()
    consumed: Annotated[tuple[Consumed, ...], Number(15)] = ()

    def __post_init__(self) -> None:
        check_message(self)
        _check_reason(self.status, self.reason)
        require(bool((self.points_camera[:, 2] > 0).all()), "an observation lies behind the camera")
        require(bool((self.half_size_px > 0).all()), "half_size_px must be positive")
        last = len(self.points_camera) - 1
        require(bool(((self.gaps >= 0) & (self.gaps < last)).all()), "a gap must lie between two observations")


@dataclass(frozen=True)
class ReliabilityRegions:
    """Where the curve must pass: at `s`, within `bound_px` and `bound_depth` of each centre (paper, eq. 4).

    `slack` is how far outside its region the curve was let, where regions contradict each other, as a multiple of
    the region's own bounds: 0 inside, 1 where the region would have to be twice as large.
    """

    s: Float64[np.ndarray, "n"]
    centre_camera: Float64[np.ndarray, "n 3"]
    bound_px: Float64[np.ndarray, "n 2"]
    bound_depth: Float64[np.ndarray, "n"]
    slack: Float64[np.ndarray, "n"]

    def __post_init__(self) -> None:
        check_message(self)
        _check_within_thread("regions.s", self.s)
        require(bool((np.diff(self.s) >= 0).all()), "the parameters of the regions must not decrease")
        require(bool((self.bound_px > 0).all() and (self.bound_depth > 0).all()), "bounds must be positive")
        require(bool((self.slack >= 0).all()), "slack must not be negative")


def _no_numbers(*shape: int) -> Float64[np.ndarray, "..."]:
    return np.zeros(shape)


class TrackStep(enum.Enum):
    """What became of the track in a frame: begun, gone on from the last curve, begun anew, or lost for now."""

    STARTED = 1
    CONTINUED = 2
    RESTARTED = 3
    LOST = 4


@dataclass(frozen=True)
class ThreadTrack:
    """How a curve stands to those of the frames before, and all that the next frame goes on from.

    Fields:
        reason: why the track was begun anew or lost.
        frames: since it was begun; a lost track counts on.
        innovation: how far the curve is from where it was predicted: the square, in predicted variances, per number
            of a control point; about 1 or less where the prediction holds.
        found_share: of the points of both centrelines, those that lie where the prediction looks for them.
        stamp: of the last frame that had a curve.
        knots, control_points_camera: of that curve, clamped and cubic, in the direction that the track keeps.
        covariance: [i, j] of control points i and i + j; zeros past the last one.
        smoothing, span_weight: of its fit.
        row_offset_px: how many rows the right image lies lower than the left one, at the principal point.
        row_slopes_px: by how many more for each focal length to the right, downward, and both; None where by none.
        length: of the curve when the track was begun, in the unit of the calibration.
        material_s: which places of the thread the ends of the curve are, on the scale of the first curve, of which
            they are 0 and 1.
        velocity_camera: of the control points, a second, since the frame before; None in a track's first frame.
    """

    step: TrackStep
    reason: str
    frames: UInt32
    innovation: float
    found_share: float
    stamp: FrameStamp
    knots: Float64[np.ndarray, "k"]
    control_points_camera: Float64[np.ndarray, "m 3"]
    covariance: Float64[np.ndarray, "m 4 3 3"]
    smoothing: float
    span_weight: Float64[np.ndarray, "spans"]
    row_offset_px: float
    length: float
    material_s: Float64[np.ndarray, "2"]
    row_slopes_px: Float64[np.ndarray, "3"] | None = None
    velocity_camera: Float64[np.ndarray, "m 3"] | None = None

    def __post_init__(self) -> None:
        check_message(self)
        _check_clamped_spline(_CUBIC, self.knots, len(self.control_points_camera))
        spans = len(self.control_points_camera) - _CUBIC
        require(len(self.span_weight) == spans, f"span_weight must hold {spans} numbers, one for each knot span")
        begun_well = self.step in (TrackStep.STARTED, TrackStep.CONTINUED)
        require(begun_well == (self.reason == ""), "a track that is lost or begun anew needs a reason, and no other")
        require(self.smoothing > 0 and bool((self.span_weight > 0).all()), "smoothing must be positive")
        require(self.length > 0, "the length of a thread must be positive")
        require(self.material_s[0] < self.material_s[1], "material_s must increase")


class Over(enum.Enum):
    """Which strand of a crossing lies nearer to the camera, the one of smaller or of larger arc length."""

    FIRST = 1
    SECOND = 2
    UNDETERMINED = 3


@dataclass(frozen=True)
class Crossing:
    """Where the thread crosses itself in the left image.

    Fields:
        s_first, s_second: arc lengths (0 to 1) of the two strands, in order.
        point_px: (u, v) of the crossing.
        over: the nearer strand; UNDETERMINED where the posterior does not tell.
        depth_apart: how much deeper the second strand lies, in the calibration's unit.
    """

    s_first: float
    s_second: float
    point_px: Float64[np.ndarray, "2"]
    over: Over
    depth_apart: float

    def __post_init__(self) -> None:
        check_message(self)
        require(0 <= self.s_first < self.s_second <= 1, "the strands of a crossing must be in order within 0 and 1")


SURE = 0.95
"""A join of a course that is less probable is undecided."""


@dataclass(frozen=True)
class ThreadCourse:
    """The course of a thread through the pieces that are seen of it, and how sure it is.

    Fields:
        joins: stretches of arc length over which it leads from one piece to the next, in order. The first and the last
            are the thread's ends, joins of a place with itself; one between them may be as short.
        probability: that the thread leads so over each join, and goes on to no other piece in view from each end.
        other: the stretches of this thread in the order and direction in which the next likeliest course passes them;
            none where this one is as good as certain.
    """

    joins: Float64[np.ndarray, "j 2"]
    probability: Float64[np.ndarray, "j"]
    other: Float64[np.ndarray, "m 2"]

    def __post_init__(self) -> None:
        check_message(self)
        _check_within_thread("joins", self.joins)
        _check_within_thread("other", self.other)
        require(bool((self.joins[:, 0] <= self.joins[:, 1]).all()), "a join must not end before it begins")
        require(bool(((self.probability >= 0) & (self.probability <= 1)).all()), "probability must lie within 0 and 1")

    @property
    def undecided(self) -> Float64[np.ndarray, "u 2"]:
        """The stretches over which the course is undecided; an end that may lead on is none."""
        return self.joins[1:-1][self.probability[1:-1] < SURE]

    @property
    def elsewhere(self) -> Float64[np.ndarray, "k 2"]:
        """From which arc length to which the next likeliest course leads otherwise; none where nothing is undecided."""
        if not len(self.undecided):
            return np.zeros((0, 2))
        leads = np.sort(np.column_stack((self.other[:-1, 1], self.other[1:, 0])), axis=1)
        known = (leads[:, None] == self.joins[None]).all(axis=2).any(axis=1)
        return leads[~known]


@dataclass(frozen=True)
class Strand:
    """One of several threads that look alike, as a curve; its fields are those of a reconstruction.

    One thread that passes through tissue is several to a camera.
    """

    degree: UInt32
    knots: Float64[np.ndarray, "k"]
    control_points_camera: Float64[np.ndarray, "m 3"]
    confidence_s: Float64[np.ndarray, "c"]
    confidence: Float64[np.ndarray, "c"]
    posterior_s: Float64[np.ndarray, "q"]
    posterior_covariance: Float64[np.ndarray, "q 3 3"]
    unseen: Float64[np.ndarray, "g 2"]
    hidden: Float64[np.ndarray, "h 2"] | None
    ends_hidden: Bool[np.ndarray, "2"] | None
    course: ThreadCourse | None

    def __post_init__(self) -> None:
        check_message(self)
        _check_clamped_spline(self.degree, self.knots, len(self.control_points_camera))


@dataclass(frozen=True)
class ThreadReconstruction:
    """The thread as a clamped B-spline in the camera frame, with how far it can be trusted.

    Fields:
        knots: the full knot vector with repeated ends, from 0 to 1.
        confidence_s, confidence: arc length (0 to 1), and how likely the thread passes within 1 mm of the curve there;
            of method `paper` its own heuristic (0 to 1).
        posterior_s, posterior_covariance: spline parameter (0 to 1) and covariance of the point there; empty where
            the method predicts none. What errors of the calibration bend is in it; a rigid motion of the whole field,
            which a hand-eye transform found through the same camera takes back, is not.
        calibration_covariance: of the calibration's errors; those of a place as the camera frame has it are
            `shared.calibration.uncertainty.displacements`. None where the calibration is taken for exact.
        unseen: stretches of arc length that not both images show, so that depth there is a guess.
        track: where the thread is followed from frame to frame.
        crossings: where the thread crosses itself in the left image.
        other_threads_px: a left pixel (u, v) on each longer piece of thread that is none of this one.
        hidden: stretches of arc length behind what perception took for an occluder; None where nobody has looked.
        ends_hidden: whether the thread may go on, hidden, at s = 0 and at s = 1; None where nobody has looked.
        other_threads: candidates of perception that are none of this thread, by score.
        left_over_share: of the middle of what was segmented as thread in the left image, how much lies neither on this
            thread nor on one of `other_threads`; None where nobody has looked.
        left_over_px: the middle (u, v) of each longer stretch of that; None likewise.
        course: None where the method tells none.
        strands: where several threads in view look alike, the curves of all of them, that of the one that is meant
            included; each from the frame alone, as long as it is seen to be. None of those that failed.
    A failed reconstruction has a reason and no control points.
    """

    stamp: FrameStamp
    camera: RectifiedStereo
    status: Status
    reason: str
    method: str
    degree: UInt32
    knots: Float64[np.ndarray, "k"]
    control_points_camera: Float64[np.ndarray, "m 3"]
    regions: ReliabilityRegions
    confidence_s: Float64[np.ndarray, "c"]
    confidence: Float64[np.ndarray, "c"]
    posterior_s: Float64[np.ndarray, "q"] = field(default_factory=lambda: _no_numbers(0))
    posterior_covariance: Float64[np.ndarray, "q 3 3"] = field(default_factory=lambda: _no_numbers(0, 3, 3))
    unseen: Float64[np.ndarray, "g 2"] = field(default_factory=lambda: _no_numbers(0, 2))
    consumed: tuple[Consumed, ...] = ()
    track: ThreadTrack | None = None
    crossings: tuple[Crossing, ...] = ()
    other_threads_px: Float64[np.ndarray, "t 2"] = field(default_factory=lambda: _no_numbers(0, 2))
    hidden: Float64[np.ndarray, "h 2"] | None = None
    ends_hidden: Bool[np.ndarray, "2"] | None = None
    other_threads: tuple[ThreadCandidate, ...] = ()
    left_over_share: float | None = None
    left_over_px: Float64[np.ndarray, "l 2"] | None = None
    calibration_covariance: Float64[np.ndarray, "8 8"] | None = None
    course: ThreadCourse | None = None
    strands: tuple[Strand, ...] = ()

    def __post_init__(self) -> None:
        check_message(self)
        _check_reason(self.status, self.reason)
        require(self.left_over_share is None or 0 <= self.left_over_share <= 1, "a share lies within 0 and 1")
        require(
            bool(((self.confidence >= 0) & (self.confidence <= 1)).all()),
            "confidence must lie within 0 and 1",
        )
        _check_within_thread("confidence_s", self.confidence_s)
        _check_within_thread("posterior_s", self.posterior_s)
        _check_within_thread("unseen", self.unseen)
        if self.hidden is not None:
            _check_within_thread("hidden", self.hidden)
        if self.status is Status.OK:
            _check_clamped_spline(self.degree, self.knots, len(self.control_points_camera))
        else:
            require(len(self.control_points_camera) == 0, "a failed reconstruction has no control points")

    @property
    def apart(self) -> "tuple[ThreadReconstruction, ...]":
        """Each of `strands` as a reconstruction of its own."""
        none = _no_numbers(0)
        regions = ReliabilityRegions(none, _no_numbers(0, 3), _no_numbers(0, 2), none, none)
        return tuple(
            ThreadReconstruction(
                stamp=self.stamp,
                camera=self.camera,
                status=Status.OK,
                reason="",
                method=self.method,
                regions=regions,
                calibration_covariance=self.calibration_covariance,
                **vars(strand),
            )
            for strand in self.strands
        )

    @property
    def as_strand(self) -> Strand:
        """What another reconstruction tells of this one, which is OK, among its `strands`."""
        return Strand(**{name: getattr(self, name) for name in Strand.__dataclass_fields__})


def _check_clamped_spline(degree: int, knots: Float64[np.ndarray, "k"], control_points: int) -> None:
    require(degree >= 1, f"the degree of a spline must be at least 1, not {degree}")
    require(control_points > degree, f"a spline of degree {degree} needs more than {control_points} control points")
    expected = control_points + degree + 1
    require(
        len(knots) == expected,
        f"{control_points} control points of degree {degree} need {expected} knots, not {len(knots)}",
    )
    clamped = bool((knots[: degree + 1] == 0).all() and (knots[-degree - 1 :] == 1).all())
    require(clamped, f"the first and the last {degree + 1} knots must be 0 and 1")
    require(bool((np.diff(knots[degree:-degree]) > 0).all()), "the knots within must increase")


def _check_within_thread(name: str, s: Float64[np.ndarray, "..."]) -> None:
    require(bool(((s >= 0) & (s <= 1)).all()), f"{name} must lie within 0 and 1, the ends of the thread")


def _check_reason(status: Status, reason: str) -> None:
    require((status is Status.OK) == (reason == ""), "a failure needs a reason, and a success has none")
