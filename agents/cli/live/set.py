"""`suturegrasp set`: a parameter of a running agent is set, or all of them are listed."""

import json
from collections.abc import Collection
from typing import Any

from rich.table import Table

from agents.cli.live.options import SetInAgent
from agents.cli.progress import printed
from agents.configuration.rig import RigConfig
from agents.diagnostics.status.health_watch import agent_name, name_of
from agents.launch.process import EXIT_OK
from schemas.messages import AgentConfiguration, Outcome
from schemas.topics import MAIN
from shared.runtime.config import ConfigError
from shared.runtime.connection import connected
from shared.terminal import complain, say

EXIT_REFUSED = 3
SENDER = "suturegrasp set"
PAGE_COLUMNS = 140


def set_parameter(rig: RigConfig, options: SetInAgent) -> int:
    """Set a parameter, or list them; the exit status is 3 where the agent refuses or does not answer.

    Raises:
        ConfigError: where the words name no agent and no parameter.
        NoRouterError: where no router answers.
    """
    kind, instance, told = agent_and_rest(options.words)
    called = name_of(kind, instance)
    with connected(rig.session) as connection:
        if not told:
            configurations = connection.configurations()
            if (configuration := configurations.get(f"{kind}/{instance}")) is None:
                return complain(_nobody(called, configurations), EXIT_REFUSED)
            return _list(configuration)
        name, text = told
        answer = connection.set_parameter(kind, instance, name, value_of(text), SENDER)
        if answer.outcome is not Outcome.ACCEPTED:
            present = connection.present()
            there = f"{kind}/{instance}" in present
            return complain(answer.reason if there else _nobody(called, present), EXIT_REFUSED)
    say(f"{name} of {called} is {json.dumps(value_of(text))} now")
    return EXIT_OK


def agent_and_rest(words: tuple[str, ...]) -> tuple[str, str, tuple[str, str] | None]:
    """Kind, instance, and name with value if there are any: these come in twos, so an odd word is the instance.

    Raises:
        ConfigError: where there are too few or too many words.
    """
    if not words:
        raise ConfigError("name an agent, such as perception, or robot_bridge psm1")
    first = words[0].replace("/", " ").split()
    named = [*first, *words[1:]]
    if len(first) > 2 or not 1 <= len(named) <= 4 or (len(first) == 2 and len(named) == 3):
        raise ConfigError("give an agent, and to set a parameter its name and value: robot_bridge psm1 NAME VALUE")
    kind, *rest = named
    # agents' kinds have an underscore where their commands have a hyphen
    kind = kind.replace("-", "_")
    instance = rest.pop(0) if len(rest) in (1, 3) else MAIN
    return kind, instance, (rest[0], rest[1]) if rest else None


def value_of(text: str) -> Any:
    """What a person typed, as JSON where it is JSON, and otherwise as a text."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


def _nobody(called: str, present: Collection[str]) -> str:
    others = ", ".join(agent_name(name) for name in present)
    return f"{called} does not run; {f'there are {others}' if others else 'no agent does'}"


def _list(configuration: AgentConfiguration) -> int:
    values: dict[str, Any] = json.loads(configuration.parameters)
    settable = {parameter.name: parameter for parameter in configuration.settable}
    table = Table(box=None, pad_edge=False)
    for column in ("parameter", "value", "may be set to"):
        table.add_column(column, overflow="fold")
    for name, value in sorted(values.items(), key=lambda pair: pair[0] not in settable):
        parameter = settable.get(name)
        may = "not while it runs" if parameter is None else parameter.allowed
        changed = " (set since it started)" if parameter is not None and parameter.is_set else ""
        table.add_row(name, json.dumps(value), may + changed)
    printed(table if values else "it has no parameters", PAGE_COLUMNS)
    return EXIT_OK
