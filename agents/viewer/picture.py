"""One reconstruction as one image: both eyes with the thread over them, its depth, and what is to be said."""

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from agents.viewer import colours
from agents.viewer.cross_sections import cross_sections
from agents.viewer.image_pane import (
    Pane,
    decoded_mask,
    draw_candidates,
    draw_centrelines,
    draw_elsewhere,
    draw_label,
    draw_matches,
    draw_observations,
    draw_occluders,
    draw_residuals,
    draw_thread,
    image_pane,
    label_ends,
    tint_mask,
)
from agents.viewer.lettering import LINE_HEIGHT_PX, draw_text, text_width, wrapped
from agents.viewer.polyline import Polyline, along_at, thread_polyline
from agents.viewer.report import facts, finding_text, findings, missed, reasons, unit_text
from agents.viewer.residuals import EXAGGERATION, Residuals, both_residuals
from agents.viewer.strip import DepthBand, DepthMarks, depth_strip, deviation_strip, residual_strip
from schemas.messages import Image, Occluder, Severity, Status, ThreadObservations, ThreadReconstruction
from shared.camera import project

WIDTH_PX = 1600
MARGIN_PX = 12
TALLEST_PANE_PX = 900
NORMAL_95 = 1.96
"""Standard deviations about the mean of a normal distribution that hold 95 % of it."""

Canvas = UInt8[np.ndarray, "h w 3"]
Entry = tuple[str, tuple[int, int, int]]


def draw_picture(
    left_bgr: UInt8[np.ndarray, "h w *c"],
    right_bgr: UInt8[np.ndarray, "h w *c"],
    observations: ThreadObservations,
    reconstruction: ThreadReconstruction,
) -> UInt8[np.ndarray, "H W 3"]:
    """What a person sees of one reconstruction, as a BGR image 1600 pixels wide.

    From the top: status and facts, both rectified images with masks, observations and projected thread, what the
    marks mean, the depth along the thread, its predicted deviation and its residuals where there are such, and the
    judgements that lessen trust. A failed reconstruction shows its reason, the matched pixels and the centrelines
    instead of the thread.
    """
    # absurd but finite numbers overflow on their way out of the picture, and may
    with np.errstate(all="ignore"):
        return np.vstack(_blocks(left_bgr, right_bgr, observations, reconstruction))


def _blocks(
    left_bgr: UInt8[np.ndarray, "h w *c"],
    right_bgr: UInt8[np.ndarray, "h w *c"],
    observations: ThreadObservations,
    reconstruction: ThreadReconstruction,
) -> list[Canvas]:
    thread = thread_polyline(reconstruction)
    found = None if thread is None else both_residuals(observations, thread)
    unit = unit_text(reconstruction.camera.metres_per_unit)
    marks, band = _depth_marks(observations, reconstruction, thread), _depth_band(reconstruction, thread)
    elsewhere = np.zeros((0, 2)) if reconstruction.course is None else reconstruction.course.elsewhere
    blocks = [
        _header(observations, reconstruction, thread),
        _both_eyes(left_bgr, right_bgr, observations, thread, found, elsewhere),
        _legend(observations, reconstruction, thread),
        depth_strip(WIDTH_PX, thread, marks, band, unit),
    ]
    if thread is not None and found is not None:
        sections = cross_sections(reconstruction, thread)
        blocks += [deviation_strip(WIDTH_PX, thread, sections, unit), residual_strip(WIDTH_PX, thread, *found)]
    return [*blocks, _findings(observations)]


def _blank(height: int) -> Canvas:
    return np.full((height, WIDTH_PX, 3), colours.BACKGROUND[::-1], dtype=np.uint8)


