"""Parameters of a running agent: which of them may be set, to what, and what a command to set one does.

The config of an agent is a frozen dataclass. A field that is safe to set while the agent runs is declared `settable`,
and the agent takes a changed config in its method `configure`; nothing else of it can be set. A change is a step like
any other (docs/decisions.md, 16), so a replay of a recording repeats it.
"""

import dataclasses
import difflib
import enum
import hashlib
import json
import logging
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from schemas.messages import AgentConfiguration, CommandAnswer, SetParameter, SettableParameter
from schemas.topics import CONFIGURATION, SET
from shared.runtime.agent import Agent, Command, Received, Reply, Tick
from shared.runtime.commands import accepted, refused

ALLOWED, AUTO = "allowed", "auto"
"""Where the metadata of a field says so; how a choice that is left to the agent is written."""
LOGGER = logging.getLogger("suturegrasp.parameters")


class Allowed(Protocol):
    """What a field may be set to; `configured` is what the agent was started with."""

    def holds(self, value: Any, configured: Any, /) -> bool:
        """Whether a value is allowed."""
        ...

    def text(self, configured: Any, /) -> str:
        """What is allowed, as a clause after "it may be"."""
        ...


@dataclass(frozen=True)
class Between:
    """Numbers from `least` to `most`, whole ones where `least` is whole; without `most`, up to what was configured."""

    least: float
    most: float | None = None

    def holds(self, value: Any, configured: Any, /) -> bool:
        """Whether the value is a number of that kind in the range; what is no number lies in none."""
        kinds = int if isinstance(self.least, int) else (int, float)
        if isinstance(value, bool) or not isinstance(value, kinds):
            return False
        return self.least <= value <= self._most(configured)

    def text(self, configured: Any, /) -> str:
        """The range in words."""
        kind = "a whole number" if isinstance(self.least, int) else "a number"
        ends = " (as configured)" if self.most is None else ""
        return f"{kind} from {self.least:g} to {self._most(configured):g}{ends}"

    def _most(self, configured: Any) -> float:
        return configured if self.most is None else self.most


@dataclass(frozen=True)
class OneOf:
    """One of a few values; None, which leaves the choice to the agent, is written as AUTO, as in a rig's file."""

    values: tuple[Any, ...]

    def holds(self, value: Any, _configured: Any, /) -> bool:
        """Whether the value is one of them, and of the same type."""
        return any(type(meant(value)) is type(known) and meant(value) == known for known in self.values)

    def text(self, _configured: Any, /) -> str:
        """The values in words."""
        return "one of " + ", ".join(json.dumps(AUTO if value is None else value) for value in self.values)


def meant(value: Any) -> Any:
    """The value of a field that is told in these words."""
    return None if value == AUTO else value


def settable(default: Any, allowed: Allowed) -> Any:
    """A field of a config that may be set while its agent runs."""
    return field(default=default, metadata={ALLOWED: allowed})


class NotSetError(ValueError):
    """A parameter that is not set: a stable code, and the reason in one sentence."""

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(reason)
        self.code = code


