"""One HTML file that holds all it shows: no script, and nothing from elsewhere; light or dark as its reader likes.

Charts of a page, as SVG: polylines over time with axes, without any script or library.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from agents.session_report.grasps import Grasp, event_name
from agents.session_report.pictures import Picture
from agents.session_report.session import Session
from agents.session_report.table import Table
from agents.session_report.tables import head_lines, session_tables
from schemas.topics import ROBOT_STATE
from shared.html_page import escaped, figure, image, page, paragraph, table

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
    keys = " ".join(f'<span class="key c{i % COLOURS}">{escaped(one.name)}</span>' for i, one in enumerate(drawn))
    return (
        f"<figure><figcaption>{escaped(title)} {keys}</figcaption>"
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escaped(title)}">'
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
    title = f"<title>{escaped(name)}</title>"
    if len(points) == 1:
        x, y = points[0]
        return f'<circle class="c{index % COLOURS}" cx="{x:.1f}" cy="{y:.1f}" r="2.5">{title}</circle>'
    text = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline class="c{index % COLOURS}" points="{text}">{title}</polyline>'


def _mark(mark: Mark, end_s: float) -> str:
    x = float(_x(np.array([mark.at_s]), end_s)[0])
    return (
        f'<line class="mark" x1="{x:.1f}" x2="{x:.1f}" y1="{TOP}" y2="{HEIGHT - BOTTOM}">'
        f"<title>{escaped(f'{mark.at_s:.2f} s: {mark.text}')}</title></line>"
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


STYLE = """
:root { --mark: #b0b8c0; --k0: #1f6fb4; --k1: #c2571a; --k2: #2b8a3e; --k3: #9c36b5; --k4: #b0860b; --k5: #d6336c; }
@media (prefers-color-scheme: dark) { :root { --mark: #59636c; --k0: #6cb2f0; --k1: #f29a63; --k2: #69db7c;
  --k3: #d49bea; --k4: #e8c24a; --k5: #f783ac; } }
svg { width: 100%; height: auto; } polyline { fill: none; stroke-width: 1.4; } .grid { stroke: var(--line); }
.mark { stroke: var(--mark); stroke-dasharray: 3 3; }
.tick { fill: var(--dim); font-size: 11px; } .right { text-anchor: end; } .middle { text-anchor: middle; }
.key { margin-left: .9rem; font-weight: 600; } .pictures { display: flex; flex-wrap: wrap; gap: .6rem; }
.pictures figure { margin: 0; width: 15.5rem; } .pictures img { width: 100%; border-radius: 3px; }
""" + "\n".join(
    f"polyline.c{i} {{ stroke: var(--k{i}); }} circle.c{i} {{ fill: var(--k{i}); }} .key.c{i} {{ color: var(--k{i}); }}"
    for i in range(COLOURS)
)
RATE_BIN_S, MOST_BINS = 1.0, 600
MOST_ROWS = 2000


def session_page(session: Session, pictures: list[Picture]) -> Iterator[str]:
    """The page of one session, piece by piece."""
    return page(session.path.name, _session_parts(session, pictures), STYLE)


def comparison_page(sessions: list[Session], names: list[str], tables: list[Table]) -> Iterator[str]:
    """The page of sessions side by side, piece by piece."""
    return page(" and ".join(names), _comparison_parts(sessions, names, tables), STYLE)


def _session_parts(session: Session, pictures: list[Picture]) -> Iterator[str]:
    yield from map(paragraph, head_lines(session))
    yield from session_charts(session)
    tables = session_tables(session)
    of_grasps = [table for table in tables if table.title in ("grasps", "pulls", "armed")]
    yield from map(table_html, of_grasps)
    yield from _pictures(session, pictures)
    yield from (table_html(table) for table in tables if table not in of_grasps)


def _comparison_parts(sessions: list[Session], names: list[str], tables: list[Table]) -> Iterator[str]:
    for session, name in zip(sessions, names, strict=True):
        yield f"<h2>{escaped(name)}</h2>"
        yield from map(paragraph, head_lines(session))
    yield from comparison_charts(sessions, names)
    yield from map(table_html, tables)


def session_charts(session: Session) -> Iterator[str]:
    """Latency, rate and confidence over time, with what happened to grasps."""
    end_s, marks = session.duration_s, [mark for grasp in session.grasps for mark in _marks(session, grasp)]
    yield "<h2>over time</h2>"
    stages = [name for name in session.stages if not name.startswith(str(ROBOT_STATE))]
    latency = [_latency(session, name, name) for name in stages]
    yield chart("from capture until published, ms", latency, end_s, marks)
    rates = [_rate(session, name, name) for name in stages if len(session.stages[name].captured) > 1]
    yield chart("messages a second", rates, end_s, marks)
    yield chart("mean confidence along the thread", [_confidence(session, "confidence")], end_s, marks, ceiling=1.0)
    yield chart(*_length(session), end_s, marks)
    if any(pull.tails for pull in session.pulls):
        yield chart("tail, mm", _tails(session), end_s, marks)
    arms = [name for name in session.stages if name not in stages]
    if arms:
        yield chart("state of the arm, ms after it was measured", [_latency(session, n, n) for n in arms], end_s, marks)


def _tails(session: Session) -> list[Series]:
    told = [one for pull in session.pulls for one in pull.tails]
    at_s = np.array([session.since_start_s(captured_ns) for captured_ns, _ in told])
    bounds = [(tail.tail.length_m, *tail.tail.interval_m) for _, tail in told if tail.tail is not None]
    values = 1e3 * np.array(bounds, dtype=float)
    return [Series(name, at_s, values[:, k]) for k, name in enumerate(("length", "at least", "at most"))]


def comparison_charts(sessions: list[Session], names: list[str]) -> Iterator[str]:
    """A chart for each stage with a line for each session, from its own start."""
    end_s = max(session.duration_s for session in sessions)
    yield "<h2>over time, from the start of each</h2>"
    for stage in dict.fromkeys(stage for session in sessions for stage in session.stages):
        lines = [_latency(one, stage, name) for one, name in zip(sessions, names, strict=True) if stage in one.stages]
        yield chart(f"{stage}, from capture until published, ms", lines, end_s, [])
    confidence = [_confidence(session, name) for session, name in zip(sessions, names, strict=True)]
    yield chart("mean confidence along the thread", confidence, end_s, [], ceiling=1.0)


def table_html(of: Table) -> str:
    """A table with its title."""
    left = len(of.rows) - MOST_ROWS
    more = paragraph(f"and {left} more, which --json shows") if left > 0 else ""
    return f"<h2>{escaped(of.title)}</h2>{table(of.columns, of.rows[:MOST_ROWS])}{more}"


def _pictures(session: Session, pictures: list[Picture]) -> Iterator[str]:
    for number in sorted({picture.of.grasp for picture in pictures}):
        ended = session.grasps[number - 1].ended
        yield f'<h2>grasp {number}: {escaped(ended)}</h2><div class="pictures">'
        for picture in (one for one in pictures if one.of.grasp == number):
            at = f"{picture.of.what}, as filmed at {session.since_start_s(picture.captured_ns):.2f} s"
            yield figure(image(picture.jpeg, at), at)
        yield "</div>\n"


def _marks(session: Session, grasp: Grasp) -> Iterator[Mark]:
    yield Mark(session.since_start_s(grasp.at_ns), f"goal, {grasp.outcome}")
    for arming in grasp.armings:
        for event in arming.events:
            yield Mark(session.since_start_s(event.at_ns), event_name(event))
        if arming.judgement is not None:
            yield Mark(session.since_start_s(arming.judgement.at_ns), arming.judgement.sentence)


def _latency(session: Session, stage: str, name: str) -> Series:
    times = session.stages[stage]
    return Series(name, (times.published_ns - session.start_ns) * 1e-9, times.latency_ms)


def _rate(session: Session, stage: str, name: str) -> Series:
    """How many messages came, a second, in each second, or in longer bins of a long session."""
    # one clock that is not set makes a session of decades
    bins = int(np.clip(session.duration_s / RATE_BIN_S, 1, MOST_BINS))
    at_s = (session.stages[stage].published_ns - session.start_ns) * 1e-9
    counts, edges = np.histogram(at_s, bins, (0.0, max(session.duration_s, 1e-3)))
    return Series(name, 0.5 * (edges[:-1] + edges[1:]), counts / np.diff(edges))


def _confidence(session: Session, name: str) -> Series:
    return Series(name, (session.quality.captured_ns - session.start_ns) * 1e-9, session.quality.confidence)


def _length(session: Session) -> tuple[str, list[Series]]:
    unit = session.quality.metres_per_unit
    title = "length of the thread, mm" if unit else "length of the thread, in the unit of the calibration"
    at_s = (session.quality.captured_ns - session.start_ns) * 1e-9
    return title, [Series("length", at_s, session.quality.length * (1e3 * unit if unit else 1.0))]
