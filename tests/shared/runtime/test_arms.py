"""What a message says of an arm, and the key that it came under."""

from types import SimpleNamespace

import pytest

from schemas.checks import MessageError
from schemas.topics import HEARTBEAT, PLAN, ROBOT_STATE, TOPICS, Delivery, key
from shared.runtime.arms import check_arm


@pytest.mark.parametrize("topic", [t for t in TOPICS if t.per_arm and t.delivery is not Delivery.COMMAND], ids=str)
def test_an_arm_is_spoken_of_under_its_own_key_alone(topic):
    check_arm(topic, key("lab", topic, "psm1"), SimpleNamespace(arm="psm1"))
    with pytest.raises(MessageError, match="speaks of the arm 'psm1' under the key of psm2"):
        check_arm(topic, key("lab", topic, "psm2"), SimpleNamespace(arm="psm1"))


def test_some_topics_there_are_once_per_arm():
    assert {ROBOT_STATE, HEARTBEAT} <= {t for t in TOPICS if t.per_arm}


def test_a_plan_names_its_arm_by_itself():
    check_arm(PLAN, key("lab", PLAN), SimpleNamespace(arm="psm2"))
