"""`suturegrasp graph`: who says what to whom, as a table and as a drawing, from the registry and the topics alone.

In the drawing boxes stand below each other, arrows down on their right and up on their left.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape

from rich.table import Table

from agents.cli.on_rig import OptionalPath
from agents.cli.progress import printed
from agents.cli.whole_file import whole_file
from agents.registry import AGENTS, Kind
from schemas.topics import ANY_AGENT, TOPICS, Delivery, Topic
from shared.terminal import say

BOX_W, BOX_H, STEP = 170, 40, 74
MARGIN, LANE, FONT = 24, 36, 12
LETTER = 6.6
"""Of a letter's width, in the font that labels have."""

Arrow = tuple[str, str, str]
WIDTH = 110
BESIDE = "the viewer hears all of it, and so does the recorder but for what the table of topics says it leaves out"


@dataclass(frozen=True)
class Graph:
    """Print who says what to whom, of all kinds of agents that there are; no rig is needed (docs/architecture.md).

    Fields:
        output: a drawing of it, as SVG.
    """

    output: OptionalPath = None


@dataclass(frozen=True)
class Said:
    """A topic, who says it, and who may hear it."""

    sender: str
    topic: Topic
    hearers: tuple[str, ...]


def run(options: Graph) -> int:
    """Print the table, and draw where asked to; the exit status."""
    printed(_table(), WIDTH)
    say(BESIDE)
    if options.output is not None:
        with whole_file(options.output) as unfinished:
            unfinished.write_text(drawing(_names(), _arrows()), encoding="utf-8")
        say(f"wrote {options.output}")
    return 0


def called(kind: Kind) -> str:
    """A kind of agent as people call it."""
    return f"{kind.name} ARM" if kind.per_arm else kind.name


def all_said() -> Iterator[Said]:
    """Every topic of an agent's or of an operator's, in the order of the table; commands go to whoever answers them."""
    for topic in TOPICS:
        if topic.agent == ANY_AGENT or topic.receiver == ANY_AGENT:
            continue
        senders = [called(kind) for kind in AGENTS if topic in kind.says] or [topic.agent]
        heard = [called(kind) for kind in AGENTS if topic in (*kind.hears, *kind.answers)]
        yield Said(senders[0], topic, tuple(heard))


def _arrows() -> list[Arrow]:
    """What agents say to agents."""
    flow = [one for one in all_said() if one.sender in _names()]
    return [(one.sender, hearer, one.topic.name) for one in flow for hearer in one.hearers]


def _names() -> list[str]:
    return [called(kind) for kind in AGENTS]


def _table() -> Table:
    table = Table(box=None, pad_edge=False)
    for column in ("who", "says", "how often", "heard by"):
        table.add_column(column)
    said = list(all_said())
    senders = [*_names(), *dict.fromkeys(one.sender for one in said if one.sender not in _names())]
    for sender in senders:
        for number, one in enumerate(one for one in said if one.sender == sender):
            who = sender if number == 0 else ""
            table.add_row(who, one.topic.name, _often(one.topic), ", ".join(one.hearers) or "-")
    return table


def _often(topic: Topic) -> str:
    if topic.delivery is Delivery.COMMAND:
        return "command"
    return f"{topic.rate_hz:g} Hz" if topic.rate_hz is not None else topic.delivery.name.lower()


def drawing(names: Sequence[str], arrows: Sequence[Arrow]) -> str:
    """An SVG document.

    Args:
        names: of the boxes, from above.
        arrows: from a box, to a box, and what goes there; those of one pair share an arrow.
    """
    places = {name: number for number, name in enumerate(names)}
    labels: dict[tuple[str, str], list[str]] = {}
    for sender, hearer, what in arrows:
        labels.setdefault((sender, hearer), []).append(what)
    down = [pair for pair in labels if places[pair[0]] < places[pair[1]]]
    up = [pair for pair in labels if places[pair[0]] > places[pair[1]]]
    widest = max((LETTER * len(", ".join(told)) for told in labels.values()), default=0.0)
    left = MARGIN + LANE * (len(names) + 1) + widest
    width, height = 2 * left + BOX_W, 2 * MARGIN + STEP * (len(names) - 1) + BOX_H
    parts = [_box(name, left, MARGIN + STEP * place) for name, place in places.items()]
    for pairs, side, at in ((down, 1, left + BOX_W), (up, -1, left)):
        leaving, arriving = _ports(pairs, places, 0), _ports(pairs, places, 1)
        parts += [_arrow(labels[pair], at, side, leaving[pair], arriving[pair]) for pair in pairs]
    return "\n".join([_head(width, height), *parts, "</svg>", ""])


def _ports(pairs: Sequence[tuple[str, str]], places: dict[str, int], end: int) -> dict[tuple[str, str], float]:
    """How far down each arrow leaves or meets its box: those of one side of a box share out its height."""
    found: dict[tuple[str, str], float] = {}
    for name, place in places.items():
        mine = [pair for pair in pairs if pair[end] == name]
        here = sorted(mine, key=lambda pair: abs(places[pair[1 - end]] - place))
        # what leaves has the lower half of a box on its way down, and what comes the upper one
        half = BOX_H / 2 if (end == 0) == bool(here and places[here[0][1]] > places[here[0][0]]) else 0.0
        for number, pair in enumerate(here):
            found[pair] = MARGIN + STEP * place + half + (number + 0.5) * BOX_H / 2 / len(here)
    return found


def _arrow(told: Sequence[str], x: float, side: int, begin: float, end: float) -> str:
    far = x + side * LANE * (0.6 + abs(end - begin) / STEP)
    path = f"M {x:.0f} {begin:.1f} C {far:.0f} {begin:.1f}, {far:.0f} {end:.1f}, {x:.0f} {end:.1f}"
    at_x, at_y = x + side * (0.75 * abs(far - x) + 4), 0.5 * (begin + end) + 4
    anchor = "start" if side > 0 else "end"
    text = f'<text x="{at_x:.0f}" y="{at_y:.0f}" text-anchor="{anchor}">{escape(", ".join(told))}</text>'
    return f'<path d="{path}" marker-end="url(#head)"/>{text}'


def _box(name: str, x: float, y: float) -> str:
    middle = f'x="{x + BOX_W / 2:.0f}" y="{y + BOX_H / 2 + 4:.0f}" text-anchor="middle"'
    return (
        f'<rect x="{x:.0f}" y="{y:.0f}" width="{BOX_W}" height="{BOX_H}" rx="6"/><text {middle}>{escape(name)}</text>'
    )


def _head(width: float, height: float) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" font-family="sans-serif" '
        f'font-size="{FONT}">\n<style>rect {{ fill: #eef3f8; stroke: #456; }} path {{ fill: none; stroke: #456; }} '
        "text { fill: #123; paint-order: stroke; stroke: white; stroke-width: 3; }</style>\n"
        '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
        '<path d="M 0 0 L 8 4 L 0 8" style="fill: #456"/></marker></defs>'
    )
