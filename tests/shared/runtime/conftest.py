"""What is published on a rig, decoded, for tests that only look at what was said."""

import pytest

from schemas.codec import decode
from shared.runtime.taps import tap


@pytest.fixture
def heard(session):
    """What is published on a topic: a list that fills."""
    kept = []

    def listen(topic):
        messages = []
        hear = lambda tapped: messages.append(decode(topic.message, tapped.payload))  # noqa: E731
        kept.extend(tap(session, "test", (topic,), hear, lambda *_: None))
        return messages

    yield listen
    for declared in kept:
        declared.undeclare()
