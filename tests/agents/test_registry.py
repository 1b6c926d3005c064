"""The rows of the registry say of agents what the agents say of themselves."""

import pytest

from agents.registry import kind_of
from schemas.topics import ANY_AGENT
from tests.whole_rig import agents_of, whole_rig


@pytest.mark.parametrize("agent", agents_of(whole_rig(("psm1",))), ids=lambda agent: agent.kind)
def test_a_row_says_what_its_agent_hears_says_and_answers(agent):
    kind = kind_of(agent.kind)
    assert kind is not None
    assert {heard.topic for heard in agent.inputs if heard.topic.agent != ANY_AGENT} == set(kind.hears)
    assert set(agent.outputs) <= set(kind.says)
    assert set(agent.commands) == set(kind.answers)
