"""A simulated rig with every kind of agent, from the registry, and its agents."""

from agents.configuration.rig import RigConfig, simulated_rig
from agents.launch.builders import build
from agents.registry import AGENTS
from schemas.topics import MAIN

ARMS = ("psm1", "psm2")


def whole_rig(arms=ARMS):
    """With these arms, whose tools are tracked and which their trackers correct."""
    told = simulated_rig().model_dump(mode="json", exclude_unset=True)
    for kind in AGENTS:
        if kind.per_arm:
            told[kind.section] = {arm: {} for arm in arms}
        else:
            told[kind.section] = told.get(kind.section) or {}
    for arm in arms:
        told["robot"][arm]["correction"] = "tool_tracker"
    return RigConfig.model_validate(told)


def agents_of(rig):
    """Every agent of a rig, as its processes are made."""
    arms = {kind: rig.arms_of(kind) if kind.per_arm else (MAIN,) for kind in AGENTS}
    return [build(rig, kind.name, instance) for kind in AGENTS for instance in arms[kind]]