class Parameters:
    """An agent together with its parameters: steps through it, and carries out commands that set one of them."""

    def __init__(self, agent: Agent) -> None:
        self._agent = agent
        self._configured = agent.config
        self._current = self._configured
        fields = dataclasses.fields(self._configured) if self._configured is not None else ()
        self._allowed: dict[str, Allowed] = {f.name: f.metadata[ALLOWED] for f in fields if ALLOWED in f.metadata}
        self._names = [f.name for f in fields]

    def step(self, arrived: Received | Tick | Command) -> Iterable[Reply]:
        """The agent's step; commands that set a parameter, and configurations that were listed, end here."""
        if isinstance(arrived, Command) and arrived.topic is SET:
            return (self._answer(arrived.message),)
        if isinstance(arrived, Received) and arrived.topic is CONFIGURATION:
            self.restore(arrived.message)
            return ()
        return self._agent.step(arrived)

    def restore(self, told: AgentConfiguration) -> None:
        """Set what was set when this configuration was told; the rest is as configured."""
        values, current = json.loads(told.parameters), self._configured
        for parameter in told.settable:
            if parameter.is_set and parameter.name in values:
                try:
                    current = self._changed(current, parameter.name, values[parameter.name])
                except NotSetError as error:
                    # a recording of another version, or a configuration that it was not made with
                    LOGGER.warning("what was set is not set again: %s", error)
        self._take(current)

    def are_set(self) -> dict[str, Any]:
        """What is not as configured."""
        return {
            name: value
            for name in self._allowed
            if (value := getattr(self._current, name)) != getattr(self._configured, name)
        }

    def told(self, at_ns: int, config_hash: str) -> AgentConfiguration:
        """The parameters as a message."""
        is_set = self.are_set()
        settable_ones = (
            SettableParameter(name, allowed.text(getattr(self._configured, name)), name in is_set)
            for name, allowed in self._allowed.items()
        )
        text = json.dumps(self._in_words())
        return AgentConfiguration(
            self._agent.kind, self._agent.instance, at_ns, text, tuple(settable_ones), self.hashed(config_hash)
        )

    def _in_words(self) -> dict[str, Any]:
        """The values as they are written."""
        plain = _plain(self._current) if self._current is not None else {}
        choices = {name for name, allowed in self._allowed.items() if isinstance(allowed, OneOf)}
        return {name: AUTO if value is None and name in choices else value for name, value in plain.items()}

    def hashed(self, config_hash: str) -> str:
        """The short name of a configuration, with what was set since."""
        is_set = self.are_set()
        if not is_set:
            return config_hash
        return hashlib.sha256((config_hash + json.dumps(is_set, sort_keys=True)).encode()).hexdigest()[:12]

    def _answer(self, command: SetParameter) -> CommandAnswer:
        try:
            value = json.loads(command.value)
        except (ValueError, RecursionError):
            reason = f"the value of {command.name} is no JSON; texts need quotation marks, as in '\"auto\"'"
            return refused(command.header.id, "unreadable_value", reason)
        try:
            self._take(self._changed(self._current, command.name, value))
        except NotSetError as error:
            return refused(command.header.id, error.code, str(error))
        return accepted(command.header.id)

    def _changed(self, config: Any, name: str, value: Any) -> Any:
        """A config with one field changed, where that is allowed."""
        kind = self._agent.kind
        if name not in self._names:
            near = difflib.get_close_matches(name, self._names, n=1)
            known = f"it has {', '.join(self._names)}" if self._names else "it has none"
            known = f"did you mean {near[0]}?" if near else known
            raise NotSetError("unknown_parameter", f"{kind} has no parameter {name}; {known}")
        allowed = self._allowed.get(name)
        if allowed is None:
            can = f"what can be set is {', '.join(self._allowed)}" if self._allowed else "nothing of it can be set"
            raise NotSetError("not_settable", f"{name} of {kind} cannot be set while it runs; {can}")
        configured = getattr(self._configured, name)
        if not allowed.holds(value, configured):
            shown = json.dumps(value)
            shown = shown if len(shown) <= 60 else f"{shown[:60]}..."
            raise NotSetError("out_of_range", f"{name} cannot be {shown}; it may be {allowed.text(configured)}")
        value = float(value) if isinstance(configured, float) else meant(value)
        try:
            return dataclasses.replace(config, **{name: value})
        except ValueError as error:
            # what goes with the other fields is the config's own to say
            raise NotSetError("does_not_fit", f"{name} cannot be {json.dumps(value)}: {error}") from None

    def _take(self, config: Any) -> None:
        if config is not self._current:
            self._current = config
            # whoever has a field that can be set has this method
            agent: Any = self._agent
            agent.configure(config)


def _plain(value: Any) -> Any:
    """A value as JSON holds it."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, enum.Enum):
        return value.name.lower()
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value if isinstance(value, bool | int | float | str | None) else str(value)
