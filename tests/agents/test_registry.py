"""The rows of the registry say of agents what the agents say of themselves."""

import pytest

from agents.cli.demo.command import demo_rig
from agents.cli.live.options import Demo
from agents.cli.rig.builders import build
from agents.cli.rig.config import RigConfig
from agents.registry import AGENTS
from schemas.topics import ANY_AGENT, MAIN

ARM = "psm1"


def rig():
    told = demo_rig(Demo(seed=1)).model_dump(mode="json")
    told["robot"][ARM]["correction"] = "tool_tracker"
    told["tool_tracker"] = {ARM: {}}
    told["needle"] = {}
    return RigConfig.model_validate(told)


@pytest.mark.parametrize("kind", AGENTS, ids=lambda kind: kind.name)
def test_a_row_says_what_its_agent_hears_says_and_answers(kind):
    agent = build(rig(), kind.name, ARM if kind.per_arm else MAIN)
    assert {heard.topic for heard in agent.inputs if heard.topic.agent != ANY_AGENT} == set(kind.hears)
    assert set(agent.outputs) <= set(kind.says)
    assert set(agent.commands) == set(kind.answers)
