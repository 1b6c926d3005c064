"""One reconstruction as one image: both eyes with the thread over them, plots along it, and what is to be said."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from agents.viewer import colours
from agents.viewer.image_pane import (
    FAR_PX,
    LINE_HEIGHT_PX,
    SHIFT,
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
    draw_text,
    draw_thread,
    image_pane,
    label_ends,
    line_thickness,
    text_width,
    tint_mask,
    wrapped,
)
from agents.viewer.polyline import (
    EXAGGERATION,
    CrossSections,
    Polyline,
    Residuals,
    ResidualSummary,
    along_at,
    both_residuals,
    cross_sections,
    summary,
    thread_polyline,
)
from agents.viewer.report import facts, finding_text, findings, missed, reasons, unit_text
from schemas.messages import Image, Occluder, Severity, Status, ThreadObservations, ThreadReconstruction
from shared.camera import project

MARGIN_LEFT, MARGIN_RIGHT, MARGIN_TOP = 80, 150, 40
BOTTOM_BARE, BOTTOM_TITLED = 24, 50
SMALL = 0.45


@dataclass(frozen=True)
class Axes:
    """The part of a canvas that a plot fills, and the numbers at its edges."""

    plot: UInt8[np.ndarray, "h w 3"]
    x_range: tuple[float, float]
    y_range: tuple[float, float]

    def at(self, x: Float64[np.ndarray, "n"], y: Float64[np.ndarray, "n"]) -> np.ndarray:
        """Where places of the plot lie in it, in OpenCV's fixed point; y grows upwards."""
        height, width = self.plot.shape[:2]
        u = (x - self.x_range[0]) / (self.x_range[1] - self.x_range[0]) * (width - 1)
        v = (self.y_range[1] - y) / (self.y_range[1] - self.y_range[0]) * (height - 1)
        at = np.nan_to_num(np.column_stack((u, v)))
        return np.rint(np.clip(at, -FAR_PX, FAR_PX) * 2**SHIFT).astype(np.int32)


