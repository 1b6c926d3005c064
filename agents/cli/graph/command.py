"""`suturegrasp graph`: the dataflow as a table and as a drawing, from the registry and the table of topics alone."""

from collections.abc import Iterator
from dataclasses import dataclass

from rich.console import Console
from rich.table import Table

from agents.cli.graph.drawing import Arrow, drawing
from agents.cli.graph.options import Graph
from agents.cli.whole_file import OutputError, whole_file
from agents.launch.process import EXIT_OK, EXIT_UNUSABLE
from agents.registry import AGENTS, Kind
from schemas.topics import ANY_AGENT, TOPICS, Delivery, Topic
from shared.terminal import complain, say, show

WIDTH = 110
BESIDE = "the viewer hears all of it, and so does the recorder but for what the table of topics says it leaves out"


@dataclass(frozen=True)
class Said:
    """A topic, who says it, and who may hear it."""

    sender: str
    topic: Topic
    hearers: tuple[str, ...]


def run(options: Graph) -> int:
    """Print the table, and draw where asked to; the exit status."""
    console = Console(width=WIDTH, color_system=None)
    with console.capture() as capture:
        console.print(_table())
    for line in capture.get().splitlines():
        show(line.rstrip())
    say(BESIDE)
    if options.output is None:
        return EXIT_OK
    try:
        with whole_file(options.output) as unfinished:
            unfinished.write_text(drawing(_names(), _arrows()))
    except (OutputError, OSError) as error:
        return complain(str(error), EXIT_UNUSABLE)
    say(f"wrote {options.output}")
    return EXIT_OK


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
