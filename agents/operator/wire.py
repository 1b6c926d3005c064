"""What a page may say, parsed at the edge: each message is a frozen dataclass, and all else is refused.

Messages to pages as text: JSON without spaces, put together from parts that are the same for all pages.
"""

import base64
import json
import math
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float64

LONGEST_TEXT = 200
LONGEST_MESSAGE = 4096
"""Characters; a page's longest message has a few hundred."""
FARTHEST_PX = 1e5


class WireError(ValueError):
    """A message that no page sends."""


@dataclass(frozen=True)
class Hello:
    """The first message: the secret of this session."""

    secret: str


@dataclass(frozen=True)
class Shown:
    """A picture is on the screen; `at_ms` by the page's clock (milliseconds since 1970)."""

    frame: int
    at_ms: float


@dataclass(frozen=True)
class Take:
    """Asks for control."""


@dataclass(frozen=True)
class Give:
    """Gives control to whoever asks for it (`yes`), or keeps it; without anybody asking, lets go of it."""

    yes: bool


@dataclass(frozen=True)
class Click:
    """A pixel of the rectified left image, on the thread of that frame."""

    frame: int
    pixel: tuple[float, float]
    arm: str
    policy: str


@dataclass(frozen=True)
class Place:
    """A place along the thread, as s."""

    s: float
    arm: str
    policy: str


@dataclass(frozen=True)
class PromptAt:
    """The thread at a pixel is meant; without a pixel any."""

    pixel: tuple[float, float] | None


@dataclass(frozen=True)
class Press:
    """The button that arms went down on a plan."""

    arm: str
    plan_id: str


@dataclass(frozen=True)
class Beat:
    """The answer to a challenge: the button is down, and whoever presses it sees the page."""

    challenge: str


@dataclass(frozen=True)
class Release:
    """The button is up, and why."""

    why: str


@dataclass(frozen=True)
class HoldAll:
    """Every arm is to hold."""


@dataclass(frozen=True)
class Record:
    """Begin or end a recording."""

    on: bool


@dataclass(frozen=True)
class Look:
    """What this page wants to be shown besides image, thread and tool."""

    observations: bool
    space: bool


@dataclass(frozen=True)
class GoOn:
    """Go on with the next goal of the experiment's list."""

    arm: str


@dataclass(frozen=True)
class Judged:
    """Whether the grasp held; if not why, and a note."""

    held: bool
    cause: str
    note: str


Said = (
    Hello
    | Shown
    | Take
    | Give
    | Click
    | Place
    | PromptAt
    | Press
    | Beat
    | Release
    | HoldAll
    | Record
    | Look
    | GoOn
    | Judged
)
KINDS: dict[str, type[Said]] = {
    "hello": Hello,
    "shown": Shown,
    "take": Take,
    "give": Give,
    "click": Click,
    "place": Place,
    "prompt": PromptAt,
    "press": Press,
    "beat": Beat,
    "release": Release,
    "hold": HoldAll,
    "record": Record,
    "look": Look,
    "go_on": GoOn,
    "judged": Judged,
}

_DECLARED = {kind: typing.get_type_hints(kind) for kind in KINDS.values()}


def parsed(text: str) -> Said:
    """The message that a text is.

    Raises:
        WireError: where it is none.
    """
    if len(text) > LONGEST_MESSAGE:
        raise WireError("it is too long")
    try:
        document = json.loads(text)
    except (ValueError, RecursionError):
        raise WireError("it is no JSON") from None
    if not isinstance(document, dict) or not isinstance(document.get("kind"), str):
        raise WireError("it has no kind")
    kind = KINDS.get(document.pop("kind"))
    if kind is None:
        raise WireError("its kind is unknown")
    declared = _DECLARED[kind]
    if document.keys() != declared.keys():
        raise WireError(f"a {kind.__name__} has {', '.join(declared) or 'no fields'}")
    return kind(**{field.name: _value(document[field.name], declared[field.name]) for field in fields(kind)})


def _value(value: Any, declared: Any) -> Any:
    if isinstance(declared, types.UnionType):
        return None if value is None else _value(value, typing.get_args(declared)[0])
    if typing.get_origin(declared) is tuple:
        if not isinstance(value, list) or len(value) != 2:
            raise WireError("a pixel has two numbers")
        return tuple(_value(each, float) for each in value)
    if declared is float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise WireError("a number is none")
        return _number(value)
    if type(value) is not declared:
        raise WireError(f"a {declared.__name__} is none")
    if declared is str and len(value) > LONGEST_TEXT:
        raise WireError("a text is too long")
    if declared is int and not 0 <= value < 1 << 53:
        raise WireError("a count is out of range")
    return value


def _number(value: float) -> float:
    try:
        number = float(value)
    except OverflowError:
        raise WireError("a number is out of range") from None
    if not math.isfinite(number):
        raise WireError("a number is not finite")
    return number


compact = json.JSONEncoder(separators=(",", ":")).encode
"""A document as text."""


def joined(document: Mapping[str, Any], parts: Mapping[str, str]) -> str:
    """A document of at least one key with further ones, whose values are texts already."""
    return compact(document)[:-1] + "".join(f',"{key}":{text}' for key, text in parts.items()) + "}"


def packed(numbers: Float64[np.ndarray, "..."]) -> str:
    """Numbers for the page as text: single floats in base 64, which takes a tenth of the time of writing them out."""
    return base64.b64encode(numbers.astype("<f4").tobytes()).decode("ascii")
