"""What a rig's file may do otherwise with topics than their table says, and that its processes do it."""

import json
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from agents.configuration.digest import rig_sections
from agents.configuration.reading_session import session_as
from agents.configuration.rig import RigConfig
from agents.configuration.topics import in_words, overrides
from agents.launch.agent_process import surroundings
from schemas.topics import (
    COMMANDS,
    HEALTH,
    HEARTBEAT,
    LOG,
    OBSERVATIONS,
    PLAN,
    ROBOT_STATE,
    TOPICS,
    Delivery,
    Priority,
    key,
)
from shared.runtime.config import ConfigError, parse_config
from shared.runtime.connection import connected
from shared.runtime.delivery import RouterLinks, as_told

SCRIPT = str(Path(sys.executable).with_name("suturegrasp"))

TOLD = '[topics."perception/observations"]\npriority = "data_low"\n[topics."*/log"]\nkept = 5000\nrecorded = false\n'
MISTAKES = {
    '[topics."perception/observation"]\nrecorded = false': "did you mean perception/observations? known are",
    '[topics."*/log"]\nkeep = 5000': "topics.*/log.keep is unknown; did you mean kept?",
    '[topics."*/log"]': "it says nothing; set recorded, priority, kept, or leave the section out",
    '[topics."perception/observations"]\npriority = "low"': "it must be 'real_time', 'data_high', 'data', 'data_low'",
    '[topics."*/log"]\nkept = 200000': "it must be less than or equal to 100000",
    '[topics."robot_bridge/execution"]\nkept = 999': "with fewer than 1000 a router's restart could lose events of",
    '[topics."robot_bridge/execution"]\npriority = "background"': "an event waits for the network",
    '[topics."operator/hold"]\npriority = "data"': "a command waits for the network",
    '[topics."operator/hold"]\nrecorded = false': "as its receiver tells it, as */command; set it there",
    '[topics."camera/frames"]\nkept = 2000': "only events are kept for those who were away (planner/plan,",
}


def rig(text):
    return parse_config(text, RigConfig, "rig.toml")


@pytest.mark.parametrize("text", MISTAKES, ids=list(MISTAKES.values()))
def test_what_a_rig_may_not_say_of_a_topic_is_one_sentence(text):
    with pytest.raises(ConfigError) as caught:
        rig(text)
    assert MISTAKES[text] in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_rig_has_what_moves_a_robot_wait_or_kept_for_less_long():
    for topic in TOPICS:
        told = [f"kept = {kept}" for kept in (0, 1, topic.kept - 1)]
        if topic.delivery is not Delivery.LATEST:
            told += [f'priority = "{priority.value}"' for priority in Priority]
        elif topic in (ROBOT_STATE, HEARTBEAT):
            told += [f'priority = "{priority.value}"' for priority in Priority if priority is not topic.priority]
        for line in told:
            with pytest.raises(ConfigError):
                rig(f'[topics."{topic}"]\n{line}')


def test_what_is_told_otherwise_reaches_every_process_of_the_rig():
    told = rig(f"{TOLD}[camera]\n[robot.psm1]\n")
    sessions = (told.session, told.session_of("recorder"), session_as(told, "camera.main"))
    for rows in (told.rows_otherwise, *(session.otherwise for session in sessions)):
        assert as_told(OBSERVATIONS, rows).priority is Priority.DATA_LOW
        assert as_told(LOG, rows).kept == 5000
        assert as_told(PLAN, rows) is PLAN
    around = surroundings(told, "camera", "main")
    assert (around.overrides, around.rig_sections) == (told.overrides, rig_sections(told))
    assert tuple(map(in_words, told.overrides)) == (
        "perception/observations priority data_low", "*/log recorded false", "*/log kept 5000",
    )  # fmt: skip


def test_what_is_said_as_the_table_has_it_is_no_override():
    assert overrides(rig('[topics."*/command"]\nkept = 1000\nrecorded = true').topics) == ()
    (one,) = overrides(rig('[topics."*/command"]\nkept = 1001').topics)
    assert (one.topic, one.setting, one.value, one.table) == (str(COMMANDS), "kept", 1001, COMMANDS.kept)


def test_an_agents_publishers_have_the_priority_that_its_rig_says(session):
    for text, priority in ((TOLD, "Priority.DATA_LOW"), ("", "Priority.REAL_TIME")):
        links = RouterLinks(rig(text).rows_otherwise)
        publisher = links.publisher(session, key("test", OBSERVATIONS), OBSERVATIONS)
        assert str(publisher.priority) == priority
        publisher.undeclare()


@pytest.mark.rig
def test_a_process_of_a_rig_publishes_as_its_file_says_and_doctor_and_status_tell_of_it(
    settings, session, suturegrasp, tmp_path, until
):
    plain = f'rig = "test"\n[router]\nendpoint = "{settings.endpoint}"\nstart = false\n[planner]\n'
    here, there = tmp_path / "here.toml", tmp_path / "there.toml"
    here.write_text(plain)
    there.write_text(f'{plain}attempts = 2\n[topics."*/health"]\npriority = "background"\n')
    priorities = []
    heard = session.declare_subscriber(
        key("test", HEALTH, "main", "planner"), lambda sample: priorities.append(str(sample.priority))
    )
    process = subprocess.Popen([SCRIPT, "run", "planner", "--config", str(there)], stderr=subprocess.DEVNULL)
    try:
        until(lambda: priorities, "health of the planner")
        with connected(settings, 60.0) as connection:
            until(connection.facts, "facts of the planner")
        agree = suturegrasp("doctor", "--config", there)
        differ = suturegrasp("doctor", "--config", here)
        told = json.loads(suturegrasp("status", "--once", "--json", "--config", here).out)
    finally:
        process.terminate()
        process.wait(60)
    heard.undeclare()
    assert set(priorities) == {"Priority.BACKGROUND"}
    assert "topics: otherwise than the table: */health priority background (the table: real_time)" in agree.out
    assert "topics of planner" not in agree.out
    assert "WRONG topics of planner: planner began with another file of the rig" in differ.out
    assert "file of the rig: every agent began with the same as here" in agree.out
    assert f"planner on {socket.gethostname()} began with another file of the rig" in differ.out
    assert "file" in [wrong["code"] for wrong in told["wrong"]]
    assert ("topics", "planner") in [(wrong["code"], wrong["about"]) for wrong in told["wrong"]]
    (override,) = told["agents"][0]["facts"]["overrides"]
    assert override == {"topic": "*/health", "setting": "priority", "value": "background"}
