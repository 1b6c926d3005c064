"""Plans and certificates of whole rigs, made by the command."""

from pathlib import Path

import pytest

from agents.cli.main import main

REPOSITORY = Path(__file__).parents[3]
LAB = REPOSITORY / "deploy" / "lab.toml"


def deploy(*arguments):
    """The exit status of `suturegrasp deploy`."""
    with pytest.raises(SystemExit) as ended:
        main(["deploy", *map(str, arguments)])
    return ended.value.code


def made(config, folder):
    """Plan and certificates of a rig's file, or of its text."""
    if isinstance(config, str):
        folder.mkdir(exist_ok=True)
        (folder / "rig.toml").write_text(config)
        config = folder / "rig.toml"
    for action in ("plan", "certificates"):
        assert deploy(action, "--config", config, "--folder", folder) == 0
    return folder
