"""Charts of a page, as SVG: polylines over time with axes, without any script or library."""

import html
import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

WIDTH, HEIGHT = 900, 200
LEFT, RIGHT, TOP, BOTTOM = 56, 12, 10, 24
BINS = 600
COLOURS = 6
"""The page's style names so many, `.c0` to `.c5`."""
TICKS = 5
EVEN, ROUND = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0), (1.0, 2.0, 5.0)
"""With which digits an axis may end, and how far its marks may be apart."""
GAP_FACTOR = 6.0
"""A line is broken where it has no value for so many of its median intervals."""


@dataclass(frozen=True)
class Series:
    """Values over seconds."""

    name: str
    at_s: Float64[np.ndarray, "n"]
    values: Float64[np.ndarray, "n"]


@dataclass(frozen=True)
class Mark:
    """A moment, with what happened then."""

    at_s: float
    text: str


def chart(title: str, series: list[Series], end_s: float, marks: list[Mark], ceiling: float | None = None) -> str:
    """A figure with all series in one frame, from 0 s until the end, and from 0 until the largest value."""
    drawn = [one for one in series if np.isfinite(one.values).any()]
    top = ceiling or max((float(np.nanmax(one.values)) for one in drawn), default=1.0)
    top, end_s = nice_ceiling(max(top, 1e-9)), max(end_s, 1e-3)
    parts = [_grid(end_s, top)]
    parts += [_mark(mark, end_s) for mark in marks if 0 <= mark.at_s <= end_s]
    for index, one in enumerate(drawn):
        parts += [_polyline(points, index, one.name) for points in _stretches(one, end_s, top)]
    keys = " ".join(f'<span class="key c{i % COLOURS}">{html.escape(one.name)}</span>' for i, one in enumerate(drawn))
    return (
        f"<figure><figcaption>{html.escape(title)} {keys}</figcaption>"
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{html.escape(title, quote=True)}">'
        f"{''.join(parts)}</svg></figure>"
    )


def nice_ceiling(value: float, digits: tuple[float, ...] = EVEN) -> float:
    """The next number that is one of these digits times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return next((m * power for m in digits if m * power >= value * (1 - 1e-9)), 10 * power)


def thinned(
    at_s: Float64[np.ndarray, "n"], values: Float64[np.ndarray, "n"], bins: int = BINS
) -> tuple[Float64[np.ndarray, "m"], Float64[np.ndarray, "m"]]:
    """At most two values a bin of equal counts, its least and its largest, so that no peak is lost."""
    if len(values) <= 2 * bins:
        return at_s, values
    edges = np.linspace(0, len(values), bins + 1).astype(int)[:-1]
    bin_of = np.searchsorted(edges, np.arange(len(values)), side="right") - 1
    # sorted by bin, then by value: the first and the last of each bin
    order = np.lexsort((values, bin_of))
    last = np.append(edges[1:], len(values)) - 1
    kept = np.unique(np.concatenate((order[edges], order[last])))
    return at_s[kept], values[kept]


def _stretches(one: Series, end_s: float, top: float) -> list[Float64[np.ndarray, "m 2"]]:
    """The line in pixels of the figure, cut where nothing is known for long."""
    known = np.isfinite(one.values) & np.isfinite(one.at_s)
    order = np.argsort(one.at_s[known], kind="stable")
    at_s, values = one.at_s[known][order], one.values[known][order]
    steps = np.diff(at_s)
    cuts = np.flatnonzero(steps > max(GAP_FACTOR * float(np.median(steps)), 0.5)) + 1 if len(steps) else []
    stretches: list[Float64[np.ndarray, "m 2"]] = []
    share = BINS // (len(cuts) + 1) + 1
    for times, heights in zip(np.split(at_s, cuts), np.split(values, cuts), strict=True):
        x, y = thinned(times, heights, share)
        stretches.append(np.column_stack((_x(x, end_s), _y(np.clip(y, 0, top), top))))
    return stretches


def _x(at_s: Float64[np.ndarray, "n"], end_s: float) -> Float64[np.ndarray, "n"]:
    return LEFT + at_s / end_s * (WIDTH - LEFT - RIGHT)


def _y(values: Float64[np.ndarray, "n"], top: float) -> Float64[np.ndarray, "n"]:
    return HEIGHT - BOTTOM - values / top * (HEIGHT - TOP - BOTTOM)


def _polyline(points: Float64[np.ndarray, "n 2"], index: int, name: str) -> str:
    title = f"<title>{html.escape(name)}</title>"
    if len(points) == 1:
        x, y = points[0]
        return f'<circle class="c{index % COLOURS}" cx="{x:.1f}" cy="{y:.1f}" r="2.5">{title}</circle>'
    text = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline class="c{index % COLOURS}" points="{text}">{title}</polyline>'


def _mark(mark: Mark, end_s: float) -> str:
    x = float(_x(np.array([mark.at_s]), end_s)[0])
    return (
        f'<line class="mark" x1="{x:.1f}" x2="{x:.1f}" y1="{TOP}" y2="{HEIGHT - BOTTOM}">'
        f"<title>{html.escape(f'{mark.at_s:.2f} s: {mark.text}')}</title></line>"
    )


def _grid(end_s: float, top: float) -> str:
    parts: list[str] = []
    for value in np.linspace(0, top, TICKS):
        y = float(_y(np.array([value]), top)[0])
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text class="tick right" x="{LEFT - 6}" y="{y + 4:.1f}">{value:.4g}</text>')
    step_s = nice_ceiling(end_s / 10, ROUND)
    for at_s in np.arange(0, end_s * (1 + 1e-9), step_s):
        x = float(_x(np.array([at_s]), end_s)[0])
        parts.append(f'<text class="tick middle" x="{x:.1f}" y="{HEIGHT - 6}">{at_s:g} s</text>')
    return "".join(parts)
