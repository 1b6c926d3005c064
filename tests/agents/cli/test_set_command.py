"""Setting a parameter of a running agent, and listing them, as a person does it."""

import json
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.cli.live.set import agent_and_rest, value_of
from agents.planner.agent import Planner
from shared.runtime.connection import connected


@pytest.fixture
def told(settings, running, suturegrasp, tmp_path, until):
    """What `suturegrasp set` says to a rig of which the planner runs."""
    config = tmp_path / "rig.toml"
    config.write_text(f'rig = "{settings.rig}"\n[router]\nendpoint = "{settings.endpoint}"\nstart = false\n[planner]\n')
    running(Planner())
    with connected(settings, 60.0) as connection:
        until(connection.configurations)
    return lambda *words: suturegrasp("set", *words, "--config", config)


def test_parameters_are_listed_set_and_refused(told):
    listed = told("planner")
    assert (listed.status, listed.err) == (0, "")
    assert re.search(r"^least_probability +0\.5 +a number from 0 to 1$", listed.out, flags=re.M)
    assert re.search(r"^samples +100 +not while it runs$", listed.out, flags=re.M)
    done = told("planner", "least_probability", "0.7")
    assert (done.status, done.out) == (0, "least_probability of planner is 0.7 now\n")
    assert re.search(
        r"^least_probability +0\.7 +a number from 0 to 1 \(set since it started\)$", told("planner").out, re.M
    )
    for words, reason in (
        (("planner", "least_probability", "7"), "least_probability cannot be 7; it may be a number from 0 to 1"),
        (("planner/main", "samples", "7"), "samples of planner cannot be set while it runs"),
        (("planner", "sampels", "7"), "planner has no parameter sampels"),
        (("robot_bridge", "psm1"), "robot_bridge psm1 does not run; there are planner"),
    ):
        refused = told(*words)
        assert (refused.status, refused.out, len(refused.err.splitlines())) == (3, "", 1)
        assert reason in refused.err


def test_words_that_are_no_agent_and_parameter_are_told(suturegrasp):
    for words, told in (((), "name an agent, such as perception"), (("a", "b", "c", "d", "e"), ""), (("a b c",), "")):
        ended = suturegrasp("set", *words)
        assert (ended.status, ended.out, len(ended.err.splitlines())) == (2, "", 1)
        assert told in ended.err


NAMES = st.from_regex(r"[a-z_]{1,8}", fullmatch=True)


@given(NAMES, st.none() | NAMES, st.none() | st.tuples(NAMES, st.text(min_size=1)), st.sampled_from("/ "))
def test_an_agent_is_named_in_one_word_or_two(kind, instance, parameter, separator):
    rest = parameter or ()
    expected = (kind, instance or "main", parameter)
    if instance is None:
        assert agent_and_rest((kind, *rest)) == expected
    else:
        assert (
            agent_and_rest((kind, instance, *rest))
            == agent_and_rest((f"{kind}{separator}{instance}", *rest))
            == expected
        )


@given(st.text(max_size=20))
def test_what_was_typed_is_json_or_a_text(text):
    value = value_of(text)
    assert value == text or json.dumps(json.loads(text)) == json.dumps(value)
