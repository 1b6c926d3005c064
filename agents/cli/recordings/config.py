"""The configuration that a recording was made with, and what is set otherwise for a replay."""

import json
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from agents.cli.rig.config import RigConfig
from shared.recording.mcap_file import read_attachments
from shared.runtime.config import ConfigError, load_config, parse_config

ATTACHED, BESIDE = "configuration.json", "rig.json"
"""In a recording, and in its session's folder."""


def recorded_config(recording: Path) -> RigConfig:
    """What the recording itself holds, or its session's folder.

    Raises:
        ConfigError: where neither has one, or it cannot be used.
        RecordingError, OSError: as `read_recording`.
    """
    attached = read_attachments(recording).get(ATTACHED)
    if attached is not None:
        return parse_config(attached.decode("utf-8", "replace"), RigConfig, ATTACHED)
    beside = recording.parent / BESIDE
    if not beside.is_file():
        raise ConfigError(f"{recording} holds no configuration, and no {BESIDE} lies beside it; give one by --config")
    return load_config(beside, RigConfig)


def changed(config: RigConfig, settings: Iterable[str]) -> RigConfig:
    """The configuration with settings such as `reconstruction.method=paper`, values as in TOML or plain words.

    Raises:
        ConfigError: where one is none, or the configuration does not allow it.
    """
    values = json.loads(config.model_dump_json(exclude_unset=True))
    for setting in settings:
        name, separator, text = setting.partition("=")
        keys = name.strip().split(".")
        if not separator or not all(keys):
            raise ConfigError(f"--set {setting} must name a key and its value, such as reconstruction.method=paper")
        section: dict[str, Any] = values
        for part in keys[:-1]:
            found = section.setdefault(part, {})
            if not isinstance(found, dict):
                raise ConfigError(f"--set {setting}: {part} is no section with keys of its own")
            section = found
        section[keys[-1]] = _value(text.strip())
    return parse_config(json.dumps(values), RigConfig, "--set.json") if settings else config


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
