"""`suturegrasp graph`: who says what to whom, from the registry and the table of topics alone."""

from collections.abc import Iterator
from dataclasses import dataclass

from rich.table import Table

from agents.cli.on_rig import OptionalPath
from agents.cli.progress import printed
from agents.cli.whole_file import whole_file
from agents.registry import AGENTS, Kind
from schemas.topics import ANY_AGENT, TOPICS, Delivery, Topic
from shared.terminal import say

WIDTH = 110
BESIDE = "the viewer hears all of it, and so does the recorder but for what the table of topics says it leaves out"


@dataclass(frozen=True)
class Graph:
    """Print who says what to whom, of all kinds of agents that there are; no rig is needed (docs/architecture.md).

    Fields:
        output: a drawing of it, for Graphviz (dot -Tsvg).
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
            unfinished.write_text(drawing(), encoding="utf-8")
        say(f"wrote {options.output}")
    return 0


def drawing() -> str:
    """What agents say to agents, in the language of Graphviz; what goes from one to another shares an arrow."""
    labels: dict[tuple[str, str], list[str]] = {}
    for one in all_said():
        for hearer in one.hearers if one.sender in _names() else ():
            labels.setdefault((one.sender, hearer), []).append(one.topic.name)
    arrows = [f'  "{a}" -> "{b}" [label="{", ".join(told)}"]' for (a, b), told in labels.items()]
    return "\n".join(["digraph {", "  node [shape=box]", *(f'  "{name}"' for name in _names()), *arrows, "}", ""])


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
