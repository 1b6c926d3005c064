"""What was released stays: fields keep their numbers and kinds, and recordings of every released version open."""

import pytest

import schemas
from schemas.codec import decode, encode
from schemas.migrations import MIGRATIONS, Migration, lifted, lifted_key, version_of
from schemas.topics import TOPICS, Delivery, topic_of
from schemas.wire import descriptor, wire_type_named
from shared.recording.mcap_file import read_recording
from tests.schemas.freeze import RELEASED, schema_lines

VERSIONS = sorted(path.name for path in RELEASED.iterdir() if path.is_dir())
every_version = pytest.mark.parametrize("version", VERSIONS)


def released(version):
    return set((RELEASED / version / "schema.txt").read_text().splitlines())


@every_version
def test_nothing_released_was_removed_renumbered_or_changed_in_kind(version):
    assert len(released(version)) > 200
    assert released(version) - set(schema_lines()) == set()


def test_nothing_was_added_without_a_new_version_and_numbers_have_no_holes():
    added = set(schema_lines()) - released(schemas.__version__)
    assert not added, "freeze the schema: docs/new_agent.md, section 5"
    # so that an unknown number above all is an addition
    for message in descriptor().message_types_by_name.values():
        assert sorted(field.number for field in message.fields) == list(range(1, len(message.fields) + 1))


@every_version
def test_a_recording_of_a_released_version_opens(version):
    entries = list(read_recording(RELEASED / version / "recording.mcap"))
    seen, known = {topic_of(entry.key) for entry in entries}, {line.split(".")[0] for line in released(version)}
    recorded = {topic for topic in TOPICS if topic.recorded and topic.delivery is not Delivery.COMMAND}
    expected = {topic for topic in recorded if topic.message.__name__ in known}
    assert len(expected) > 13
    missing = ", ".join(sorted(str(topic) for topic in expected - seen))
    assert not missing, f"no message of {missing} in {version}/recording.mcap: freeze it (docs/new_agent.md)"
    for entry in entries:
        message = topic_of(entry.key).message
        payload = lifted(message.__name__, entry.payload, version_of(version))
        # what a later version added is absent, empty or zero, and that takes no bytes
        assert encode(decode(message, payload)) == payload


def test_a_message_is_lifted_by_the_steps_that_came_after_its_version_in_their_order():
    event = wire_type_named("ExecutionEvent")
    steps = (
        Migration("ExecutionEvent", (0, 2, 0), lambda wire: setattr(wire, "reason", wire.reason.replace("cut", "end"))),
        Migration("ExecutionEvent", (0, 3, 0), lambda wire: setattr(wire, "reason", wire.reason + "!")),
        Migration("GraspPlan", (0, 3, 0), lambda wire: setattr(wire, "reason", "another message's")),
    )
    old = event(reason="no cut").SerializeToString()
    for version, reason in (((0, 1, 0), "no end!"), ((0, 2, 0), "no cut!")):
        assert event.FromString(lifted("ExecutionEvent", old, version, steps)).reason == reason
    assert lifted("ExecutionEvent", old, (0, 3, 0), steps) is old
    assert lifted("ExecutionEvent", b"\xff", (0, 1, 0), steps) == b"\xff"
    assert [step.version for step in MIGRATIONS] == sorted(step.version for step in MIGRATIONS)


def test_an_arms_tool_tracker_was_an_instance_of_perception():
    was, now = "suturegrasp/lab/perception/psm1/tool", "suturegrasp/lab/tool_tracker/psm1/correction"
    assert lifted_key(was) == lifted_key(now) == now
    assert lifted_key("suturegrasp/lab/perception/psm1/health") == "suturegrasp/lab/tool_tracker/psm1/health"
    assert lifted_key("suturegrasp/lab/perception/main/health") == "suturegrasp/lab/perception/main/health"
    state = wire_type_named("RobotState")
    told = state(consumed=[wire_type_named("Consumed")(key=was, sequence=3)]).SerializeToString()
    (consumed,) = state.FromString(lifted("RobotState", told, (0, 2, 0))).consumed
    assert (consumed.key, consumed.sequence) == (now, 3)
