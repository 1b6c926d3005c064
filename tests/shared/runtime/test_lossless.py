"""A cache that lacks at first what is asked for, behind a real router: it is asked again."""

import pytest
import zenoh
from zenoh import ext

from schemas.topics import PLAN, key
from shared.runtime.delivery import subscribe
from shared.runtime.lossless import _place_of
from shared.runtime.session import open_session


@pytest.fixture
def unheard(session):
    """A publisher whose messages come to nothing on their way; only its cache can be asked for them."""
    publisher = ext.declare_advanced_publisher(
        session,
        key("test", PLAN),
        cache=ext.CacheConfig(1000),
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.1),
        publisher_detection=True,
        allowed_destination=zenoh.Locality.SESSION_LOCAL,
    )
    yield publisher
    publisher.undeclare()


def test_what_came_to_nothing_is_asked_for_until_the_cache_has_it_and_handed_over_in_order(
    session, settings, unheard, until
):
    samples, missed = [], []
    with open_session(settings) as receiver:
        kept = subscribe(receiver, key("test", PLAN), PLAN, samples.append, missed.append)

        def numbers():
            return [int(sample.payload.to_string()) for sample in samples]

        for number in range(5):
            unheard.put(str(number))
        # the token or a heartbeat tells that there is something
        until(lambda: numbers() == list(range(5)))
        of = samples[-1].source_info.source_id
        # a message overtakes two that its publisher's cache does not have yet either
        session.put(key("test", PLAN), "7", source_info=zenoh.SourceInfo(of, 7))
        session.put(key("test", PLAN), "2", source_info=zenoh.SourceInfo(of, 2))
        for number in (5, 6):
            unheard.put(str(number))
        until(lambda: len(samples) == 8)
        assert numbers() == list(range(8))
        assert missed == []
        for declared in kept:
            declared.undeclare()


def test_a_message_of_another_topic_under_the_key_of_a_heartbeat_tells_no_number():
    told = f"{key('test', PLAN)}/@adv/pub/abc/3"
    assert _place_of(f"{told}/_") == (key("test", PLAN), "abc", 3)
    for foreign in (f"{told}/_/main/command", f"{told}/main", key("test", PLAN)):
        assert _place_of(foreign) is None
