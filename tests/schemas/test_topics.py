"""The topic table and the agents agree: whatever is listened to is published, by one agent, under its own root."""

import itertools

import pytest

import schemas.messages
from agents.camera.agent import Camera
from schemas.checks import fields_of
from schemas.topics import ANY_AGENT, CLOCKS, HEALTH, MAIN, SET, TOPICS, Delivery, key, topic_of
from tests.whole_rig import ARMS, agents_of, whole_rig

AGENTS = [Camera, *agents_of(whole_rig())]
every_agent = pytest.mark.parametrize("agent", AGENTS, ids=lambda a: f"{a.kind}-{a.instance}-{AGENTS.index(a)}")
BESIDE_THE_AGENTS = ("operator", "replay")
"""Publish, and are no agents: a person's commands, and a replay."""


def outputs_of(agent):
    """What an agent publishes; its runner watches clocks for it."""
    return (*agent.outputs, CLOCKS) if agent.watches_clocks else agent.outputs


def published(agent):
    """The keys under which an agent publishes."""
    instances = {topic: agent.instance if topic.per_arm else MAIN for topic in outputs_of(agent)}
    return {key("lab", topic, instance) for topic, instance in instances.items()}


def matches(wanted, found):
    return all(w in ("*", f) for w, f in zip(wanted.split("/"), found.split("/"), strict=True))


@every_agent
def test_every_input_has_a_producer_and_is_listened_to_as_its_delivery_and_its_arm_allow(agent):
    everything = set().union(*(published(other) for other in AGENTS))
    for wanted in agent.inputs:
        topic, pattern = wanted.topic, key("lab", wanted.topic, wanted.instance)
        assert any(topic is row for row in TOPICS)
        beside = topic.agent in BESIDE_THE_AGENTS
        assert beside or any(matches(pattern, found) for found in everything), f"nobody publishes {pattern}"
        assert topic.delivery is not Delivery.COMMAND
        assert not wanted.only_newest_counts or topic.delivery is not Delivery.EVENT
        assert not wanted.only_remembered or (wanted.only_newest_counts and topic.delivery is Delivery.LATEST)
        assert wanted.instance in ((agent.instance, "*") if topic.per_arm else (MAIN,))
        # one arm's agent listens to its own arm
        assert not (agent.instance in ARMS and wanted.instance == "*")


@every_agent
def test_every_output_lies_under_its_agents_root_and_lists_what_it_was_made_from(agent):
    for topic in agent.outputs:
        assert topic.agent == agent.kind
        assert topic.delivery is not Delivery.COMMAND
        assert "consumed" in fields_of(topic.message)
    assert (agent.instance in ARMS) == any(topic.per_arm for topic in agent.outputs)


def test_every_command_has_one_receiver_which_answers_it():
    for topic in TOPICS:
        if topic.delivery is not Delivery.COMMAND:
            assert topic.receiver == ""
        elif topic is SET:
            assert (topic.agent, topic.receiver) == (ANY_AGENT, ANY_AGENT)
        else:
            answering = [agent for agent in AGENTS if topic in agent.commands]
            assert len(answering) == (len(ARMS) if topic.per_arm else 1)
            assert {agent.kind for agent in answering} <= {topic.receiver}
            assert topic.agent == "operator"


def test_every_topic_of_an_agent_is_published_by_it_and_by_nobody_else():
    for one, other in itertools.combinations(AGENTS[1:], 2):
        assert not published(one) & published(other)
    for topic in TOPICS:
        if topic.delivery is not Delivery.COMMAND and topic.agent not in (*BESIDE_THE_AGENTS, ANY_AGENT):
            assert {agent.kind for agent in AGENTS if topic in outputs_of(agent)} == {topic.agent}


def test_a_key_leads_back_to_its_topic_and_one_outside_the_table_is_named():
    for topic in TOPICS:
        for instance in ARMS if topic.per_arm else (MAIN,):
            for agent in ("camera", "robot_bridge", "planner") if topic.agent == ANY_AGENT else ("",):
                assert topic_of(key("lab", topic, instance, agent)) is topic
    assert key("lab", HEALTH, agent="camera") == "suturegrasp/lab/camera/main/health"
    for foreign in ("", "suturegrasp/lab/camera/main/frame", "suturegrasp/lab/planner/main/frames",
                    "suturegrasp/lab/camera/main/frames/left", "other/lab/camera/main/frames"):  # fmt: skip
        with pytest.raises(KeyError, match="no topic of the table has the key"):
            topic_of(foreign)


@pytest.mark.parametrize("topic", TOPICS, ids=str)
def test_a_topic_carries_a_message_of_the_schema_is_not_stale_between_two_and_is_recorded(topic):
    assert getattr(schemas.messages, topic.message.__name__) is topic.message
    fields = fields_of(topic.message)
    assert (topic.delivery is Delivery.COMMAND) == ("header" in fields)
    assert not topic.per_arm or "arm" in fields
    assert (topic.rate_hz is not None) == (topic.delivery is Delivery.LATEST) or topic.agent == "replay"
    if topic.maximum_age_ms is not None and topic.rate_hz is not None:
        assert topic.maximum_age_ms >= 2 * 1e3 / topic.rate_hz
    # what a replay needs is recorded
    assert topic.recorded == (str(topic) != "replay/clock")
