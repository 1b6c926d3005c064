"""What is in the images as Rerun shows it: frames as they travelled, and what perception and tool tracker see in them.

world/{side}/candidates     the threads that perception tells apart, each in its colour; the left ones with their score
world/{side}/occluders      what may hide thread, as translucent regions: tool, needle, unknown
perception/score            how much of each pixel the segmenter takes for thread, when the whole was last looked at
perception/score/pieces     the left image's pieces of thread on that map, each with the mean log-odds of its pixels
perception/verdict          in words: what is judged of the images, which threads there are, what hides them

Of the paper's method, which matches pixels; other methods leave these empty:

world/left/match_cost       the matched pixels in the left image: green where the best match costs far less than the
                            second-best, red where both cost alike, so that the other may be the true one
match/cost/best, second     medians over the matched pixels of a frame
match/kept                  the share of matched pixels that is kept
match/histogram/best        how many matched pixels have a best match of which cost
match/histogram/second      the same of the second-best

Of tissue and instruments, in millimetres:

world/surface                       a cloud of points, by how sure their depth is: from green over yellow to red
world/plan/{arm}/contact            the place of a plan's jaws that comes nearest to the tissue, or deepest into it
world/left/tool/{arm}/registered    an instrument's outline by registration and joints alone
world/left|right/tool/{arm}/found   its outline with the correction
tool/off/{arm}, deviation/{arm}     how far its tip is from where it is registered, and how sure that is
lanes/tool_{arm}                    searched for, followed, lost

`to_shown` leads from pixels of the right image in line to those of the one that is shown.
"""

import cv2
import numpy as np
import rerun as rr
from jaxtyping import Bool, Float64, UInt8

from agents.viewer import colours
from agents.viewer.entity import HALF_PX, MM_PER_METRE, SIDES, Entity, camera_in_mm
from agents.viewer.image_pane import decoded_mask, enlarged
from agents.viewer.report import finding_text, findings, stereo_text, threads_text
from agents.viewer.session_mapping import lane, said
from schemas.messages import (
    GraspPlan,
    Image,
    ImageEncoding,
    Status,
    StereoFrame,
    ThreadCandidate,
    ThreadObservations,
    TissueSurface,
    ToolCorrection,
    ToolStatus,
)
from shared.camera import backproject
from shared.images import ImageDataError, decode_image, encode_image
from shared.right_eye import IN_LINE, Affine, moved

JPEG_QUALITY = 85
"""Of images that travel raw, which would fill a disk within minutes."""

_MEDIA = {ImageEncoding.JPEG: ("image/jpeg", b"\xff\xd8\xff"), ImageEncoding.PNG: ("image/png", b"\x89PNG\r\n")}


def frame_entities(frame: StereoFrame, rectified: bool) -> list[Entity]:
    """Both images: on the cameras of space where they are rectified, otherwise apart."""
    left, right = ("world/left/image", "world/right/image") if rectified else ("camera/raw/left", "camera/raw/right")
    return [(left, [encoded(frame.left)]), (right, [encoded(frame.right)])]


def encoded(image: Image) -> rr.EncodedImage:
    """An image as it travelled; a raw one is compressed.

    Raises:
        ImageDataError: where it does not begin as its encoding does.
    """
    if image.encoding is ImageEncoding.RAW:
        image = encode_image(decode_image(image), ImageEncoding.JPEG, JPEG_QUALITY)
    media_type, begins = _MEDIA[image.encoding]
    if not image.data.startswith(begins):
        raise ImageDataError(f"{len(image.data)} bytes are no {image.encoding.name}, though the message says so")
    return rr.EncodedImage(contents=image.data, media_type=media_type)


def coverage(mask: Image) -> UInt8[np.ndarray, "h w"]:
    coverage = decoded_mask(mask)
    if coverage is None:
        raise ImageDataError("a mask is no image of the size that it claims")
    return coverage


