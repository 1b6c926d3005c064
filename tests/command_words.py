"""How tests start processes by their names."""

from agents.cli.commands import COMMANDS


def words(name):
    """The command's words for an agent, such as `robot-bridge`, or for another command."""
    return name.split() if name in COMMANDS else ["run", name]
