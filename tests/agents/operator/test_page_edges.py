"""What comes from a browser at its edge: messages, links, secrets, addresses."""

import json

import pytest

from agents.operator.page_server import MOST_SESSIONS, Access, Addresses
from agents.operator.wire import Click, HoldAll, PromptAt, WireError, parsed

LOCAL = Addresses("http", ("127.0.0.1:7450", "localhost:7450"))


def test_messages_of_pages_are_read():
    click = {"kind": "click", "frame": 3, "pixel": [1, 2.5], "arm": "psm1", "policy": "robust"}
    assert parsed(json.dumps(click)) == Click(3, (1.0, 2.5), "psm1", "robust")
    assert parsed('{"kind": "hold"}') == HoldAll()
    assert parsed('{"kind": "prompt", "pixel": null}') == PromptAt(None)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[" * 100_000,
        '{"kind": "arm"}',
        '{"kind": "hold", "more": 1}',
        '{"kind": "press", "arm": 1, "plan_id": "p"}',
        '{"kind": "press", "arm": "psm1", "plan_id": "' + 300 * "x" + '"}',
        '{"kind": "click", "frame": -1, "pixel": [1, 2], "arm": "a", "policy": "b"}',
        '{"kind": "click", "frame": 1, "pixel": [1], "arm": "a", "policy": "b"}',
        '{"kind": "prompt", "pixel": [1e999, 1]}',
        '{"kind": "place", "s": true, "arm": "a", "policy": "b"}',
        '{"kind": "place", "s": 1' + 400 * "0" + ', "arm": "a", "policy": "b"}',
        '{"kind": ["hold"]}',
    ],
)
def test_what_no_page_sends_is_refused(text):
    with pytest.raises(WireError):
        parsed(text)


def there(value):
    """What must not be None."""
    assert value is not None
    return value


def test_a_link_works_once_and_the_next_is_told():
    told = []
    access = Access(changed=told.append)
    first = access.link
    assert access.exchange("") is None
    assert access.exchange(first + "x") is None
    assert access.exchange(first) is not None
    assert access.exchange(first) is None
    assert told == [access.link]
    assert access.link != first


def test_each_use_of_a_secret_ends_it_and_gives_the_next_and_screens_that_were_away_longest_are_forgotten():
    access = Access()
    secret = there(access.exchange(access.link))
    name, second = there(access.enter(secret))
    assert access.enter(secret) is None
    again, third = there(access.enter(second))
    assert (name, again) == ("screen 1", "screen 1")
    assert access.enter("\ud800") is None
    assert len({secret, second, third}) == 3
    later = [there(access.exchange(access.link)) for _ in range(MOST_SESSIONS)]
    assert access.enter(third) is None
    assert access.enter(later[0]) is not None


@pytest.mark.parametrize(
    ("headers", "ours", "from_us"),
    [
        ({"Host": "127.0.0.1:7450", "Origin": "http://127.0.0.1:7450"}, True, True),
        ({"Host": "LOCALHOST:7450", "Origin": "http://localhost:7450", "Sec-Fetch-Site": "same-origin"}, True, True),
        ({"Host": "127.0.0.1:7450"}, True, False),
        ({"Host": "127.0.0.1:7450", "Origin": "null"}, True, False),
        ({"Host": "127.0.0.1:7450", "Origin": "http://evil.example"}, True, False),
        ({"Host": "127.0.0.1:7450", "Origin": "https://127.0.0.1:7450"}, True, False),
        ({"Host": "127.0.0.1:7450", "Origin": "http://127.0.0.1:7450", "Sec-Fetch-Site": "cross-site"}, True, False),
        ({"Host": "rebound.example:7450", "Origin": "http://rebound.example:7450"}, False, False),
        ({}, False, False),
    ],
)
def test_only_the_page_itself_at_an_address_of_its_own_gets_in(headers, ours, from_us):
    assert LOCAL.is_ours(headers) is ours
    assert LOCAL.is_from_us(headers) is from_us
