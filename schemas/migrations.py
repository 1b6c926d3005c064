"""What lifts messages of older released versions to this one, so that old recordings keep opening.

A released schema only grows: fields and values of enums are added, with the next number, and never removed, renumbered
or changed in kind. What was not there yet reads as absent, empty or zero. Where that is not what it meant then, a small
pure function here says what it did mean; it works on the protobuf message before the codec looks at it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from google.protobuf.message import DecodeError

from schemas import __version__
from schemas.topics import MAIN, TOOL
from schemas.wire import wire_type_named

Version = tuple[int, ...]


@dataclass(frozen=True)
class Migration:
    """One step of one message type.

    Fields:
        message: the type's name.
        version: the first version whose messages need it no more.
        lift: changes a protobuf message of that type in place.
    """

    message: str
    version: Version
    lift: Callable[[Any], None]


def lifted_agent(name: str) -> str:
    """An agent's name of this version: an arm's tool tracker was an instance of perception until 0.2.0."""
    kind, _, instance = name.partition("/")
    return f"{TOOL.agent}/{instance}" if kind == "perception" and instance not in ("", MAIN) else name


def lifted_key(key: str) -> str:
    """The key under which this version publishes what an older one published under that key."""
    root, _, rest = key.partition("/perception/")
    instance, _, name = rest.partition("/")
    if instance in ("", MAIN):
        return key
    return f"{root}/{TOOL.agent}/{instance}/{TOOL.name if name == 'tool' else name}"


def _consumed_lifted(wire: Any) -> None:
    for one in wire.consumed:
        one.key = lifted_key(one.key)


MIGRATIONS: tuple[Migration, ...] = tuple(
    Migration(message, (0, 3, 0), _consumed_lifted) for message in ("ToolCorrection", "RobotState", "ExecutionEvent")
)
"""In the order of their versions."""


class NewerVersionError(Exception):
    """Messages of a version that is newer than this program by more than added fields; the text says what to do."""


def version_of(text: str) -> Version:
    """The numbers of a version such as `0.1.0`.

    Raises:
        ValueError: where it is none.
    """
    return tuple(int(part) for part in text.split("."))


def lifted(message: str, payload: bytes, version: Version, migrations: Sequence[Migration] = MIGRATIONS) -> bytes:
    """The bytes of a message that a program of that version sent, as one of this version would have sent them.

    Bytes that need nothing come back as they are, damaged ones too: to judge them is the codec's task.
    """
    due = [step for step in migrations if step.message == message and version < step.version]
    if not due:
        return payload
    wire = wire_type_named(message)()
    try:
        wire.ParseFromString(payload)
    except DecodeError:
        return payload
    for step in due:
        step.lift(wire)
    return wire.SerializeToString(deterministic=True)


def check_readable(version: Version) -> None:
    """Refuse messages of a version with another first number, whose fields may mean something else.

    Raises:
        NewerVersionError: where it is one.
    """
    own = version_of(__version__)
    if version[0] > own[0]:
        there, here = (".".join(map(str, v)) for v in (version, own))
        raise NewerVersionError(f"recorded by suturegrasp {there}, which {here} cannot read; update suturegrasp")