def strip(
    width: int, height: int, title: str, x_range: tuple[float, float], y_range: tuple[float, float], below: str = ""
) -> tuple[UInt8[np.ndarray, "h w 3"], Axes]:
    """A canvas with an empty plot that has ticks, its title above it, and what x means below the last one of them."""
    bottom = BOTTOM_TITLED if below else BOTTOM_BARE
    canvas = np.full((MARGIN_TOP + height + bottom, width, 3), colours.BACKGROUND[::-1], dtype=np.uint8)
    plot = canvas[MARGIN_TOP:-bottom, MARGIN_LEFT:-MARGIN_RIGHT]
    plot[:] = colours.PANEL[::-1]
    axes = Axes(plot, x_range, y_range)
    _draw_grid(canvas, axes)
    draw_text(canvas, title, (MARGIN_LEFT, MARGIN_TOP - 12), colours.TEXT)
    if below:
        at = (MARGIN_LEFT + (plot.shape[1] - text_width(below)) // 2, MARGIN_TOP + height + 40)
        draw_text(canvas, below, at, colours.TEXT)
    return canvas, axes


def shade_unseen(axes: Axes, thread: Polyline) -> None:
    """Mark the stretches that not both images show."""
    width = axes.plot.shape[1]
    columns = np.interp(np.arange(width), thread.along * (width - 1), thread.unseen.astype(float)) > 0.5
    axes.plot[:, columns] = (0.75 * axes.plot[:, columns] + 0.25 * np.array(colours.MUTED[::-1])).astype(np.uint8)


def draw_curve(axes: Axes, thread: Polyline, values: Float64[np.ndarray, "n"]) -> None:
    """A number at each point of the thread as a line, in the colours and thickness of confidence."""
    at = axes.at(thread.along * thread.length, values).tolist()
    confidence = 0.5 * (thread.confidence[:-1] + thread.confidence[1:])
    bgr = colours.thread_rgb(confidence, thread.unseen[:-1] & thread.unseen[1:])[:, ::-1].tolist()
    thickness = line_thickness(confidence)
    for i in np.flatnonzero(np.isfinite(values[:-1] + values[1:])).tolist():
        cv2.line(axes.plot, at[i], at[i + 1], bgr[i], thickness[i], cv2.LINE_AA, SHIFT)


def nice_ticks(low: float, high: float, about: int) -> list[float]:
    """Round numbers within a range: steps of 1, 2 or 5 times a power of ten."""
    rough = (high - low) / about
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= rough)
    return [step * k for k in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _draw_grid(canvas: UInt8[np.ndarray, "h w 3"], axes: Axes) -> None:
    height, width = axes.plot.shape[:2]
    bottom = MARGIN_TOP + height
    x_ticks = np.array(nice_ticks(*axes.x_range, about=12))
    for x, (u, _) in zip(x_ticks, axes.at(x_ticks, np.zeros_like(x_ticks)) >> SHIFT, strict=True):
        cv2.line(axes.plot, (int(u), 0), (int(u), height), colours.GRID[::-1], 1)
        label = f"{x:.6g}"
        draw_text(
            canvas, label, (MARGIN_LEFT + int(u) - text_width(label, SMALL) // 2, bottom + 18), colours.TEXT, SMALL
        )
    y_ticks = np.array(nice_ticks(*axes.y_range, about=max(2, height // 35)))
    for y, (_, v) in zip(y_ticks, axes.at(np.zeros_like(y_ticks), y_ticks) >> SHIFT, strict=True):
        cv2.line(axes.plot, (0, int(v)), (width, int(v)), colours.GRID[::-1], 1)
        label = f"{y:.6g}"
        draw_text(
            canvas, label, (MARGIN_LEFT - 8 - text_width(label, SMALL), MARGIN_TOP + int(v) + 5), colours.TEXT, SMALL
        )


DEPTH_PX = 200


@dataclass(frozen=True)
class DepthMarks:
    """Observations beside the curve: how far along, how deep, and how far the bounds reach (0: none)."""

    along: Float64[np.ndarray, "n"]
    depth: Float64[np.ndarray, "n"]
    bound: Float64[np.ndarray, "n"]
    missed: Bool[np.ndarray, "n"]


@dataclass(frozen=True)
class DepthBand:
    """Between which depths the thread lies with 95 % probability, at places along it; empty where nobody says."""

    along: Float64[np.ndarray, "q"]
    low: Float64[np.ndarray, "q"]
    high: Float64[np.ndarray, "q"]


def depth_strip(
    width: int, thread: Polyline | None, marks: DepthMarks, band: DepthBand, unit: str
) -> UInt8[np.ndarray, "h w 3"]:
    """A canvas of that width with the plot; without thread or marks it says so."""
    depths = np.concatenate((marks.depth, [] if thread is None else thread.points_camera[:, 2]))
    if len(depths) == 0:
        canvas = np.full((MARGIN_TOP + DEPTH_PX, width, 3), colours.BACKGROUND[::-1], dtype=np.uint8)
        text = "no observations and no thread: there is no depth to show"
        draw_text(canvas, text, ((width - text_width(text)) // 2, len(canvas) // 2), colours.MUTED)
        return canvas
    length = float(marks.along.max()) if thread is None else thread.length
    below = f"length along the thread from s=0, {unit}"
    x_range, y_range = (0.0, length or 1.0), _depth_range(depths, marks.bound)
    canvas, axes = strip(width, DEPTH_PX, f"depth, {unit}", x_range, y_range, below)
    if thread is not None:
        shade_unseen(axes, thread)
        _draw_band(axes, band)
        draw_curve(axes, thread, thread.points_camera[:, 2])
        _draw_colour_bar(canvas)
    _draw_marks(axes, marks)
    return canvas


def _depth_range(depths: Float64[np.ndarray, "n"], bounds: Float64[np.ndarray, "m"]) -> tuple[float, float]:
    """Room for all depths and for the usual bounds; a few huge bounds may leave the plot."""
    low, high = float(depths.min()), float(depths.max())
    usual = float(np.percentile(bounds, 90)) if len(bounds) else 0.0
    margin = max(0.08 * (high - low), min(1.2 * usual, max(high - low, 0.1 * high)), 1e-3 * high)
    return low - margin, high + margin


def _draw_band(axes: Axes, band: DepthBand) -> None:
    if len(band.along) < 2:
        return
    edge = np.concatenate((axes.at(band.along, band.low), axes.at(band.along, band.high)[::-1]))
    filled = axes.plot.copy()
    cv2.fillPoly(filled, [edge], colours.BAND[::-1], cv2.LINE_AA, SHIFT)
    cv2.addWeighted(filled, 0.5, axes.plot, 0.5, 0, dst=axes.plot)


def _draw_marks(axes: Axes, marks: DepthMarks) -> None:
    low = axes.at(marks.along, marks.depth - marks.bound).tolist()
    high = axes.at(marks.along, marks.depth + marks.bound).tolist()
    middle = axes.at(marks.along, marks.depth).tolist()
    cap = np.array([3 << SHIFT, 0])
    for i, centre in enumerate(middle):
        bgr = (colours.OUTSIDE if marks.missed[i] else colours.OBSERVATION)[::-1]
        if marks.bound[i] > 0:
            cv2.line(axes.plot, low[i], high[i], bgr, 1, cv2.LINE_AA, SHIFT)
            for end in (low[i], high[i]):
                cv2.line(axes.plot, (end - cap).tolist(), (end + cap).tolist(), bgr, 1, cv2.LINE_AA, SHIFT)
        cv2.circle(axes.plot, centre, 5 << SHIFT - 1, bgr, cv2.FILLED, cv2.LINE_AA, SHIFT)


def _draw_colour_bar(canvas: UInt8[np.ndarray, "h w 3"]) -> None:
    """The colours and thicknesses of confidence, with numbers."""
    top, bottom, left = MARGIN_TOP, MARGIN_TOP + DEPTH_PX, canvas.shape[1] - MARGIN_RIGHT + 34
    confidence = np.linspace(1.0, 0.0, bottom - top)
    canvas[top:bottom, left : left + 16] = colours.confidence_rgb(confidence)[:, None, ::-1]
    for row, thickness in enumerate(line_thickness(confidence)):
        canvas[top + row, left + 24 : left + 24 + thickness] = colours.TEXT[::-1]
    for value in (0.0, 0.5, 1.0):
        draw_text(canvas, f"{value:g}", (left + 36, round(bottom + (top - bottom) * value) + 5), colours.TEXT, SMALL)
    draw_text(canvas, "confidence", (left - 14, top - 12), colours.TEXT)


QUALITY_PX = 105
HEADROOM = 1.1
DOT_PX = 1.6
WORTH_SAYING = 0.01
"""From this share on, points that the curve does not explain are counted."""

Canvas = UInt8[np.ndarray, "h w 3"]
Words = tuple[str, tuple[int, int, int]]


def deviation_strip(width: int, thread: Polyline, sections: CrossSections, unit: str) -> Canvas:
    """The standard deviation across the thread in its worst direction; no rows where none is predicted."""
    if len(sections.along) < 2:
        return np.zeros((0, width, 3), np.uint8)
    highest = float(sections.deviation.max()) or 1.0
    title = f"standard deviation across the thread, in its worst direction, {unit}"
    canvas, axes = strip(width, QUALITY_PX, title, (0.0, thread.length), (0.0, HEADROOM * highest))
    shade_unseen(axes, thread)
    deviation = np.interp(thread.along, sections.along, sections.deviation, left=np.nan, right=np.nan)
    draw_curve(axes, thread, deviation)
    numbers = f"mean {sections.deviation.mean():.3g}", f"worst {highest:.3g}"
    _beside(canvas, [(number, colours.TEXT) for number in numbers])
    return canvas


def residual_strip(width: int, thread: Polyline, left: Residuals, right: Residuals) -> Canvas:
    """The residuals of the points that the curve explains, in both images; no rows where there are none."""
    own = [(of_side, of_side.distance_px[of_side.claimed]) for of_side in (left, right)]
    highest = max((float(distance.max(initial=0.0)) for _, distance in own), default=0.0)
    if highest == 0.0:
        return np.zeros((0, width, 3), np.uint8)
    title = "residual: from the middle of the thread in an image to the projected curve, px"
    canvas, axes = strip(width, QUALITY_PX, title, (0.0, thread.length), (0.0, HEADROOM * highest))
    shade_unseen(axes, thread)
    words: list[Words] = [("median, 95 %", colours.MUTED)]
    for (of_side, distance), side, rgb in zip(
        own, ("left", "right"), (colours.LEFT_EYE, colours.RIGHT_EYE), strict=True
    ):
        _draw_dots(axes, of_side.along[of_side.claimed] * thread.length, distance, rgb)
        words += _numbers(side, summary(of_side), rgb)
    _beside(canvas, words)
    return canvas


def _numbers(side: str, of: ResidualSummary, rgb: tuple[int, int, int]) -> list[Words]:
    if of.median_px is None or of.percentile_95_px is None:
        return [(f"{side}: none", rgb)]
    left_over = [(f"{of.left_over:.0%} left over", rgb)] if of.left_over and of.left_over >= WORTH_SAYING else []
    return [(f"{side} {of.median_px:.2f}, {of.percentile_95_px:.2f}", rgb), *left_over]


def _draw_dots(axes: Axes, x: np.ndarray, y: np.ndarray, rgb: tuple[int, int, int]) -> None:
    for centre in axes.at(x, y).tolist():
        cv2.circle(axes.plot, centre, round(DOT_PX * 2**SHIFT), rgb[::-1], cv2.FILLED, cv2.LINE_AA, SHIFT)


def _beside(canvas: Canvas, words: list[Words]) -> None:
    left = canvas.shape[1] - MARGIN_RIGHT + 20
    for row, (text, rgb) in enumerate(words):
        draw_text(canvas, text, (left, MARGIN_TOP + 14 + 22 * row), rgb, SMALL)


WIDTH_PX = 1600
MARGIN_PX = 12
TALLEST_PANE_PX = 900
NORMAL_95 = 1.96
"""Standard deviations about the mean of a normal distribution that hold 95 % of it."""

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
