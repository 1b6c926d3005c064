"""The report of an evaluation: one HTML file with tables, diagrams and pictures in it."""

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass

from agents.evaluation.came import Came
from agents.evaluation.charts import reliability_chart, sweep_chart
from agents.evaluation.protocol import Protocol
from agents.evaluation.results import Results
from agents.evaluation.sweep import sweeps
from agents.evaluation.table import named, overview

STYLE = """
body{font:15px/1.45 system-ui,sans-serif;margin:2em auto;max-width:1250px;padding:0 1em;color:#222}
table{border-collapse:collapse;margin:.6em 0;font-size:13px}td,th{border:1px solid #ccc;padding:.25em .5em}
th{background:#f3f3f3}figure{display:inline-block;margin:.5em;vertical-align:top}figcaption{max-width:600px;font-size:13px}
code{background:#f3f3f3;padding:0 .2em}img{max-width:600px;width:100%}
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
        f"<!doctype html><html lang=en><meta charset=utf-8><title>Grasping</title><style>{STYLE}</style>",
        "<h1>Grasping, from images to lifted thread, simulated</h1>",
        as_html(overview(protocol, every, whole)),
        "<h2>Diagrams</h2>",
        *([_figure(sweep_chart(found), "Success over the tool's error; dashed: 95 %.")] if found else []),
        *(
            _figure(reliability_chart(one), f"Promised and held: {named(row)}. Areas tell how many trials.")
            for row, one in whole.reliability.items()
            if one is not None
        ),
        "<h2>Where grasps failed</h2>",
        _failures(came),
        "<h2>Fields</h2><p>Goals as dots: green held, red failed, grey declined; a line leads from the capture.</p>",
        *(_figure(_image(picture), html.escape(picture.caption)) for picture in pictures),
        "</html>",
    ]
    return "\n".join(parts) + "\n"


def as_html(markdown: str) -> str:
    """The little Markdown that our pages use: headings, tables, lists and `code`."""
    parts: list[str] = []
    rows: list[str] = []
    for line in [*markdown.splitlines(), ""]:
        if line.startswith("|"):
            rows.append(line)
            continue
        if rows:
            parts.append(_table(rows))
            rows = []
        if line.startswith("#"):
            level = len(line) - len(line.lstrip("#"))
            parts.append(f"<h{level}>{_inline(line[level:])}</h{level}>")
        elif line.startswith("- "):
            parts.append(f"<ul><li>{_inline(line[2:])}</ul>")
        elif line:
            parts.append(f"<p>{_inline(line)}</p>")
    return "\n".join(parts)


def _table(rows: list[str]) -> str:
    cells = [[_inline(cell.strip()) for cell in row.strip("|").split("|")] for row in rows]
    head = "".join(f"<th>{cell}" for cell in cells[0])
    body = "".join(f"<tr>{''.join(f'<td>{cell}' for cell in row)}" for row in cells[2:])
    return f"<table><tr>{head}{body}</table>"


def _inline(text: str) -> str:
    pieces = html.escape(text.strip()).split("`")
    return "".join(f"<code>{piece}</code>" if i % 2 else piece for i, piece in enumerate(pieces))


def _failures(came: Sequence[Came]) -> str:
    failed = [one for one in came if one.outcome != "held"]
    rows = "".join(
        f"<tr><td>{html.escape(one.trial.name)}<td>{one.trial.tool_error_mm:g}<td>{one.outcome}<td>"
        f"{html.escape(one.code)}<td>{_percent(one.probability)}<td>{_mm(one.error_m)}<td>{html.escape(one.sentence)}"
        for one in failed[:MOST_TOLD]
    )
    more = f"<p>{len(failed) - MOST_TOLD} more are in the journal.</p>" if len(failed) > MOST_TOLD else ""
    head = "<tr><th>trial<th>tool error, mm<th>outcome<th>cause<th>promised<th>error at goal, mm<th>in words"
    return f"<table>{head}{rows}</table>{more}"


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f} %"


def _mm(length_m: float | None) -> str:
    return "-" if length_m is None else f"{1e3 * length_m:.1f}"


def _figure(content: str, caption: str) -> str:
    return f"<figure>{content}<figcaption>{caption}</figcaption></figure>"


def _image(picture: Picture) -> str:
    data = base64.b64encode(picture.data).decode()
    return f'<img alt="" src="data:{picture.mime};base64,{data}">'
