"""Plots along the thread: its depth, what is predicted across it, and the residuals of its points."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from agents.viewer import colours
from agents.viewer.cross_sections import CrossSections
from agents.viewer.image_pane import FAR_PX, SHIFT, line_thickness
from agents.viewer.lettering import draw_text, text_width
from agents.viewer.polyline import Polyline
from agents.viewer.residuals import Residuals, ResidualSummary, summary

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
