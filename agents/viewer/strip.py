"""Plots along the thread: a part of a canvas with ticks at its edges, and what all of them show."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from agents.viewer import colours
from agents.viewer.image_pane import FAR_PX, SHIFT, line_thickness
from agents.viewer.lettering import draw_text, text_width
from agents.viewer.polyline import Polyline

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
