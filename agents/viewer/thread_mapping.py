"""What is known of the thread as Rerun shows it, and how far it can be trusted.

    world                       the rectified left camera's axes: x right, y down, z away
      left, right               the two pinhole cameras, with `image` and `mask` below
      observations              `points`, and the `matched` pixels behind them
      thread                    `curve`, `ends`, `control_points`, `regions`; `strands`: the curves of all threads that
                                look like it, where tissue may part one thread
        posterior               the tube that holds the thread with 95 % probability, across it; at true scale
    world/{side}/centrelines    the middle of the thread as that image shows it, by piece
    world/{side}/residuals_x20  whiskers from the projected curve toward the centrelines' points, twenty times as long
                                as the residuals, and at most 40 px
    confidence, report          a chart along the thread, and what is to be said in words
    deviation/along_s           a chart along the thread: standard deviation across it, in the worst direction
    deviation/…                 `mean` and `worst` of the chart
    residual_px/{side}          `median` and `percentile_95` of the points that the curve explains
    share/…                     `unseen` of the thread in any image; `left_over_{side}` of the points of its centrelines

Curve, tube and whiskers have the colours of confidence: whiskers are green where the curve runs through the middle of
the thread's image, and red where it runs along its edge or farther out. Thread that not both images show is grey.

Each function turns one message into entity paths with what to log there. A message always gives the same paths, so that
a failed frame empties what the frame before it showed. `to_shown` leads from pixels of the right image in line to those
of the one that is shown.
"""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import rerun as rr
from jaxtyping import Float64, UInt8

from agents.viewer import colours
from agents.viewer.entity import HALF_PX, SIDES, Entity
from agents.viewer.polyline import (
    CORNERS,
    EXAGGERATION,
    CrossSections,
    Polyline,
    Residuals,
    both_residuals,
    closeness,
    cross_sections,
    summary,
    thread_polyline,
    tube_triangles,
    whiskers,
)
from agents.viewer.report import markdown, missed
from schemas.messages import (
    Centrelines,
    RectifiedStereo,
    ReliabilityRegions,
    RightEye,
    ThreadObservations,
    ThreadReconstruction,
)
from shared.camera import backproject, camera_matrix, depth_of_disparity, project
from shared.right_eye import IN_LINE, Affine, from_in_line, moved

BARS = 100
ALONG = np.linspace(0.0, 1.0, BARS)
"""Shares of the thread's length at which there are bars."""
# made once: Rerun takes longer to find out of what kind the numbers of a chart are than it does for all else in it
_PLACES: Any = rr.components.TensorDataBatch(ALONG).as_arrow_array()
_WIDTHS: Any = rr.components.LengthBatch(np.full(BARS, 1 / BARS)).as_arrow_array()
_KIND = [field.name for field in _PLACES.type.field("buffer").type].index("F64")


def bars_along(heights: Float64[np.ndarray, "n"], rgb: tuple[int, int, int]) -> rr.BarChart:
    """Bars at `ALONG` of these heights."""
    return rr.BarChart(_like_places(heights), abscissa=_PLACES, color=rgb, widths=_WIDTHS)


def _like_places(heights: Float64[np.ndarray, "n"]) -> Any:
    """As many numbers, as Rerun holds those of the places: a structure of a shape, names, and numbers of some kind."""
    kinds = _PLACES.field("buffer")
    places = kinds.field(_KIND)
    numbers = rr.components.ScalarBatch(heights).as_arrow_array()
    children = [kinds.field(kind) for kind in range(kinds.type.num_fields)]
    children[_KIND] = places.from_buffers(places.type, 1, places.buffers()[:2], children=[numbers])
    # of what says which kind each element is, and where
    about = [None, *kinds.buffers()[1:3]]
    buffer = kinds.from_buffers(kinds.type, 1, about, children=children)
    return _PLACES.from_arrays([_PLACES.field("shape"), _PLACES.field("names"), buffer], fields=list(_PLACES.type))


WHISKERS_ABOUT = 300
"""Whiskers in each image; neighbouring points of a centreline err alike."""

TUBE_OPACITY = 120


def curve_looks() -> list[Entity]:
    """The colours of the curves over time, as in the picture: one for each image, the median thicker."""
    residuals = [
        (f"residual_px/{side}/{what}", _looks(rgb, width, f"{side}, {called}"))
        for side, rgb in zip(SIDES, (colours.LEFT_EYE, colours.RIGHT_EYE), strict=True)
        for what, called, width in (("median", "median", 2.0), ("percentile_95", "95 %", 1.0))
    ]
    shares = [
        (f"share/left_over_{side}", _looks(rgb, 1.0, f"left over, {side}"))
        for side, rgb in zip(SIDES, (colours.LEFT_EYE, colours.RIGHT_EYE), strict=True)
    ]
    return [
        *residuals,
        *shares,
        ("share/unseen", _looks(colours.UNKNOWN, 2.0, "unseen")),
        ("deviation/mean", _looks(colours.KEPT, 2.0, "mean")),
        ("deviation/worst", _looks(colours.WARNING, 1.0, "worst")),
    ]


