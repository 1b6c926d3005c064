"""The options of `suturegrasp graph`; nothing that takes long to load."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Graph:
    """Print who says what to whom, of all kinds of agents that there are; no rig is needed (docs/architecture.md).

    Fields:
        output: a drawing of it, as SVG.
    """

    output: Path | None = None
