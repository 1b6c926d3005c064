"""What a page may say, parsed at the edge: each message is a frozen dataclass, and all else is refused.

Messages to pages as text: JSON without spaces, put together from parts that are the same for all pages.
"""

import base64
import json
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float64
from pydantic import ConfigDict, Field, TypeAdapter
from pydantic.dataclasses import dataclass

LONGEST_MESSAGE = 4096
"""Characters; a page's longest message has a few hundred."""
STRICT = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, str_max_length=200)


class WireError(ValueError):
    """A message that no page sends."""


@dataclass(frozen=True, config=STRICT)
class Hello:
    """The first message: the secret of this session."""

    secret: str
    kind: Literal["hello"] = "hello"


@dataclass(frozen=True, config=STRICT)
class Shown:
    """The picture of a frame is on the screen."""

    frame: Annotated[int, Field(ge=0, lt=1 << 53)]
    kind: Literal["shown"] = "shown"


@dataclass(frozen=True, config=STRICT)
class Take:
    """Asks for control."""

    kind: Literal["take"] = "take"


@dataclass(frozen=True, config=STRICT)
class Give:
    """Gives control to whoever asks for it (`yes`), or keeps it; without anybody asking, lets go of it."""

    yes: bool
    kind: Literal["give"] = "give"


@dataclass(frozen=True, config=STRICT)
class Click:
    """A pixel of the rectified left image, on the thread of that frame."""

    frame: Annotated[int, Field(ge=0, lt=1 << 53)]
    pixel: tuple[float, float]
    arm: str
    policy: str
    kind: Literal["click"] = "click"


@dataclass(frozen=True, config=STRICT)
class Place:
    """A place along the thread, as s."""

    s: float
    arm: str
    policy: str
    kind: Literal["place"] = "place"


@dataclass(frozen=True, config=STRICT)
class PullThrough:
    """Thread is to be pulled until its tail is so long.

    Fields:
        exit_pixel: of the rectified left image of that frame, where the tail comes out of the tissue.
    """

    frame: Annotated[int, Field(ge=0, lt=1 << 53)]
    arm: str
    tail_mm: Annotated[float, Field(gt=0, le=1000)]
    exit_pixel: tuple[float, float]
    kind: Literal["pull"] = "pull"


@dataclass(frozen=True, config=STRICT)
class LetGo:
    """Jaws are to let go of thread where they are."""

    arm: str
    kind: Literal["let_go"] = "let_go"


@dataclass(frozen=True, config=STRICT)
class PromptAt:
    """The thread at a pixel is meant; without a pixel any."""

    pixel: tuple[float, float] | None
    kind: Literal["prompt"] = "prompt"


@dataclass(frozen=True, config=STRICT)
class Press:
    """The button that arms went down on a plan."""

    arm: str
    plan_id: str
    kind: Literal["press"] = "press"


@dataclass(frozen=True, config=STRICT)
class Beat:
    """The answer to a challenge: the button is down, and whoever presses it sees the page."""

    challenge: str
    kind: Literal["beat"] = "beat"


@dataclass(frozen=True, config=STRICT)
class Release:
    """The button is up, and why."""

    why: str
    kind: Literal["release"] = "release"


@dataclass(frozen=True, config=STRICT)
class HoldAll:
    """Every arm is to hold."""

    kind: Literal["hold"] = "hold"


@dataclass(frozen=True, config=STRICT)
class Record:
    """Begin or end a recording."""

    on: bool
    kind: Literal["record"] = "record"


@dataclass(frozen=True, config=STRICT)
class Look:
    """What this page wants to be shown besides image, thread and tool."""

    observations: bool
    space: bool
    kind: Literal["look"] = "look"


@dataclass(frozen=True, config=STRICT)
class GoOn:
    """Go on with the next goal of the experiment's list."""

    arm: str
    kind: Literal["go_on"] = "go_on"


@dataclass(frozen=True, config=STRICT)
class Judged:
    """Whether the grasp held; if not why, and a note."""

    held: bool
    cause: str
    note: str
    kind: Literal["judged"] = "judged"


Said = (
    Hello
    | Shown
    | Take
    | Give
    | Click
    | Place
    | PullThrough
    | LetGo
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
_SAID: TypeAdapter[Said] = TypeAdapter(Annotated[Said, Field(discriminator="kind")])


def parsed(text: str) -> Said:
    """The message that a text is.

    Raises:
        WireError: where it is none.
    """
    if len(text) > LONGEST_MESSAGE:
        raise WireError("it is too long")
    try:
        return _SAID.validate_json(text)
    except ValueError as error:
        raise WireError(str(error)) from None


compact = json.JSONEncoder(separators=(",", ":")).encode
"""A document as text."""


def joined(document: Mapping[str, Any], parts: Mapping[str, str]) -> str:
    """A document of at least one key with further ones, whose values are texts already."""
    return compact(document)[:-1] + "".join(f',"{key}":{text}' for key, text in parts.items()) + "}"


def packed(numbers: Float64[np.ndarray, "..."]) -> str:
    """Numbers for the page as text: single floats in base 64, which takes a tenth of the time of writing them out."""
    return base64.b64encode(numbers.astype("<f4").tobytes()).decode("ascii")
