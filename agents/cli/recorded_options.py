"""The options of the commands that work on recordings, and which module carries each out."""

from dataclasses import dataclass


@dataclass(frozen=True)
class OnRecording:
    """A command that reads recordings; it needs no rig that runs."""


RECORDED_COMMANDS: dict[str, type[OnRecording]] = {}
RUNNERS: dict[type[OnRecording], str] = {}
"""A module with `run(options) -> int`, the exit status; loaded when its command is given."""
