"""The tail of a thread that is pulled as Rerun shows it, in millimetres in the left camera's frame.

world/tail/{arm}            free end, exit and entry, each a ball of two deviations, with how it is seen
tail/length_mm/{arm}        its length over time, both ends of its interval, and the length that was asked for
tail/ran_mm/{arm}           how much shorter it became, and by how much it should have by what the jaws took
lanes/{arm}/tail            whether thread runs, or why not
"""

import numpy as np
import rerun as rr

from agents.viewer.entity import MM_PER_METRE, Entity
from agents.viewer.session_mapping import lane, said
from schemas.messages import Status, Tail

LENGTHS, RUNS = ("length", "at least", "at most", "asked for"), ("tail", "jaws")
SIGMAS = 2.0
LEAST_MM = 0.3
"""Of a ball that is still seen."""


def tail_entities(tail: Tail) -> list[Entity]:
    """The tail in one frame; one that was not measured leaves no curve there, and says why."""
    arm = rr.escape_entity_path_part(tail.arm)
    state = "unseen" if tail.status is not Status.OK else tail.stop.name.lower() if tail.stop else "runs"
    entities = [lane(f"{arm}/tail", state)]
    if tail.tail is None:
        return [*entities, said("planner", f"tail not measured: {tail.reason}", rr.TextLogLevel.WARN)]
    low_m, high_m = tail.tail.interval_m
    lengths = MM_PER_METRE * np.array([tail.tail.length_m, low_m, np.nan if high_m is None else high_m, tail.tail_m])
    names = [rr.SeriesLines(names=list(LENGTHS)), rr.Scalars(lengths)]
    entities.append((f"tail/length_mm/{arm}", names))
    if tail.ran_m is not None and tail.travelled_m is not None:
        ran = MM_PER_METRE * np.array([tail.ran_m, tail.travelled_m])
        entities.append((f"tail/ran_mm/{arm}", [rr.SeriesLines(names=list(RUNS)), rr.Scalars(ran)]))
    ends = {"free end": tail.free_end, "exit": tail.exit, "entry": tail.entry}
    seen = {name: end for name, end in ends.items() if end is not None}
    wide = [SIGMAS * MM_PER_METRE * np.sqrt(np.linalg.eigvalsh(end.covariance)[-1]) for end in seen.values()]
    balls = rr.Points3D(
        [MM_PER_METRE * end.point_camera for end in seen.values()],
        radii=np.maximum(wide, LEAST_MM),
        labels=[f"{name}, {end.sight.name.lower().replace('_', ' ')}" for name, end in seen.items()],
    )
    entities.append((f"world/tail/{arm}", [balls]))
    if tail.stop is not None:
        entities.append(said("planner", f"{tail.stop.name.lower()}: {tail.sentence}", rr.TextLogLevel.WARN))
    return entities
