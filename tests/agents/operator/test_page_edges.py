"""What comes from a browser at its edge: messages, links, secrets, addresses."""

import contextlib
import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.operator.access import MOST_SESSIONS, Access, Addresses
from agents.operator.wire import KINDS, Click, HoldAll, Press, PromptAt, WireError, parsed

LOCAL = Addresses("http", ("127.0.0.1:7450", "localhost:7450"))
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)


def test_messages_of_pages_are_read():
    click = {"kind": "click", "frame": 3, "pixel": [1, 2.5], "arm": "psm1", "policy": "robust"}
    assert parsed(json.dumps(click)) == Click(3, (1.0, 2.5), "psm1", "robust")
    assert parsed('{"kind": "hold"}') == HoldAll()
    assert parsed('{"kind": "prompt", "pixel": null}') == PromptAt(None)
    assert parsed('{"kind": "press", "arm": "psm1", "plan_id": "plan-1"}') == Press("psm1", "plan-1")


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


@settings(max_examples=20)
@given(st.sampled_from(sorted(KINDS)), st.dictionaries(st.sampled_from(["arm", "pixel", "s", "frame", "yes"]), JSON))
def test_any_fields_of_a_kind_are_a_message_or_refused(kind, fields):
    with contextlib.suppress(WireError):
        assert isinstance(parsed(json.dumps({"kind": kind} | fields)), KINDS[kind])


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


def there(value):
    """What must not be None."""
    assert value is not None
    return value


def test_each_use_of_a_secret_ends_it_and_gives_the_next():
    access = Access()
    secret = there(access.exchange(access.link))
    name, second = there(access.enter(secret))
    assert access.enter(secret) is None
    again, third = there(access.enter(second))
    assert (name, again) == ("screen 1", "screen 1")
    assert access.enter("\ud800") is None
    assert len({secret, second, third}) == 3


def test_screens_that_were_away_longest_are_forgotten():
    access = Access()
    secrets = [there(access.exchange(access.link)) for _ in range(MOST_SESSIONS + 1)]
    assert access.enter(secrets[0]) is None
    assert access.enter(secrets[1]) is not None


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
