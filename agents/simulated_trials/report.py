"""The report of an evaluation: one HTML file with tables, diagrams and pictures in it, and JSON for programs.

Diagrams are SVG.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from agents.simulated_trials.look import Came
from agents.simulated_trials.protocol import Protocol
from agents.simulated_trials.results import Compared, Rate, Reliability, Results
from agents.simulated_trials.table import FALLS_TO, Sweep, named, overview, sweeps
from shared.html_page import escaped, figure, image, page, paragraph, table

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


STYLE = """
figure { display: inline-block; margin: .5em; vertical-align: top; } figcaption { max-width: 600px; }
img { max-width: 600px; width: 100%; } svg { background: #fff; }
"""
MOST_TOLD = 200


@dataclass(frozen=True)
class Picture:
    """A picture with what it shows; JPEG or PNG data."""

    caption: str
    data: bytes
    mime: str = "image/jpeg"


def report(
    protocol: Protocol,
    came: Sequence[Came],
    every: Sequence[Results],
    whole: Results,
    pictures: Sequence[Picture],
) -> str:
    """The page."""
    found = sweeps(every)
    parts = [
        as_html(overview(protocol, every, whole)),
        "<h2>Diagrams</h2>",
        *([figure(sweep_chart(found), "Success over the tool's error; dashed: 95 %.")] if found else []),
        *(
            figure(reliability_chart(one), f"Promised and held: {named(row)}. Areas tell how many trials.")
            for row, one in whole.reliability.items()
            if one is not None
        ),
        "<h2>Where grasps failed</h2>",
        _failures(came),
        "<h2>Fields</h2><p>Goals as dots: green held, red failed, grey declined; a line leads from the capture.</p>",
        *(figure(image(one.data, one.caption, one.mime), one.caption) for one in pictures),
    ]
    return "\n".join(page("Grasping, from images to lifted thread, simulated", parts, STYLE))


def as_html(markdown: str) -> str:
    """The little Markdown that our pages use: headings, tables, lists and `code`."""
    parts: list[str] = []
    rows: list[str] = []
    for line in [*markdown.splitlines(), ""]:
        if line.startswith("|"):
            rows.append(line)
            continue
        if rows:
            cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
            parts.append(table(cells[0], cells[2:]))
            rows = []
        if line.startswith("#"):
            level = len(line) - len(line.lstrip("#"))
            parts.append(f"<h{level}>{_inline(line[level:])}</h{level}>")
        elif line.startswith("- "):
            parts.append(f"<ul><li>{_inline(line[2:])}</ul>")
        elif line:
            parts.append(f"<p>{_inline(line)}</p>")
    return "\n".join(parts)


def _inline(text: str) -> str:
    pieces = escaped(text).split("`")
    return "".join(f"<code>{piece}</code>" if i % 2 else piece for i, piece in enumerate(pieces))


def _failures(came: Sequence[Came]) -> str:
    failed = [one for one in came if one.outcome != "held"]
    rows = [
        (
            *(one.trial.name, f"{one.trial.tool_error_mm:g}", one.outcome, one.code),
            *(_percent(one.probability), _mm(one.error_m), one.sentence),
        )
        for one in failed[:MOST_TOLD]
    ]
    heads = ("trial", " tool error, mm", "outcome", "cause", " promised", " error at goal, mm", "in words")
    more = paragraph(f"{len(failed) - MOST_TOLD} more are in the journal.") if len(failed) > MOST_TOLD else ""
    return table(heads, rows) + more


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f} %"


def _mm(length_m: float | None) -> str:
    return "-" if length_m is None else f"{1e3 * length_m:.1f}"


def document(protocol: Protocol, every: list[Results], whole: Results) -> dict[str, Any]:
    """One entry for each size of the tool's error, and what is told of all of them."""
    return {
        "protocol": protocol.model_dump(),
        "results": [_told(results) for results in every],
        "sweep": [_sweep(sweep) for sweep in sweeps(every)],
        "reliability": {named(row): _reliability(found) for row, found in whole.reliability.items() if found},
    }


def _sweep(sweep: Sweep) -> dict[str, Any]:
    shares = [rate.share for rate in sweep.rates]
    told = {"row": named(sweep.row), "errors_mm": sweep.errors_mm, "shares": shares}
    return told | {"falls_to_95_percent_at_mm": sweep.falls_at_mm}


def _reliability(found: Reliability) -> dict[str, Any]:
    told = {"trials": found.trials, "brier": found.brier, "skill": found.skill, "worst_off": found.worst_off}
    return told | {"bins": [vars(b) for b in found.bins]}


def _told(results: Results) -> dict[str, Any]:
    names = [*results.scenarios, "total"]
    return {
        "tool_error_mm": results.tool_error_mm,
        "published_percent": {p: dict(zip(names, told, strict=True)) for p, told in results.published.items()},
        "rates": {named(row): dict(zip(names, map(_rate, rates), strict=True)) for row, rates in results.rates.items()},
        "compared": [_compared(compared) for compared in results.compared],
        "causes": {named(row): causes for row, causes in results.causes.items()},
        "declined": {named(row): codes for row, codes in results.declined.items()},
        "checks": {named(row): vars(checks) if checks else None for row, checks in results.checks.items()},
        "durations": {named(row): vars(took) if took else None for row, took in results.durations.items()},
    }


def _rate(rate: Rate) -> dict[str, Any]:
    told = {"held": rate.held, "tried": rate.tried, "declined": rate.declined, "share": rate.share}
    return told | {"95_over_threads": rate.over_threads, "95_wilson": rate.interval}


def _compared(compared: Compared) -> dict[str, Any]:
    both, first, second, neither = compared.pairs
    return {
        "first": named(compared.first),
        "second": named(compared.second),
        "pairs": {"both": both, "first_only": first, "second_only": second, "neither": neither},
        "difference": compared.difference,
        "difference_95_over_threads": compared.over_threads,
        "mcnemar_exact_p": compared.p_value,
    }
