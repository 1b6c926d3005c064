"""What is known of the thread as Rerun shows it.

    world                       the rectified left camera's axes: x right, y down, z away
      left, right               the two pinhole cameras, with `image` and `mask` below
      observations              `points`, and the `matched` pixels behind them
      thread                    `curve`, `ends`, `control_points`, `regions`, and the `posterior` about it
    confidence, report          a chart along the thread, and what is to be said in words

How far it can be trusted is in quality_mapping. Each function turns one message into entity paths with what to log
there. A message always gives the same paths, so that a failed frame empties what the frame before it showed.
"""

import pathlib
from collections.abc import Iterable
from dataclasses import replace

import cv2
import numpy as np
import rerun as rr
from jaxtyping import Float64, UInt8

from agents.viewer import colours
from agents.viewer.candidate_mapping import candidate_entities, occluder_entities, score_entities
from agents.viewer.cross_sections import cross_sections
from agents.viewer.entity import HALF_PX, LAST_FRAME, Entity
from agents.viewer.image_pane import decoded_mask
from agents.viewer.polyline import Polyline, thread_polyline
from agents.viewer.quality_mapping import (
    ALONG,
    bars_along,
    centreline_entities,
    curve_looks,
    posterior_entities,
    residual_entities,
)
from agents.viewer.recording_layout import distance_of, layout
from agents.viewer.report import markdown, missed
from schemas.messages import (
    FrameStamp,
    RectifiedStereo,
    ReliabilityRegions,
    RightEye,
    ThreadObservations,
    ThreadReconstruction,
)
from shared.camera import backproject, camera_matrix, depth_of_disparity, project
from shared.right_eye import IN_LINE, Affine, from_in_line, moved

APPLICATION = "suturegrasp"
JPEG_QUALITY = 95
CURVE_POINTS = 200
CURVE_RADIUS = 1.5
"""In pixels of the screen; a thicker curve would hide the tube about it, and the whiskers beside it."""

BACKDROP = 1.3
"""How far behind the thread the left image stands in space, as a multiple of the thread's depth."""

FAINT = 70
"""Opacity, of 255, of what stands behind the thread."""


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
    """The outlines of both masks, given their coverage: they cost a viewer little, and hide nothing of the thread.

    Args:
        to_shown: from pixels of the right image in line to those of the one that is shown.
    """
    return [("world/left/mask", [_outline(left)]), ("world/right/mask", [_outline(right, to_shown)])]


def observation_entities(
    observations: ThreadObservations, most_matched: int | None = None, to_shown: Affine = IN_LINE
) -> list[Entity]:
    """The observations with their bounds in the left image, and the matched pixels in space, or that many of them.

    Args:
        to_shown: from pixels of the right image in line to those of the one that is shown.
    """
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
    # a negative radius is one of the screen, the same at any zoom
    return [
        ("world/left/bounds", [bounds]),
        ("world/observations/points", [rr.Points3D(points, colors=[colours.OBSERVATION], radii=[-2.0])]),
        ("world/observations/matched", [rr.Points3D(matched_points, colors=[(*colours.KEPT, FAINT)], radii=[-1.0])]),
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


def log(recording: rr.RecordingStream, stamp: FrameStamp, entities: Iterable[Entity]) -> None:
    """Log entities at the capture time of their frame."""
    recording.set_time("capture_time", timestamp=np.datetime64(stamp.capture_left_ns, "ns"))
    recording.set_time("frame", sequence=min(stamp.sequence, LAST_FRAME))
    for path, archetypes in entities:
        for archetype in archetypes:
            recording.log(path, archetype)


def write_rrd(
    path: pathlib.Path,
    left_bgr: UInt8[np.ndarray, "h w *c"],
    right_bgr: UInt8[np.ndarray, "h w *c"],
    observations: ThreadObservations,
    reconstruction: ThreadReconstruction,
) -> None:
    """Write one reconstruction as a Rerun file with its layout inside.

    Raises:
        OSError: where the file cannot be written; Rerun's own file sink would wait for ever on a full disk.
    """
    recording = rr.RecordingStream(APPLICATION)
    stream = recording.binary_stream()
    recording.send_blueprint(layout(reconstruction), make_active=False, make_default=True)
    entities = [
        *camera_entities(observations.camera, BACKDROP * distance_of(reconstruction)),
        *image_entities(left_bgr, right_bgr),
        *mask_entities(decoded_mask(observations.mask_left), decoded_mask(observations.mask_right)),
        *observation_entities(observations),
        *candidate_entities(observations),
        *occluder_entities(observations),
        *score_entities(observations),
        *curve_looks(),
        *reconstruction_entities(reconstruction, observations),
        *report_entities(observations, reconstruction),
    ]
    log(recording, reconstruction.stamp, entities)
    path.write_bytes(stream.read() or b"")


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


def _ends(thread: Polyline | None) -> rr.Points3D:
    if thread is None:
        return rr.Points3D([])
    return rr.Points3D(thread.points_camera[[0, -1]], labels=["s=0", "s=1"], colors=[colours.TEXT], radii=[-4.0])


def _region_rgba(regions: ReliabilityRegions) -> list[tuple[int, int, int, int]]:
    return [(*colours.OUTSIDE, 255) if out else (*colours.MUTED, FAINT) for out in missed(regions)]


def _confidence_bars(thread: Polyline | None) -> rr.BarChart:
    if thread is None:
        return rr.BarChart(np.zeros(1), abscissa=np.zeros(1))
    confidence = np.nan_to_num(np.interp(ALONG, thread.along, thread.confidence))
    return bars_along(confidence, colours.GOOD)
