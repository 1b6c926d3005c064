"""What was released stays: fields keep their numbers and kinds, and recordings of every released version open."""

import pytest

import schemas
from schemas.codec import decode, encode
from schemas.migrations import (
    MIGRATIONS,
    Migration,
    NewerVersionError,
    check_readable,
    lifted,
    lifted_key,
    version_of,
)
from schemas.topics import TOPICS, Delivery, topic_of
from schemas.wire import descriptor, wire_type_named
from shared.recording.mcap_file import read_recording
from tests.schemas.freeze import RELEASED, schema_lines

VERSIONS = sorted(path.name for path in RELEASED.iterdir() if path.is_dir())
every_version = pytest.mark.parametrize("version", VERSIONS)


def test_this_version_is_frozen():
    assert schemas.__version__ in VERSIONS


@every_version
def test_nothing_released_was_removed_renumbered_or_changed_in_kind(version):
    released = (RELEASED / version / "schema.txt").read_text().splitlines()
    assert len(released) > 200
    assert sorted(set(released) - set(schema_lines())) == []


def test_nothing_was_added_without_a_new_version():
    released = (RELEASED / schemas.__version__ / "schema.txt").read_text().splitlines()
    added = sorted(set(schema_lines()) - set(released))
    assert not added, "freeze the schema: docs/new_agent.md, section 5"


def test_numbers_have_no_holes_so_that_an_unknown_one_above_all_is_an_addition():
    for message in descriptor().message_types_by_name.values():
        assert sorted(field.number for field in message.fields) == list(range(1, len(message.fields) + 1))


@every_version
def test_a_recording_of_a_released_version_opens(version):
    entries = list(read_recording(RELEASED / version / "recording.mcap"))
    seen = {topic_of(entry.key) for entry in entries}
    known = {line.split(".")[0] for line in (RELEASED / version / "schema.txt").read_text().splitlines()}
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


def rename(wire):
    wire.reason = wire.reason.replace("cut", "thread")


def test_a_message_is_lifted_by_the_steps_that_came_after_its_version_in_their_order():
    steps = (
        Migration("ExecutionEvent", (0, 2, 0), rename),
        Migration("ExecutionEvent", (0, 3, 0), lambda wire: setattr(wire, "reason", wire.reason + "!")),
        Migration("GraspPlan", (0, 3, 0), rename),
    )
    event = wire_type_named("ExecutionEvent")
    old = event(reason="no cut").SerializeToString()
    assert (
        wire_type_named("ExecutionEvent").FromString(lifted("ExecutionEvent", old, (0, 1, 0), steps)).reason
        == "no thread!"
    )
    assert (
        wire_type_named("ExecutionEvent").FromString(lifted("ExecutionEvent", old, (0, 2, 0), steps)).reason
        == "no cut!"
    )
    assert lifted("ExecutionEvent", old, (0, 3, 0), steps) is old
    assert lifted("ExecutionEvent", b"\xff", (0, 1, 0), steps) == b"\xff"


def test_migrations_stand_in_the_order_of_their_versions_and_name_messages():
    assert [step.version for step in MIGRATIONS] == sorted(step.version for step in MIGRATIONS)
    assert all(wire_type_named(step.message) for step in MIGRATIONS)


def test_a_greater_first_number_is_refused():
    first, *rest = version_of(schemas.__version__)
    check_readable((first, *rest))
    check_readable((first, rest[0] + 1, 0))
    with pytest.raises(NewerVersionError, match="update suturegrasp"):
        check_readable((first + 1, 0, 0))


def test_an_arms_tool_tracker_was_an_instance_of_perception():
    assert lifted_key("suturegrasp/lab/perception/psm1/tool") == "suturegrasp/lab/tool_tracker/psm1/correction"
    assert lifted_key("suturegrasp/lab/perception/psm1/health") == "suturegrasp/lab/tool_tracker/psm1/health"
    for same in ("suturegrasp/lab/perception/main/health", "suturegrasp/lab/tool_tracker/psm1/correction"):
        assert lifted_key(same) == same
    told = wire_type_named("RobotState")(
        consumed=[wire_type_named("Consumed")(key="suturegrasp/lab/perception/psm1/tool", sequence=3)]
    )
    (consumed,) = (
        wire_type_named("RobotState").FromString(lifted("RobotState", told.SerializeToString(), (0, 2, 0))).consumed
    )
    assert (consumed.key, consumed.sequence) == ("suturegrasp/lab/tool_tracker/psm1/correction", 3)