OPACITY = 60
"""Of 255."""
LARGEST_PIXELS = 1 << 26
THICK = 1.2
"""In pixels of the screen; the reconstructed curve lies over the candidate that it is."""


def candidate_entities(observations: ThreadObservations, to_shown: Affine = IN_LINE) -> list[Entity]:
    """Every candidate as a line of its own colour, with its number and score in the left image."""
    listed = observations.candidates
    return [
        ("world/left/candidates", [_lines([c.left_px for c in listed])]),
        ("world/left/candidates/scores", [_scores(listed)]),
        ("world/right/candidates", [_lines([moved(c.right_px, to_shown) for c in listed])]),
    ]


def occluder_entities(observations: ThreadObservations, to_shown: Affine = IN_LINE) -> list[Entity]:
    """Regions that may hide thread, over each image; empty where there are none."""
    found = observations.occluders
    maps = (None, IN_LINE), (None, IN_LINE)
    if found is not None:
        maps = (found.left, IN_LINE), (found.right, to_shown)
    size = observations.camera.image_width, observations.camera.image_height
    return [
        (f"world/{side}/occluders", [_regions(image, size, by)]) for side, (image, by) in zip(SIDES, maps, strict=True)
    ]


def score_entities(observations: ThreadObservations) -> list[Entity]:
    """The map of the segmenter's score, where the message has one: the last one stands until the next."""
    score = observations.score_map
    if score is None or score.encoding is ImageEncoding.RAW:
        return []
    media_type = "image/jpeg" if score.encoding is ImageEncoding.JPEG else "image/png"
    shown: list[Entity] = [("perception/score", [rr.EncodedImage(contents=score.data, media_type=media_type)])]
    levels = decoded_mask(score)
    return shown if levels is None else [*shown, ("perception/score/pieces", [_pieces(observations, levels)])]


def verdict_entities(observations: ThreadObservations) -> list[Entity]:
    """What is judged of the input, and what was seen, in words."""
    return [("perception/verdict", [rr.TextDocument(verdict(observations), media_type=rr.MediaType.MARKDOWN)])]


def verdict(observations: ThreadObservations) -> str:
    """The same as text, in Markdown."""
    said = [f"**{finding_text(judgement)}**" for judgement in findings(observations)]
    if observations.status is not Status.OK:
        said.insert(0, f"**No thread:** {observations.reason}")
    elif not said:
        said = ["Nothing is wrong with the images."]
    return "\n\n".join([*said, *stereo_text(observations), *threads_text(observations)])


def _lines(lines: list[np.ndarray]) -> rr.LineStrips2D:
    rgb = [colours.candidate_rgb(number) for number in range(len(lines))]
    return rr.LineStrips2D([line + HALF_PX for line in lines], colors=rgb, radii=[-THICK])


def _scores(listed: tuple[ThreadCandidate, ...]) -> rr.Points2D:
    """Number and score at a place on each thread, another one for each, so that they do not meet where threads do."""
    places = [c.left_px[int((len(c.left_px) - 1) * (k + 1) / (len(listed) + 1))] for k, c in enumerate(listed)]
    return rr.Points2D(
        np.array(places).reshape(-1, 2) + HALF_PX,
        colors=[colours.candidate_rgb(number) for number in range(len(listed))],
        labels=[f"{number}: {candidate.score:.2f}" for number, candidate in enumerate(listed, 1)],
        show_labels=True,
        radii=[-2.0],
    )


