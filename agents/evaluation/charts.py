"""Diagrams as SVG."""

from collections.abc import Sequence

from agents.evaluation.reliability import Reliability
from agents.evaluation.sweep import FALLS_TO, Sweep
from agents.evaluation.table import named

WIDTH, HEIGHT, LEFT, BOTTOM = 420, 300, 45, 40
COLOURS = ("#b04a4a", "#d9a441", "#3b6ea8", "#3f8f5b")
LARGEST_PX = 14.0


def reliability_chart(found: Reliability) -> str:
    """The share that held over what was promised: on the diagonal promises hold."""
    most = max(b.trials for b in found.bins)
    dots = [
        f'<circle cx="{_x(b.promised):.1f}" cy="{_y(b.held):.1f}" r="{2 + LARGEST_PX * (b.trials / most) ** 0.5:.1f}" '
        'fill="#3b6ea8" fill-opacity=".5"/>'
        for b in found.bins
    ]
    diagonal = f'<line x1="{_x(0)}" y1="{_y(0)}" x2="{_x(1)}" y2="{_y(1)}" stroke="#999"/>'
    return _chart([diagonal, *dots], [(share, f"{100 * share:g} %") for share in (0, 0.25, 0.5, 0.75, 1)], "promised")


def sweep_chart(found: Sequence[Sweep]) -> str:
    """Success over the deviation of the tool's error, a line for each row."""
    most = max(found[0].errors_mm) or 1.0
    parts = [_line([(0.0, FALLS_TO), (1.0, FALLS_TO)], "#999", ' stroke-dasharray="4 3"')]
    for i, (sweep, colour) in enumerate(zip(found, COLOURS, strict=False)):
        points = [(e / most, r.share) for e, r in zip(sweep.errors_mm, sweep.rates, strict=True) if r.share is not None]
        parts.append(_line(points, colour))
        y = _y(0.05) - 16 * (len(found) - 1 - i)
        parts.append(f'<text x="{_x(0.03)}" y="{y}" fill="{colour}">{named(sweep.row)}</text>')
    return _chart(parts, [(error / most, f"{error:g}") for error in found[0].errors_mm], "tool error, mm")


def _chart(parts: list[str], ticks: list[tuple[float, str]], below: str) -> str:
    """Axes from 0 to 1 around the parts, with ticks below."""
    grid = [_line([(0.0, share), (1.0, share)], "#eee") for share in (0.25, 0.5, 0.75)]
    frame = (
        f'<rect x="{_x(0)}" y="{_y(1)}" width="{_x(1) - _x(0)}" height="{_y(0) - _y(1)}" fill="none" stroke="#666"/>'
    )
    left = [
        f'<text x="{LEFT - 5}" y="{_y(share) + 4}" text-anchor="end">{100 * share:g} %</text>'
        for share in (0, 0.25, 0.5, 0.75, 1)
    ]
    under = [f'<text x="{_x(x)}" y="{_y(0) + 15}" text-anchor="middle">{text}</text>' for x, text in ticks]
    name = f'<text x="{_x(0.5)}" y="{HEIGHT - 5}" text-anchor="middle">{below}</text>'
    body = "".join([*grid, frame, *left, *under, name, *parts])
    return f'<svg width="{WIDTH}" height="{HEIGHT}" font-size="11" font-family="sans-serif">{body}</svg>'


def _line(points: list[tuple[float, float]], colour: str, more: str = "") -> str:
    path = " ".join(f"{_x(x):.1f},{_y(y):.1f}" for x, y in points)
    return f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="1.5"{more}/>'


def _x(share: float) -> float:
    return LEFT + share * (WIDTH - LEFT - 15)


def _y(share: float) -> float:
    return HEIGHT - BOTTOM - share * (HEIGHT - BOTTOM - 12)
