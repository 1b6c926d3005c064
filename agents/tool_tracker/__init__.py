"""Where an arm's instrument is in the images, as a correction of where its joints and the registration have it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ToolTrackerConfig:
    """Whose instrument is looked for: the arm's name, which is the instance in its keys."""

    arm: str = "psm1"