def _pieces(observations: ThreadObservations, score: UInt8[np.ndarray, "r c"]) -> rr.LineStrips2D:
    """Each piece of the left centreline in a copy of the score, with what it scores."""
    lines, rows, columns = observations.centrelines_left, *score.shape
    at = (lines.point_px + HALF_PX) * (columns / observations.camera.image_width)
    column, row = (np.clip(at[:, k], 0, size - 1).astype(np.intp) for k, size in enumerate((columns, rows)))
    share = (score[row, column] + 0.5) / 256
    each = [lines.piece == number for number in np.unique(lines.piece)]
    log_odds = [float(np.log(share[some] / (1 - share[some])).mean()) for some in each]
    return rr.LineStrips2D(
        [at[some] for some in each],
        colors=[colours.candidate_rgb(number) for number in range(len(each))],
        labels=[f"{value:+.1f}" for value in log_odds],
        show_labels=True,
        radii=[-THICK],
    )


def _regions(image: Image | None, size: tuple[int, int], by: Affine) -> rr.AsComponents:
    kinds = None if image is None else decoded_mask(image)
    # a camera may claim any size
    if kinds is None or not kinds.any() or size[0] * size[1] > LARGEST_PIXELS:
        return rr.Clear(recursive=False)
    drawn = np.zeros((size[1], size[0], 4), np.uint8)
    for kind, rgb in colours.OCCLUDERS.items():
        drawn[enlarged(kinds == kind.value, size)] = (*rgb[::-1], OPACITY)
    if by is not IN_LINE:
        drawn = np.asarray(cv2.warpAffine(drawn, by, size, flags=cv2.INTER_NEAREST))
    return rr.EncodedImage(contents=cv2.imencode(".png", drawn)[1].tobytes(), media_type="image/png", draw_order=1.0)


MOST_SHOWN = 3000
BINS = 40
FAR = 4.0
"""Where the histogram ends, as a multiple of the median of the second-best costs: a few cost a thousand times more."""