def _header(observations: ThreadObservations, reconstruction: ThreadReconstruction, thread: Polyline | None) -> Canvas:
    succeeded = reconstruction.status is Status.OK
    chip = "OK" if succeeded else "FAILED"
    indent = MARGIN_PX + text_width(chip) + 28
    lines = wrapped("  |  ".join(facts(observations, reconstruction, thread)), WIDTH_PX - indent - MARGIN_PX)
    why = [line for text in reasons(observations, reconstruction) for line in wrapped(text, WIDTH_PX - indent)]
    canvas = _blank((len(lines) + len(why)) * LINE_HEIGHT_PX + 16)
    ground = (colours.GOOD if succeeded else colours.BAD)[::-1]
    cv2.rectangle(canvas, (MARGIN_PX, 6), (indent - 12, 6 + LINE_HEIGHT_PX), ground, cv2.FILLED)
    draw_text(canvas, chip, (MARGIN_PX + 8, 22), colours.TEXT)
    for row, (line, rgb) in enumerate([(x, colours.WARNING) for x in why] + [(x, colours.TEXT) for x in lines]):
        draw_text(canvas, line, (indent, 22 + row * LINE_HEIGHT_PX), rgb)
    return canvas


def _both_eyes(
    left_bgr: UInt8[np.ndarray, "h w *c"],
    right_bgr: UInt8[np.ndarray, "h w *c"],
    observations: ThreadObservations,
    thread: Polyline | None,
    found: tuple[Residuals, Residuals] | None,
    elsewhere: Float64[np.ndarray, "k 2"],
) -> Canvas:
    """Both images with what was found; `elsewhere` as `ThreadCourse` has it."""
    width = (WIDTH_PX - MARGIN_PX) // 2
    left, right = (image_pane(image, width, TALLEST_PANE_PX) for image in (left_bgr, right_bgr))
    for pane, mask in ((left, observations.mask_left), (right, observations.mask_right)):
        _tint(pane, mask)
    if observations.occluders is not None:
        for pane, image in ((left, observations.occluders.left), (right, observations.occluders.right)):
            kinds = decoded_mask(image)
            if kinds is not None:
                draw_occluders(pane, kinds)
    if thread is None or found is None:
        draw_centrelines(left, observations.centrelines_left)
        draw_centrelines(right, observations.centrelines_right)
        matched = observations.matched_px
        draw_matches(left, matched[:, :2], observations.inlier)
        draw_matches(right, matched[:, :2] - matched[:, 2:] * [1.0, 0.0], observations.inlier)
    else:
        projected = project(observations.camera, thread.points_camera)
        for pane, thread_px, of_side in zip((left, right), projected, found, strict=True):
            draw_residuals(pane, of_side)
            draw_thread(pane, thread, thread_px)
            draw_elsewhere(pane, np.stack([np.interp(elsewhere, thread.along, uv) for uv in thread_px.T], axis=-1))
    draw_observations(left, project(observations.camera, observations.points_camera)[0], observations.half_size_px)
    others = observations.candidates[1:]
    labels = [f"{number}: {other.score:.2f}" for number, other in enumerate(others, 2)]
    draw_candidates(left, [other.left_px for other in others], labels)
    draw_candidates(right, [other.right_px for other in others], [])
    _label_panes(left, right, observations, thread)
    return _side_by_side(left.canvas, right.canvas)


def _tint(pane: Pane, mask: Image) -> None:
    coverage = decoded_mask(mask)
    if coverage is not None:
        tint_mask(pane, coverage)


def _label_panes(left: Pane, right: Pane, observations: ThreadObservations, thread: Polyline | None) -> None:
    ends = (None, None) if thread is None else project(observations.camera, thread.points_camera)
    masks = observations.mask_left, observations.mask_right
    for pane, name, thread_px, mask in zip((left, right), ("left", "right"), ends, masks, strict=True):
        text = f"{name}, rectified" if decoded_mask(mask) is not None else f"{name}, rectified; its mask is unreadable"
        box = (0, 0, text_width(text) + 8, 20)
        if thread_px is not None:
            label_ends(pane, thread_px, [box])
        draw_label(pane, text, box)


def _side_by_side(left: Canvas, right: Canvas) -> Canvas:
    """Both canvases, each in the middle of its half."""
    canvas = _blank(max(len(left), len(right)))
    half = (WIDTH_PX - MARGIN_PX) // 2
    for image, start in ((left, 0), (right, WIDTH_PX - half)):
        x = start + (half - image.shape[1]) // 2
        canvas[: image.shape[0], x : x + image.shape[1]] = image
    return canvas


