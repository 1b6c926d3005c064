"""The depth along a thread as a plot: the curve by confidence, observations with their bounds."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from agents.viewer import colours
from agents.viewer.image_pane import FAR_PX, SHIFT, line_thickness
from agents.viewer.lettering import draw_text, text_width
from agents.viewer.polyline import Polyline

HEIGHT_PX = 300
MARGIN_LEFT, MARGIN_RIGHT, MARGIN_TOP, MARGIN_BOTTOM = 80, 150, 40, 50
TICKS_ABOUT = 8
SMALL = 0.45


@dataclass(frozen=True)
class DepthMarks:
    """Observations beside the curve: how far along, how deep, and how far the bounds reach (0: none)."""

    along: Float64[np.ndarray, "n"]
    depth: Float64[np.ndarray, "n"]
    bound: Float64[np.ndarray, "n"]
    missed: Bool[np.ndarray, "n"]


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
    canvas = np.full((HEIGHT_PX, width, 3), colours.BACKGROUND[::-1], dtype=np.uint8)
    depths = np.concatenate((marks.depth, [] if thread is None else thread.points_camera[:, 2]))
    if len(depths) == 0:
        text = "no observations and no thread: there is no depth to show"
        draw_text(canvas, text, ((width - text_width(text)) // 2, HEIGHT_PX // 2), colours.MUTED)
        return canvas
    length = float(marks.along.max()) if thread is None else thread.length
    plot = canvas[MARGIN_TOP:-MARGIN_BOTTOM, MARGIN_LEFT:-MARGIN_RIGHT]
    plot[:] = colours.PANEL[::-1]
    axes = Axes(plot, (0.0, length or 1.0), _depth_range(depths, marks.bound))
    _draw_grid(canvas, axes, unit)
    if thread is not None:
        _shade_unseen(axes, thread)
        _draw_band(axes, band)
        _draw_curve(axes, thread)
        _draw_colour_bar(canvas)
    _draw_marks(axes, marks)
    return canvas


def nice_ticks(low: float, high: float, about: int = TICKS_ABOUT) -> list[float]:
    """Round numbers within a range: steps of 1, 2 or 5 times a power of ten."""
    rough = (high - low) / about
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= rough)
    return [step * k for k in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _depth_range(depths: Float64[np.ndarray, "n"], bounds: Float64[np.ndarray, "m"]) -> tuple[float, float]:
    """Room for all depths and for the usual bounds; a few huge bounds may leave the plot."""
    low, high = float(depths.min()), float(depths.max())
    usual = float(np.percentile(bounds, 90)) if len(bounds) else 0.0
    margin = max(0.08 * (high - low), min(1.2 * usual, max(high - low, 0.1 * high)), 1e-3 * high)
    return low - margin, high + margin


def _draw_grid(canvas: UInt8[np.ndarray, "h w 3"], axes: Axes, unit: str) -> None:
    height, width = axes.plot.shape[:2]
    bottom = MARGIN_TOP + height
    x_ticks = np.array(nice_ticks(*axes.x_range, about=12))
    for x, (u, _) in zip(x_ticks, axes.at(x_ticks, np.zeros_like(x_ticks)) >> SHIFT, strict=True):
        cv2.line(axes.plot, (int(u), 0), (int(u), height), colours.GRID[::-1], 1)
        label = f"{x:.6g}"
        draw_text(
            canvas, label, (MARGIN_LEFT + int(u) - text_width(label, SMALL) // 2, bottom + 18), colours.TEXT, SMALL
        )
    y_ticks = np.array(nice_ticks(*axes.y_range, about=6))
    for y, (_, v) in zip(y_ticks, axes.at(np.zeros_like(y_ticks), y_ticks) >> SHIFT, strict=True):
        cv2.line(axes.plot, (0, int(v)), (width, int(v)), colours.GRID[::-1], 1)
        label = f"{y:.6g}"
        draw_text(
            canvas, label, (MARGIN_LEFT - 8 - text_width(label, SMALL), MARGIN_TOP + int(v) + 5), colours.TEXT, SMALL
        )
    draw_text(canvas, f"depth, {unit}", (MARGIN_LEFT, MARGIN_TOP - 12), colours.TEXT)
    title = f"length along the thread from s=0, {unit}"
    draw_text(canvas, title, (MARGIN_LEFT + (width - text_width(title)) // 2, bottom + 40), colours.TEXT)


def _shade_unseen(axes: Axes, thread: Polyline) -> None:
    width = axes.plot.shape[1]
    columns = np.interp(np.arange(width), thread.along * (width - 1), thread.unseen.astype(float)) > 0.5
    axes.plot[:, columns] = (0.75 * axes.plot[:, columns] + 0.25 * np.array(colours.MUTED[::-1])).astype(np.uint8)


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


def _draw_curve(axes: Axes, thread: Polyline) -> None:
    at = axes.at(thread.along * thread.length, thread.points_camera[:, 2]).tolist()
    confidence = 0.5 * (thread.confidence[:-1] + thread.confidence[1:])
    bgr, thickness = colours.confidence_rgb(confidence)[:, ::-1].tolist(), line_thickness(confidence)
    for i in range(len(at) - 1):
        cv2.line(axes.plot, at[i], at[i + 1], bgr[i], thickness[i], cv2.LINE_AA, SHIFT)


def _draw_colour_bar(canvas: UInt8[np.ndarray, "h w 3"]) -> None:
    """The colours and thicknesses of confidence, with numbers."""
    top, bottom, left = MARGIN_TOP, HEIGHT_PX - MARGIN_BOTTOM, canvas.shape[1] - MARGIN_RIGHT + 34
    confidence = np.linspace(1.0, 0.0, bottom - top)
    canvas[top:bottom, left : left + 16] = colours.confidence_rgb(confidence)[:, None, ::-1]
    for row, thickness in enumerate(line_thickness(confidence)):
        canvas[top + row, left + 24 : left + 24 + thickness] = colours.TEXT[::-1]
    for value in (0.0, 0.5, 1.0):
        draw_text(canvas, f"{value:g}", (left + 36, round(bottom + (top - bottom) * value) + 5), colours.TEXT, SMALL)
    draw_text(canvas, "confidence", (left - 14, top - 12), colours.TEXT)
