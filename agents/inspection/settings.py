"""What was set while a session ran, by whom: the configuration that a recording holds is that of its beginning."""

import json
from dataclasses import dataclass

from agents.inspection.accounts import name_of
from schemas.codec import decode
from schemas.messages import AgentConfiguration, CommandRecord, Outcome, SetParameter
from schemas.topics import COMMANDS, CONFIGURATION, SET, Topic


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