def _looks(rgb: tuple[int, int, int], width: float, name: str) -> list[rr.AsComponents]:
    return [rr.SeriesLines(colors=[rgb], widths=[width], names=[name])]


def centreline_entities(observations: ThreadObservations, to_shown: Affine = IN_LINE) -> list[Entity]:
    """The pieces of both centrelines as thin lines in the images; the right one's as it is shown."""
    return [
        ("world/left/centrelines", [_pieces(observations.centrelines_left)]),
        ("world/right/centrelines", [_pieces(observations.centrelines_right, to_shown)]),
    ]


def posterior_entities(sections: CrossSections) -> list[Entity]:
    """The tube, its deviation along the thread, and the mean and the worst of it."""
    mean, worst = (float(pick(sections.deviation)) if len(sections.along) else None for pick in (np.mean, np.max))
    return [
        ("world/thread/posterior", [_tube(sections)]),
        ("deviation/along_s", [_bars(sections)]),
        ("deviation/mean", [_scalar(mean)]),
        ("deviation/worst", [_scalar(worst)]),
    ]


def residual_entities(
    observations: ThreadObservations | None, thread: Polyline | None, to_shown: Affine = IN_LINE
) -> list[Entity]:
    """The residuals in both images, in pixels and in numbers; empty where there is no thread, or nothing to compare."""
    share = None if thread is None else float(thread.unseen.mean())
    entities: list[Entity] = [("share/unseen", [_scalar(share)])]
    found = (None, None) if observations is None or thread is None else both_residuals(observations, thread)
    for side, of_side, by in zip(SIDES, found, (IN_LINE, to_shown), strict=True):
        numbers = None if of_side is None else summary(of_side)
        entities += [
            (f"world/{side}/residuals_x{EXAGGERATION}", [_whiskers(of_side, by)]),
            (f"residual_px/{side}/median", [_scalar(numbers and numbers.median_px)]),
            (f"residual_px/{side}/percentile_95", [_scalar(numbers and numbers.percentile_95_px)]),
            (f"share/left_over_{side}", [_scalar(numbers and numbers.left_over)]),
        ]
    return entities


def _scalar(value: float | None) -> rr.Scalars:
    """A number, or that there is none, so that a curve ends instead of going on as before."""
    return rr.Scalars(np.nan if value is None else value)


def _pieces(line: Centrelines, to_shown: Affine = IN_LINE) -> rr.LineStrips2D:
    cuts = np.flatnonzero(np.diff(line.piece)) + 1
    points = moved(line.point_px, to_shown) + HALF_PX
    strips = np.split(points, cuts) if len(line.piece) else []
    return rr.LineStrips2D(strips, colors=[colours.CENTRELINE], radii=[-0.6])


