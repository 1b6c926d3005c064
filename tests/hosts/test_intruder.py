"""Intruders on a secured rig of real processes; `python -m tests.rigs.intruder.attacked` sends many more messages."""

import pytest

from schemas.topics import TOPICS, Delivery
from tests.rigs.intruder.attacked import Options, attacked
from tests.rigs.intruder.rig import CannotError

# what it takes to start all processes, and to wait for a plan, may both fall to one test
pytestmark = [pytest.mark.hosts, pytest.mark.timeout(600)]
MESSAGES = 2000


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    """What became of every attack, by its name."""
    try:
        found, notes = attacked(tmp_path_factory.mktemp("intruder"), Options(MESSAGES, links=2, huge=False))
    except CannotError as error:
        pytest.skip(str(error))
    print(*notes, sep="\n")
    return {row.attack: row for row in found}


def test_links_without_a_certificate_of_the_lab_are_refused_and_told(rows):
    links = [row for name, row in rows.items() if name.startswith("link: ")]
    assert len(links) == 4
    assert [(row.delivered, row.refused) for row in links] == [(0, row.sent) for row in links]


def test_with_another_agents_certificate_nothing_is_delivered(rows):
    barred = {name: row.delivered for name, row in rows.items() if row.barred}
    assert len(barred) == 10
    assert not any(barred.values()), barred


def test_every_malformed_message_is_accounted_for_by_each_consumer_and_by_the_recorder(rows):
    accounts = {name: row for name, row in rows.items() if name.startswith("malformed ") and " at " in name}
    assert {name: row.unaccounted for name, row in accounts.items() if row.unaccounted} == {}
    assert sum(row.refused for row in accounts.values()) > 0
    assert rows["malformed, all topics, at the recorder"].sent > MESSAGES // 2


def test_every_malformed_command_is_answered(rows):
    commands = {str(topic) for topic in TOPICS if topic.delivery is Delivery.COMMAND}
    answered = {name: row for name, row in rows.items() if name.startswith("malformed ") and " to " in name}
    assert {name.split()[1] for name in answered} == commands
    assert {name: row.unaccounted for name, row in answered.items() if row.unaccounted} == {}


def test_nothing_ends_or_hangs_and_a_goal_gets_its_plan_afterwards(rows):
    assert not any(row.crashed for row in rows.values())
    assert rows["afterwards: a goal gets its plan"].delivered == 1
