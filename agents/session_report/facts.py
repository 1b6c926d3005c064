"""What a session was run with: notes, attached files, what the messages say, and what was set while it ran."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from agents.session_report.accounts import AgentAccount, name_of
from agents.session_report.threads import ThreadQuality
from schemas.codec import decode
from schemas.messages import AgentConfiguration, CommandRecord, Outcome, SetParameter, SimulatorState, StereoCalibration
from schemas.topics import COMMANDS, CONFIGURATION, SET, Topic
from shared.recording.derivation import BEGUN, DERIVED, derivations
from shared.recording.entry import Note
from shared.recording.losses import AT, LOSSES

EPOCH = ".epoch"
"""Which run it was is drawn by chance, and says nothing of how it was run."""
LONGEST_VALUE = 2000


def noted_facts(notes: list[Note]) -> dict[str, str]:
    """What was noted of the session as a whole, one fact a line; JSON within a fact is taken apart."""
    facts: dict[str, str] = {}
    for note in notes:
        if note.name not in (LOSSES, DERIVED, BEGUN) and not is_of_a_moment(note):
            for name, text in note.facts.items():
                facts.update(_flat(f"{_name(note)}.{name}", _parsed(text)))
    for number, one in enumerate(derivations(notes), 1):
        told = asdict(one)
        # how long steps took differs from run to run, and says nothing of how it was run
        told["agents"] = {name: {"outputs": anew.outputs, "kept": anew.kept} for name, anew in one.agents.items()}
        facts.update(_flat(f"derived {number}", {name: value for name, value in told.items() if value != ""}))
    return {name: value for name, value in facts.items() if not name.endswith(EPOCH)}


def _name(note: Note) -> str:
    """The name of a note, with the agent that it is about, where there is one for each."""
    agent = " ".join(note.facts[name] for name in ("agent", "instance") if name in note.facts)
    return f"{note.name} {agent}".strip()


def is_of_a_moment(note: Note) -> bool:
    """Whether a note tells of something that happened at one time."""
    return note.facts.get(AT, "").isdecimal()


def attached_facts(files: Mapping[str, bytes]) -> dict[str, str]:
    """What attached JSON files say, one fact a line, each under the name of its file without its suffix."""
    facts: dict[str, str] = {}
    for name, data in files.items():
        document = _parsed(data.decode("utf-8", "replace").strip())
        if not isinstance(document, str):
            facts.update(_flat(name.removesuffix(".json"), document))
    return facts


def facts_of_messages(
    calibration: StereoCalibration | None,
    scene: SimulatorState | None,
    agents: tuple[AgentAccount, ...],
    quality: ThreadQuality,
) -> dict[str, str]:
    """What the messages themselves say of how the session was run."""
    facts: dict[str, str] = {}
    if calibration is not None:
        facts |= _calibration_facts(calibration)
    if scene is not None:
        facts |= {
            "scene.background": scene.background,
            "scene.colour": scene.colour,
            "scene.seed": str(scene.seed),
            "scene.distance_mm": f"{scene.distance_m * 1e3:g}",
        }
    for kind in ("segmenter", "method"):
        names = sorted(name for of, name in quality.methods if of == kind and name)
        if names:
            facts[f"thread.{kind}"] = ", ".join(names)
    for name in ("version", "host", "config_hash"):
        facts |= _common({f"{agent.name}.{name}": getattr(agent, name) for agent in agents}, f"agents.{name}")
    return facts


def _common(facts: dict[str, str], name: str) -> dict[str, str]:
    """One fact under that name where all are the same, else each under its own; empty ones are left out."""
    told = {key: value for key, value in facts.items() if value}
    values = set(told.values())
    return {name: values.pop()} if len(values) == 1 and len(told) == len(facts) else told


def _calibration_facts(calibration: StereoCalibration) -> dict[str, str]:
    unit = calibration.metres_per_unit
    baseline = float(np.linalg.norm(calibration.T_right_left[:3, 3]))
    return {
        "calibration.image_px": f"{calibration.image_width}x{calibration.image_height}",
        "calibration.focal_px": f"{calibration.K_left[0, 0]:.2f}",
        "calibration.baseline_mm" if unit else "calibration.baseline": f"{baseline * (unit * 1e3 if unit else 1):.4g}",
        "calibration.metres_per_unit": "unknown" if unit is None else f"{unit:g}",
    }


def _parsed(text: str) -> Any:
    if text[:1] in ("{", "["):
        try:
            return json.loads(text)
        except (ValueError, RecursionError):
            return text
    return text


def _flat(name: str, value: Any) -> Iterator[tuple[str, str]]:
    if isinstance(value, dict):
        for key, one in value.items():
            yield from _flat(f"{name}.{key}", one)
    else:
        text = value if isinstance(value, str) else json.dumps(value)
        yield name, text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}…"


@dataclass(frozen=True)
class Setting:
    """A parameter that was set.

    Fields:
        at_ns: when the agent was told to; None for what was set before the recording began.
        value: as it is written.
        by: who told it to; empty where that is not known.
        refused: why it was not; empty where it was.
    """

    at_ns: int | None
    agent: str
    name: str
    value: str
    by: str = ""
    refused: str = ""


class SettingCollector:
    """Takes what agents were told, and with what each began."""

    topics: tuple[Topic, ...] = (COMMANDS, CONFIGURATION)

    def __init__(self) -> None:
        self.settings: list[Setting] = []
        self._heard: set[str] = set()

    def add(self, key: str, message: CommandRecord | AgentConfiguration) -> None:
        """Take one message of these topics.

        Raises:
            MessageError: where the command within a command's record cannot be read.
        """
        if isinstance(message, AgentConfiguration):
            self._configuration(message)
        elif message.topic == str(SET):
            told = decode(SetParameter, message.payload)
            kind, instance = key.split("/")[2:4]
            refused = "" if message.answer.outcome is Outcome.ACCEPTED else message.answer.reason
            agent, by = name_of(kind, instance), told.header.sender
            self.settings.append(Setting(message.received_ns, agent, told.name, told.value, by, refused))

    def _configuration(self, told: AgentConfiguration) -> None:
        """Of the first that is heard of an agent, what had been set by then."""
        agent = name_of(told.agent, told.instance)
        if agent in self._heard:
            return
        self._heard.add(agent)
        known = {(one.agent, one.name) for one in self.settings}
        try:
            values = json.loads(told.parameters)
        except ValueError:
            return
        for one in told.settable:
            if one.is_set and (agent, one.name) not in known:
                self.settings.append(Setting(None, agent, one.name, json.dumps(values.get(one.name))))


def setting_facts(settings: list[Setting]) -> dict[str, str]:
    """What was set, in the order in which it was, by agent and parameter; when it was differs from run to run."""
    facts: dict[str, str] = {}
    for one in settings:
        if not one.refused:
            name = f"set while it ran.{one.agent}.{one.name}"
            facts[name] = f"{facts[name]}, then {one.value}" if name in facts else one.value
    return facts
