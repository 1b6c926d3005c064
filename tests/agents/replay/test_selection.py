import pytest

from agents.replay.contents import contents_of
from agents.replay.selection import SelectionError, name_of, select
from schemas.topics import PROMPT


@pytest.fixture(scope="module")
def contents(recording):
    return contents_of(recording.path)


def names(selection):
    return {name_of(key) for key in selection.keys}


def test_by_default_all_is_played_but_what_would_be_acted_on_and_what_nobody_knows(contents):
    selection = select(contents, None, ())
    assert names(selection) == {
        "camera/frames",
        "camera/calibration",
        "camera/log",
        "robot_bridge/state",
        "reconstruction/thread",
        "perception/health",
        "perception/command",
    }
    assert selection.commands == ()
    reasons = {name_of(key): reason for key, reason in selection.left_out.items()}
    assert reasons == {
        "planner/plan": "would be acted on",
        "operator/prompt": "would be acted on",
        "somebody/whatever": "the topic table does not know it",
    }


def test_by_default_what_live_agents_publish_is_left_out_so_that_they_get_what_comes_from_outside(contents):
    selection = select(contents, None, ("perception/main", "reconstruction/main", "planner/main"))
    assert names(selection) == {"camera/frames", "camera/calibration", "camera/log", "robot_bridge/state"}
    assert select(contents, None, ("robot_bridge/psm2",)).keys == select(contents, None, ()).keys


def test_topics_are_named_one_by_one_or_by_a_pattern(contents):
    assert names(select(contents, ("camera/frames",), ())) == {"camera/frames"}
    assert names(select(contents, ("camera/*", "*/thread"), ())) == {
        "camera/frames",
        "camera/calibration",
        "camera/log",
        "reconstruction/thread",
    }


def test_what_would_be_acted_on_is_named_by_no_pattern_and_said_where_it_is_spelt_out(contents):
    assert "planner/plan" not in names(select(contents, ("*",), ()))
    spelt = select(contents, ("planner/plan", "operator/prompt", "camera/frames"), ("perception/main",))
    assert spelt.acted_on == ("planner/plan", "operator/prompt")
    assert spelt.commands == (PROMPT,)


def test_a_topic_of_a_live_agent_is_refused_where_it_is_named(contents):
    with pytest.raises(SelectionError, match="camera/main is live on this rig and publishes camera/frames itself"):
        select(contents, ("camera/frames",), ("camera/main",))


@pytest.mark.parametrize(
    ("pattern", "said"),
    [("camera/framez", "is no topic"), ("simulator/state", "is not in this recording"), ("planner/*", "not in this")],
)
def test_a_name_that_nothing_has_is_refused_with_those_that_there_are(contents, pattern, said):
    with pytest.raises(SelectionError) as refused:
        select(contents, (pattern,), ())
    assert said in str(refused.value)
    assert "camera/frames" in str(refused.value)


def test_contents_tell_what_there_is_and_when(contents, recording):
    assert sum(contents.counts.values()) + sum(contents.unknown.values()) == len(recording.entries)
    assert contents.rigs == ("recorded",)
    assert (contents.first_ns, contents.last_ns) == (
        recording.entries[0].received_ns,
        recording.entries[-1].received_ns,
    )
    (prompt,) = contents.commands
    # when perception got it, which is before it left its record
    assert (prompt.topic, prompt.at_ns) == (PROMPT, recording.begin_ns + 800 * 10**6)
