"""Where the needle lies: from what perception sees of it in both eyes to its pose in space."""

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field


@dataclass(frozen=True)
class NeedleConfig:
    """How large the needle is: the radius of its arc, and the angle from swage to point; None where nobody says."""

    radius_mm: Annotated[float | None, Field(ge=3, le=16)] = None
    arc_deg: Annotated[float | None, Field(ge=60, le=300)] = None
