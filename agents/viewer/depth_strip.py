"""The depth along a thread as a plot: the curve by confidence, observations with their bounds."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from agents.viewer import colours
from agents.viewer.image_pane import SHIFT, line_thickness
from agents.viewer.lettering import draw_text, text_width
from agents.viewer.polyline import Polyline
from agents.viewer.strip import MARGIN_RIGHT, MARGIN_TOP, SMALL, Axes, draw_curve, shade_unseen, strip

PLOT_PX = 200


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
        canvas = np.full((MARGIN_TOP + PLOT_PX, width, 3), colours.BACKGROUND[::-1], dtype=np.uint8)
        text = "no observations and no thread: there is no depth to show"
        draw_text(canvas, text, ((width - text_width(text)) // 2, len(canvas) // 2), colours.MUTED)
        return canvas
    length = float(marks.along.max()) if thread is None else thread.length
    below = f"length along the thread from s=0, {unit}"
    x_range, y_range = (0.0, length or 1.0), _depth_range(depths, marks.bound)
    canvas, axes = strip(width, PLOT_PX, f"depth, {unit}", x_range, y_range, below)
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
    top, bottom, left = MARGIN_TOP, MARGIN_TOP + PLOT_PX, canvas.shape[1] - MARGIN_RIGHT + 34
    confidence = np.linspace(1.0, 0.0, bottom - top)
    canvas[top:bottom, left : left + 16] = colours.confidence_rgb(confidence)[:, None, ::-1]
    for row, thickness in enumerate(line_thickness(confidence)):
        canvas[top + row, left + 24 : left + 24 + thickness] = colours.TEXT[::-1]
    for value in (0.0, 0.5, 1.0):
        draw_text(canvas, f"{value:g}", (left + 36, round(bottom + (top - bottom) * value) + 5), colours.TEXT, SMALL)
    draw_text(canvas, "confidence", (left - 14, top - 12), colours.TEXT)
