"""Rigs whose router is behind a link that is too narrow for them: what is lost first."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from agents.cli.lab.rehearsal.network import connected_hosts
from benchmarks.scaling_rigs import TLS, Place, measure

ROUTER, RIGS = "router", "rigs"


def measure_narrow(rigs: Iterable[int], megabits: int, seconds: float, folder: Path) -> list[dict[str, Any]]:
    """As `measure`, encrypted, between two namespaces whose link carries so much each way.

    Raises:
        CannotError: where this system makes no such network.
    """
    rows: list[dict[str, Any]] = []
    with connected_hosts((ROUTER, RIGS)) as network, network.narrowed(megabits, (ROUTER,)):
        place = Place(network.address(ROUTER), network.inside(ROUTER), network.inside(RIGS))
        for count in rigs:
            rows.append(measure(TLS, count, seconds, folder / str(count), place) | {"megabits": megabits})
    return rows