def _whiskers(found: Residuals | None, to_shown: Affine) -> rr.LineStrips2D:
    if found is None or not len(found.along):
        return rr.LineStrips2D([])
    some = found.every(1 + len(found.along) // WHISKERS_ABOUT)
    lines = (moved(whiskers(some), to_shown) + HALF_PX).astype(np.float32)
    return rr.LineStrips2D(lines, colors=colours.confidence_rgb(closeness(some)), radii=[-0.8])


def _tube(sections: CrossSections) -> rr.Mesh3D | rr.Clear:
    count = len(sections.along)
    if count < 2:
        return rr.Clear(recursive=False)
    rgb = colours.thread_rgb(sections.confidence, sections.unseen)
    return rr.Mesh3D(
        vertex_positions=sections.rings_camera.reshape(-1, 3),
        triangle_indices=tube_triangles(count),
        vertex_colors=np.repeat(rgb, CORNERS, axis=0),
        albedo_factor=(255, 255, 255, TUBE_OPACITY),
    )


def _bars(sections: CrossSections) -> rr.BarChart:
    if not len(sections.along):
        return rr.BarChart(np.zeros(1), abscissa=np.zeros(1))
    return bars_along(np.interp(ALONG, sections.along, sections.deviation), colours.BAND)


APPLICATION = "suturegrasp"
JPEG_QUALITY = 95
CURVE_POINTS = 200
CURVE_RADIUS = 1.5
"""In pixels of the screen; a thicker curve would hide the tube about it, and the whiskers beside it."""

BACKDROP = 1.3
"""How far behind the thread the left image stands in space, as a multiple of the thread's depth."""


def camera_entities(camera: RectifiedStereo, distance: float, right_eye: RightEye | None = None) -> list[Entity]:
    """Both cameras; the left one's image plane is at that distance, as a backdrop, the right one's close by.

    Args:
        right_eye: by how much the right image that is shown is out of line.
    """
    eye = right_eye or RightEye(0.0, 0.0, 1.0)
    by = from_in_line(eye, camera)
    turned = by[:, :2] / eye.magnified
    centre = moved(np.array([camera.cx_px, camera.cy_px]), by)
    own = replace(
        camera,
        fx_px=camera.fx_px * eye.magnified,
        fy_px=camera.fy_px * eye.magnified,
        cx_px=float(centre[0]),
        cy_px=float(centre[1]),
    )
    turn = np.eye(3)
    turn[:2, :2] = turned.T
    right = rr.Transform3D(translation=[camera.baseline, 0.0, 0.0], mat3x3=turn)
    return [
        ("world", [rr.ViewCoordinates.RDF]),
        ("world/left", [_pinhole(camera, distance)]),
        ("world/right", [right, _pinhole(own, 0.2 * distance)]),
    ]


def image_entities(left_bgr: UInt8[np.ndarray, "h w *c"], right_bgr: UInt8[np.ndarray, "h w *c"]) -> list[Entity]:
    """Both rectified images, compressed."""
    return [("world/left/image", [_jpeg(left_bgr)]), ("world/right/image", [_jpeg(right_bgr)])]


def mask_entities(
    left: UInt8[np.ndarray, "h w"] | None, right: UInt8[np.ndarray, "h w"] | None, to_shown: Affine = IN_LINE
) -> list[Entity]:
    """The outlines of both masks, given their coverage: they cost a viewer little, and hide nothing of the thread."""
    return [("world/left/mask", [_outline(left)]), ("world/right/mask", [_outline(right, to_shown)])]


def observation_entities(
    observations: ThreadObservations, most_matched: int | None = None, to_shown: Affine = IN_LINE
) -> list[Entity]:
    """The observations with their bounds in the left image, and the matched pixels in space, or that many of them."""
    points, camera = observations.points_camera, observations.camera
    observed_px, _ = project(camera, points)
    matched = observations.matched_px[observations.inlier & (observations.matched_px[:, 2] > 0)]
    if most_matched is not None:
        matched = matched[:: 1 + len(matched) // most_matched]
    matched_points = backproject(camera, matched[:, :2], depth_of_disparity(camera, matched[:, 2]))
    bounds = rr.Boxes2D(
        centers=observed_px + HALF_PX,
        half_sizes=observations.half_size_px,
        colors=[(*colours.OBSERVATION, 150)],
        radii=[-0.5],
    )
    faint = (*colours.KEPT, colours.FAINT)
    # a negative radius is one of the screen, the same at any zoom
    return [
        ("world/left/bounds", [bounds]),
        ("world/observations/points", [rr.Points3D(points, colors=[colours.OBSERVATION], radii=[-2.0])]),
        ("world/observations/matched", [rr.Points3D(matched_points, colors=[faint], radii=[-1.0])]),
        *centreline_entities(observations, to_shown),
    ]


def reconstruction_entities(
    reconstruction: ThreadReconstruction, observations: ThreadObservations | None, to_shown: Affine = IN_LINE
) -> list[Entity]:
    """The thread by confidence, its ends, control points and regions, and how far it can be trusted.

    `observations` are those of the same frame, as far as they are known; without them there are no residuals.
    """
    thread = thread_polyline(reconstruction, CURVE_POINTS)
    control, regions = reconstruction.control_points_camera, reconstruction.regions
    boxes = rr.LineStrips3D(region_edges(reconstruction.camera, regions), colors=_region_rgba(regions), radii=[-0.5])
    return [
        ("world/thread/curve", [_curve(thread)]),
        ("world/thread/ends", [_ends(thread)]),
        ("world/thread/other_course", [_other_course(reconstruction, thread)]),
        ("world/thread/strands", [_strands(reconstruction)]),
        ("world/thread/control_points", [rr.Points3D(control, colors=[(*colours.MASK, 200)], radii=[-2.0])]),
        ("world/thread/regions", [boxes]),
        ("confidence", [_confidence_bars(thread)]),
        *posterior_entities(cross_sections(reconstruction, thread)),
        *residual_entities(observations, thread, to_shown),
    ]


def report_entities(observations: ThreadObservations, reconstruction: ThreadReconstruction) -> list[Entity]:
    """Status, facts and judgements as a document."""
    text = markdown(observations, reconstruction, thread_polyline(reconstruction))
    return [("report", [rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)])]


def region_edges(camera: RectifiedStereo, regions: ReliabilityRegions) -> Float64[np.ndarray, "n 16 3"]:
    """Each reliability region's twelve edges as one line; a region is a block of pixels between two depths."""
    bits = (EDGE_TOUR[:, None] >> np.arange(3) & 1) * 2 - 1
    offset_px = bits[None, :, :2] * regions.bound_px[:, None]
    depth = regions.centre_camera[:, 2:] + bits[None, :, 2] * regions.bound_depth[:, None]
    # a region may reach behind the camera, where nothing can be drawn
    depth = np.maximum(depth, 1e-3 * np.abs(regions.centre_camera[:, 2:]))
    centre_px, _ = project(camera, regions.centre_camera)
    corner_px = centre_px[:, None] + offset_px
    return backproject(camera, corner_px.reshape(-1, 2), depth.ravel()).reshape(-1, len(EDGE_TOUR), 3)


EDGE_TOUR = np.array([0, 1, 3, 2, 0, 4, 5, 7, 6, 4, 5, 1, 3, 7, 6, 2])
"""A walk over all edges of a cube; the bits of a corner's number say which side it is on along u, v and depth."""


def _pinhole(camera: RectifiedStereo, distance: float) -> rr.Pinhole:
    K = camera_matrix(camera)
    K[:2, 2] += HALF_PX
    return rr.Pinhole(
        image_from_camera=K,
        resolution=[camera.image_width, camera.image_height],
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=distance,
        color=colours.GRID,
        line_width=-0.5,
    )


def _jpeg(image: UInt8[np.ndarray, "h w *c"]) -> rr.EncodedImage:
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
    return rr.EncodedImage(contents=data, media_type="image/jpeg")


def _outline(coverage: UInt8[np.ndarray, "h w"] | None, to_shown: Affine = IN_LINE) -> rr.LineStrips2D:
    if coverage is None:
        return rr.LineStrips2D([])
    covered = cv2.threshold(coverage, 127, 1, cv2.THRESH_BINARY)[1]
    lines, _ = cv2.findContours(covered, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
    closed = [moved(np.concatenate((line, line[:1])).reshape(-1, 2), to_shown) + HALF_PX for line in lines]
    return rr.LineStrips2D(closed, colors=[colours.MASK], radii=[-0.6])


def _curve(thread: Polyline | None) -> rr.LineStrips3D:
    if thread is None:
        return rr.LineStrips3D([])
    segments = np.stack((thread.points_camera[:-1], thread.points_camera[1:]), axis=1)
    confidence = 0.5 * (thread.confidence[:-1] + thread.confidence[1:])
    rgb = colours.thread_rgb(confidence, thread.unseen[:-1] & thread.unseen[1:])
    return rr.LineStrips3D(segments, colors=rgb, radii=[-CURVE_RADIUS])


def _other_course(reconstruction: ThreadReconstruction, thread: Polyline | None) -> rr.LineStrips3D:
    """Where the next likeliest course leads otherwise, if the likeliest one is undecided."""
    course = reconstruction.course
    if thread is None or course is None or not len(course.elsewhere):
        return rr.LineStrips3D([])
    ends = np.stack([np.interp(course.elsewhere, thread.along, axis) for axis in thread.points_camera.T], axis=-1)
    labels = [f"may lead from s={start:.2f} to s={end:.2f}" for start, end in course.elsewhere]
    return rr.LineStrips3D(ends, colors=[colours.WARNING], radii=[-CURVE_RADIUS], labels=labels)


def _strands(reconstruction: ThreadReconstruction) -> rr.LineStrips3D:
    lines = [thread_polyline(strand, CURVE_POINTS) for strand in reconstruction.apart]
    points = [line.points_camera for line in lines if line is not None]
    return rr.LineStrips3D(points, colors=[colours.CENTRELINE], radii=[-0.6])


def _ends(thread: Polyline | None) -> rr.Points3D:
    if thread is None:
        return rr.Points3D([])
    return rr.Points3D(thread.points_camera[[0, -1]], labels=["s=0", "s=1"], colors=[colours.TEXT], radii=[-4.0])


def _region_rgba(regions: ReliabilityRegions) -> list[tuple[int, int, int, int]]:
    return [(*colours.OUTSIDE, 255) if out else (*colours.MUTED, colours.FAINT) for out in missed(regions)]


def _confidence_bars(thread: Polyline | None) -> rr.BarChart:
    if thread is None:
        return rr.BarChart(np.zeros(1), abscissa=np.zeros(1))
    confidence = np.nan_to_num(np.interp(ALONG, thread.along, thread.confidence))
    return bars_along(confidence, colours.GOOD)
