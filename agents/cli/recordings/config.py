"""The configuration that a recording was made with, and what is set otherwise for a replay."""

import json
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from agents.configuration.migrations import lifted
from agents.configuration.rig import RigConfig
from agents.registry import PLANNER, kind_of
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
    found = found_config(recording)
    if found is None:
        raise ConfigError(f"{recording} holds no configuration, and no {BESIDE} lies beside it; give one by --config")
    return found


def found_config(recording: Path) -> RigConfig | None:
    """The same; None where there is none."""
    attached = read_attachments(recording).get(ATTACHED)
    if attached is not None:
        return parse_config(attached.decode("utf-8", "replace"), RigConfig, ATTACHED)
    beside = recording.parent / BESIDE
    return load_config(beside, RigConfig) if beside.is_file() else None


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
    return (
        parse_config(json.dumps(values), RigConfig, "of the recording with --set", is_json=True) if settings else config
    )


def in_force(recorded: RigConfig, used: RigConfig, agents: Iterable[str]) -> RigConfig:
    """What the outputs of a replay are of: the recorded configuration, with the sections of the agents that ran anew.

    Raises:
        ConfigError: where what ran anew does not go with what did not.
    """
    sections: dict[str, Any] = {}
    anew = [name.partition("/")[::2] for name in agents]
    for name, instance in anew:
        kind = kind_of(name)
        if kind is not None and kind.per_arm:
            arms = sections.get(kind.section, dict(recorded)[kind.section])
            sections[kind.section] = {**arms, instance: used.section_of(kind, instance)}
        elif kind is not None:
            sections[kind.section] = used.section_of(kind)
        if kind is PLANNER:
            # which reads of an arm what it is, and nothing else
            arms = sections.get("robot", recorded.robot)
            sections["robot"] = {
                arm: section.model_copy(update={"kinematics": used.robot[arm].kinematics})
                if arm in used.robot
                else section
                for arm, section in arms.items()
            }
    merged, seen = recorded.model_copy(update=sections), recorded.perception
    has_matches = seen is not None and (seen.matching or (seen.matching is None and recorded.needs_matching))
    if merged.needs_matching and "perception" not in sections and not has_matches:
        method = merged.reconstruction.method if merged.reconstruction else ""
        lacks = f"reconstruction.method {method!r} needs matches, which perception did not make in this recording"
        raise ConfigError(f"{lacks}: have it run anew too, with --through perception,reconstruction")
    # where it is unset, perception matches as the method of reconstruction of its own configuration needs it
    matched = (used if "perception" in sections else recorded).needs_matching
    if merged.perception is not None and merged.perception.matching is None and merged.needs_matching != matched:
        merged = merged.model_copy(update={"perception": merged.perception.model_copy(update={"matching": matched})})
    text = merged.model_dump_json(exclude_unset=True)
    return parse_config(text, RigConfig, "of the replayed agents within the recorded one", is_json=True)


def attached_config(recorded: bytes | None, effective: RigConfig, agents: Iterable[str]) -> bytes:
    """The settings in force as a file: the recorded one, but for the sections of the agents that ran anew.

    What did not run has no settings of today: an older version lacks some.
    """
    document: dict[str, Any] = json.loads(recorded) if recorded else {}
    if document.get("perception", {}).get("track_tool"):
        # else perception of today would take those from agents that did not run
        document = lifted(document)
    today: dict[str, Any] = json.loads(effective.model_dump_json(exclude_none=True))
    kinds = {kind_of(name.partition("/")[0]) for name in agents}
    sections = {kind.section for kind in kinds if kind is not None}
    document |= {section: today[section] for section in sections if section in today} if recorded else today
    return (json.dumps(document, indent=1) + "\n").encode()


def settings_otherwise(before: RigConfig, now: RigConfig) -> dict[str, str]:
    """The settings that differ, as `before -> now` by key; what an older version has not recorded is said to be so."""
    one, other = (dict(_settings("", json.loads(rig.model_dump_json()))) for rig in (before, now))
    recorded = dict(_settings("", json.loads(before.model_dump_json(exclude_unset=True))))
    return {
        key: f"{one.get(key, 'none') if key in recorded else 'not recorded'} -> {other.get(key, 'none')}"
        for key in dict.fromkeys((*one, *other))
        if one.get(key) != other.get(key)
    }


def _settings(prefix: str, value: Any) -> Iterator[tuple[str, str]]:
    if isinstance(value, dict) and value:
        for name, of in value.items():
            yield from _settings(f"{prefix}.{name}" if prefix else name, of)
    else:
        yield prefix, value if isinstance(value, str) else json.dumps(value)


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
