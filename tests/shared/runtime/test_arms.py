"""What a message says of an arm, and the key that it came under."""

from types import SimpleNamespace

import pytest

from schemas.checks import MessageError
from schemas.topics import HEARTBEAT, PLAN, ROBOT_STATE, TOPICS, Delivery, key
from shared.runtime.runner import check_arm

PER_ARM = [topic for topic in TOPICS if topic.per_arm and topic.delivery is not Delivery.COMMAND]


def test_an_arm_is_spoken_of_under_its_own_key_alone_and_a_plan_names_its_arm_by_itself():
    assert {ROBOT_STATE, HEARTBEAT} <= set(PER_ARM)
    for topic in PER_ARM:
        check_arm(topic, key("lab", topic, "psm1"), SimpleNamespace(arm="psm1"))
        with pytest.raises(MessageError, match="speaks of the arm 'psm1' under the key of psm2"):
            check_arm(topic, key("lab", topic, "psm2"), SimpleNamespace(arm="psm1"))
    check_arm(PLAN, key("lab", PLAN), SimpleNamespace(arm="psm2"))