def match_entities(observations: ThreadObservations) -> list[Entity]:
    """Match costs in the image, over time and as a histogram."""
    cost, kept = observations.match_cost, observations.inlier
    some = slice(None, None, 1 + len(cost) // MOST_SHOWN)
    at = rr.Points2D(
        observations.matched_px[some, :2] + HALF_PX,
        colors=colours.confidence_rgb(distinctness(cost[some])),
        radii=[-1.5],
    )
    medians = [_median(cost[:, column]) for column in (0, 1)]
    return [
        ("world/left/match_cost", [at]),
        ("match/cost/best", [rr.Scalars(medians[0])]),
        ("match/cost/second", [rr.Scalars(medians[1])]),
        ("match/kept", [rr.Scalars(float(kept.mean()) if len(kept) else np.nan)]),
        *_histograms(cost),
    ]


def distinctness(cost: Float64[np.ndarray, "p 2"]) -> Float64[np.ndarray, "p"]:
    """How much less the best match costs than the second-best, as a share of that: 0 alike, 1 free; NaN unknown."""
    best, second = cost.T
    with np.errstate(all="ignore"):
        share = 1.0 - best / second
    # a second-best that was never found costs infinitely much
    return np.clip(np.where(np.isinf(second) & np.isfinite(best), 1.0, share), 0.0, 1.0)


def _histograms(cost: Float64[np.ndarray, "p 2"]) -> list[Entity]:
    finite: Bool[np.ndarray, "p 2"] = np.isfinite(cost)
    last = FAR * float(np.median(cost[finite[:, 1], 1])) if finite[:, 1].any() else 0.0
    edges = np.linspace(0.0, last if last > 0 else 1.0, BINS + 1)
    middles, widths = 0.5 * (edges[:-1] + edges[1:]), np.diff(edges)
    return [
        (
            f"match/histogram/{name}",
            [
                rr.BarChart(
                    np.histogram(cost[finite[:, column], column], edges)[0].astype(np.float64),
                    abscissa=middles,
                    widths=widths.astype(np.float32),
                    color=rgb,
                )
            ],
        )
        for column, (name, rgb) in enumerate((("best", colours.GOOD), ("second", colours.REJECTED)))
    ]


def _median(values: Float64[np.ndarray, "p"]) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else np.nan


HALF_SURE = 0.004
"""Share of the depth that a deviation is, at which a cell is shown as half sure: 0.4 mm at 100 mm."""


def surface_entities(surface: TissueSurface) -> list[Entity]:
    """A point for each cell whose depth is known, grey where nothing tells how well."""
    v, u = np.nonzero(surface.valid)
    pixel = np.column_stack((surface.u_px[u], surface.v_px[v]))
    camera = camera_in_mm(surface.camera)
    # of the same camera, in another unit
    depth = surface.depth[v, u] * (camera.baseline / surface.camera.baseline)
    points = backproject(camera, pixel, depth)
    if surface.deviation is None:
        rgb = np.broadcast_to(np.array(colours.UNKNOWN, np.uint8), points.shape)
    else:
        rgb = colours.confidence_rgb(0.5 ** (surface.deviation[v, u] / surface.depth[v, u] / HALF_SURE))
    rgba = np.column_stack((rgb, np.full(len(rgb), colours.FAINT, np.uint8)))
    return [("world/surface", [rr.Points3D(points, colors=rgba, radii=[-1.5])])]


def contact_entities(plan: GraspPlan) -> list[Entity]:
    """Where the jaws of a plan, or of the best that tissue forbade, come nearest to the tissue; nothing else."""
    path = f"world/plan/{rr.escape_entity_path_part(plan.arm)}/contact"
    tissue = plan.tissue
    if tissue is None or tissue.place_camera is None:
        return [(path, [rr.Points3D([])])]
    rgb = colours.WARNING if plan.status is Status.OK else colours.BAD
    place = rr.Points3D(
        [MM_PER_METRE * tissue.place_camera],
        colors=[rgb],
        radii=[-6.0],
        labels=[tissue.sentence],
        show_labels=True,
    )
    return [(path, [place])]


LANES = {ToolStatus.CONVERGING: "started", ToolStatus.CONVERGED: "ok", ToolStatus.LOST: "lost"}
RADIUS_PX = 1.5


def tool_entities(told: ToolCorrection, changed: bool) -> list[Entity]:
    """Outlines and figures of one look; the lane and words where the status has `changed`."""
    arm = rr.escape_entity_path_part(told.arm)
    entities: list[Entity] = [
        (f"world/left/tool/{arm}/registered", [_outline(told.registered_left_px, colours.WARNING)]),
        (f"world/left/tool/{arm}/found", [_outline(told.found_left_px, colours.CHOSEN)]),
        (f"world/right/tool/{arm}/found", [_outline(told.found_right_px, colours.CHOSEN)]),
    ]
    if told.T_correction is not None:
        entities += [
            (f"tool/off/{arm}", [rr.Scalars(MM_PER_METRE * told.tip_off_m)]),
            (f"tool/deviation/{arm}", [rr.Scalars(MM_PER_METRE * told.tip_deviation_m)]),
        ]
    if not changed:
        return entities
    level = rr.TextLogLevel.WARN if told.status is ToolStatus.LOST else rr.TextLogLevel.INFO
    words = said(f"tool_tracker/{told.arm}", tool_sentence(told), level)
    return [*entities, lane(f"tool_{arm}", LANES[told.status]), words]


def tool_sentence(told: ToolCorrection) -> str:
    """How it stands with the instrument, in one sentence."""
    if told.T_correction is None:
        return f"the tool of {told.arm} is not followed in the images: {told.reason}"
    off = f"{MM_PER_METRE * told.tip_off_m:.1f} mm and {np.degrees(told.turned_rad):.1f} degrees"
    sure = f"(deviation {MM_PER_METRE * told.tip_deviation_m:.1f} mm)"
    return f"the tool of {told.arm} is {off} from where registration and joints have it {sure}"


def _outline(px: Float64[np.ndarray, "n 2"], rgb: tuple[int, int, int]) -> rr.Points2D:
    return rr.Points2D(px, colors=[rgb], radii=[RADIUS_PX], draw_order=30.0)