def _legend(observations: ThreadObservations, reconstruction: ThreadReconstruction, thread: Polyline | None) -> Canvas:
    entries: list[Entry] = [("segmented as thread", colours.MASK)]
    if len(observations.points_camera):
        entries.append(("observations, with their bounds", colours.OBSERVATION))
    elif len(reconstruction.regions.s):
        entries.append(("matched places, with their bounds", colours.OBSERVATION))
    if missed(reconstruction.regions).any():
        entries.append(("region that the curve had to miss", colours.OUTSIDE))
    if thread is not None and thread.unseen.any():
        entries.append(("grey: seen in no image", colours.UNKNOWN))
    if thread is not None and reconstruction.course is not None and len(reconstruction.course.elsewhere):
        entries.append(("may lead so instead", colours.WARNING))
    if thread is not None and len(reconstruction.posterior_s):
        entries.append(("95 % of the predicted depth", colours.BAND))
    if len(observations.centrelines_left.piece) + len(observations.centrelines_right.piece):
        compared = f"residuals, {EXAGGERATION} times as long; red beyond the thread's edge", colours.WARNING
        entries.append(("middle of the thread", colours.CENTRELINE) if thread is None else compared)
    if len(observations.candidates) > 1:
        entries.append(("other threads", colours.candidate_rgb(1)))
    if observations.occluders is not None and thread is not None and len(thread.points_camera):
        entries.append(("instrument", colours.OCCLUDERS[Occluder.TOOL]))
    if thread is None and len(observations.matched_px):
        entries += [("matched pixels, kept", colours.KEPT), ("matched pixels, rejected", colours.REJECTED)]
    canvas, x = _blank(LINE_HEIGHT_PX + 14), MARGIN_PX
    for text, rgb in entries:
        cv2.rectangle(canvas, (x, 13), (x + 12, 25), rgb[::-1], cv2.FILLED)
        draw_text(canvas, text, (x + 20, 24), colours.TEXT)
        x += text_width(text) + 52
    return canvas


def _depth_marks(
    observations: ThreadObservations, reconstruction: ThreadReconstruction, thread: Polyline | None
) -> DepthMarks:
    """The reliability regions along the thread, or the bare observations along their own polygon."""
    regions = reconstruction.regions
    if thread is not None:
        along = along_at(thread, regions.s) * thread.length
        return DepthMarks(along, regions.centre_camera[:, 2], regions.bound_depth, missed(regions))
    points = observations.points_camera
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    along = np.concatenate((np.zeros(min(1, len(points))), np.cumsum(steps)))
    return DepthMarks(along, points[:, 2], np.zeros(len(points)), np.zeros(len(points), bool))


def _depth_band(reconstruction: ThreadReconstruction, thread: Polyline | None) -> DepthBand:
    if thread is None:
        return DepthBand(np.zeros(0), np.zeros(0), np.zeros(0))
    s = reconstruction.posterior_s
    half = NORMAL_95 * np.sqrt(np.maximum(reconstruction.posterior_covariance[:, 2, 2], 0.0))
    depth = np.interp(s, thread.parameter, thread.points_camera[:, 2])
    return DepthBand(along_at(thread, s) * thread.length, depth - half, depth + half)


def _findings(observations: ThreadObservations) -> Canvas:
    lines = [
        (line, colours.BAD_TEXT if finding.severity is Severity.FAULT else colours.WARNING)
        for finding in findings(observations)
        for line in wrapped(finding_text(finding), WIDTH_PX - 2 * MARGIN_PX)
    ]
    canvas = _blank(len(lines) * LINE_HEIGHT_PX + 8)
    for row, (line, rgb) in enumerate(lines):
        draw_text(canvas, line, (MARGIN_PX, 16 + row * LINE_HEIGHT_PX), rgb)
    return canvas
