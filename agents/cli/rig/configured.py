"""Which agents a rig's configuration has; nothing of theirs is loaded."""

from agents.cli.rig.config import RigConfig
from agents.cli.rig.hosts import run_name
from agents.registry import NAMES
from schemas.topics import MAIN

KINDS = NAMES


def configured(rig: RigConfig) -> list[tuple[str, str]]:
    """Kind and instance of every agent that is to run on this machine, in the order of the dataflow."""
    sections = [(kind, MAIN) for kind in KINDS if kind != "robot_bridge" and getattr(rig, kind) is not None]
    tracked = rig.perception.track_tool if rig.perception is not None else ()
    agents = [*sections, *(("perception", arm) for arm in tracked), *(("robot_bridge", arm) for arm in rig.robot)]
    return [(kind, instance) for kind, instance in agents if rig.runs_here(run_name(kind, instance))]
