"""How far a thread can be trusted along its length, as plots: what is predicted across it, and the residuals."""

import cv2
import numpy as np
from jaxtyping import UInt8

from agents.viewer import colours
from agents.viewer.cross_sections import CrossSections
from agents.viewer.image_pane import SHIFT
from agents.viewer.lettering import draw_text
from agents.viewer.polyline import Polyline
from agents.viewer.residuals import Residuals, ResidualSummary, summary
from agents.viewer.strip import MARGIN_RIGHT, MARGIN_TOP, SMALL, Axes, draw_curve, shade_unseen, strip

PLOT_PX = 105
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
    canvas, axes = strip(width, PLOT_PX, title, (0.0, thread.length), (0.0, HEADROOM * highest))
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
    canvas, axes = strip(width, PLOT_PX, title, (0.0, thread.length), (0.0, HEADROOM * highest))
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
