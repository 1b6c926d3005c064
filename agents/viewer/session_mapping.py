"""How the dataflow fares, as Rerun shows it: health, logs, commands, and what the viewer itself let go.

health/{what}/{agent}       published per second, lost and replaced inputs and their ages, step times, what it uses of
                            its machine, and how far the clock of its host is ahead
log/{who}                   everything that is said in words
viewer/{what}/{topic}       messages shown, thinned, dropped and unreadable
"""

import rerun as rr

from agents.viewer import colours
from agents.viewer.mapping import Entity
from agents.viewer.thinning import IN_A_FULL_MACHINE, MOST_PER_SECOND
from schemas.codec import decode, encoding_name
from schemas.messages import (
    AgentConfiguration,
    AgentHealth,
    CommandRecord,
    GraspGoal,
    HostClocks,
    LogLevel,
    LogRecord,
    Outcome,
)
from schemas.topics import COMMANDS, FRAMES, TOPICS, Delivery

_LEVELS = {
    LogLevel.DEBUG: rr.TextLogLevel.DEBUG,
    LogLevel.INFO: rr.TextLogLevel.INFO,
    LogLevel.WARNING: rr.TextLogLevel.WARN,
    LogLevel.ERROR: rr.TextLogLevel.ERROR,
}
_COMMAND_TYPES = {encoding_name(topic.message): topic.message for topic in TOPICS if topic.delivery is Delivery.COMMAND}


def health_entities(health: AgentHealth) -> list[Entity]:
    """An agent's own account of itself as curves, and its fault in words."""
    agent = _agent(health.agent, health.instance)
    entities: list[Entity] = [
        (f"health/rate_hz/{agent}/{_part(output.topic)}", [rr.Scalars(output.rate_hz)]) for output in health.outputs
    ]
    for given in health.inputs:
        entities += [
            (f"health/lost/{agent}/{_part(given.topic)}", [rr.Scalars(float(given.missed + given.refused))]),
            (f"health/replaced/{agent}/{_part(given.topic)}", [rr.Scalars(float(given.dropped))]),
        ]
        if given.age_ms is not None:
            entities.append((f"health/age_ms/{agent}/{_part(given.topic)}", [rr.Scalars(given.age_ms)]))
    for name, step_ms in (("p50", health.step_ms_p50), ("p99", health.step_ms_p99)):
        if step_ms is not None:
            entities.append((f"health/step_ms/{agent}/{name}", [rr.Scalars(step_ms)]))
    if health.processor_share is not None:
        entities.append((f"health/processor_percent/{agent}", [rr.Scalars(100.0 * health.processor_share)]))
    if health.resident_bytes is not None:
        entities.append((f"health/memory_mib/{agent}", [rr.Scalars(health.resident_bytes / (1 << 20))]))
    if health.fault:
        entities.append(said(f"{health.agent}/{health.instance}", health.fault, rr.TextLogLevel.ERROR))
    return entities


def configuration_entities(configuration: AgentConfiguration) -> list[Entity]:
    """What an agent is set to, in words."""
    are_set = [parameter.name for parameter in configuration.settable if parameter.is_set]
    since = f"{', '.join(are_set)} set since it started" if are_set else "as configured"
    return [said(f"{configuration.agent}/{configuration.instance}", f"{since}: {configuration.parameters}")]


def clock_entities(clocks: HostClocks) -> list[Entity]:
    """How far the clocks of the hosts of agents are ahead, of those that answered."""
    return [
        (f"health/clock_ahead_ms/{_agent(clock.agent, clock.instance)}", [rr.Scalars(clock.ahead_ms)])
        for clock in clocks.clocks
        if clock.ahead_ms is not None
    ]


def log_entities(record: LogRecord) -> list[Entity]:
    """A line of an agent's log."""
    return [said(f"{record.agent}/{record.instance}", record.text, _LEVELS[record.level])]


def command_entities(record: CommandRecord) -> list[Entity]:
    """A command with its answer."""
    answer = record.answer
    level = rr.TextLogLevel.INFO if answer.outcome is Outcome.ACCEPTED else rr.TextLogLevel.WARN
    why = f" ({answer.code}): {answer.reason}" if answer.code else ""
    return [said(str(COMMANDS), f"{command_sentence(record)}: {answer.outcome.name.lower()}{why}", level)]


def command_sentence(record: CommandRecord) -> str:
    """Which command it was, and from whom."""
    try:
        command = decode(_COMMAND_TYPES[record.encoding], record.payload)
    except (KeyError, ValueError):
        return f"{record.topic} (unreadable)"
    wanted = f" of {command.arm}" if hasattr(command, "arm") else ""
    if isinstance(command, GraspGoal):
        wanted += _goal(command)
    return f"{record.topic}{wanted} from {command.header.sender}"


def said(who: str, text: str, level: rr.TextLogLevel = rr.TextLogLevel.INFO) -> Entity:
    """Words, and whose they are; `who` may name an agent and its instance."""
    parts = [part for part in who.split("/") if part and part not in ("*", "main")]
    return "/".join(("log", *map(_part, parts))), [rr.TextLog(f"{'/'.join(parts)}: {text}", level=level)]


def lane(path: str, state: str) -> Entity:
    """A state that lasts until the next one, in a colour of its own where it has one."""
    known = colours.STATES
    looks = rr.StateConfiguration(values=list(known), labels=list(known), colors=list(known.values()))
    return f"lanes/{path}", [looks, rr.StateChange(state=state)]


def nothing_yet() -> list[Entity]:
    """What stands where something is told of that has not happened yet."""
    return [
        ("plan/report", [rr.TextDocument("No goal has been named yet.")]),
        ("plan/check", [rr.TextDocument("No grasp was carried out yet.")]),
    ]


def failure(key: str, why: str, count: int) -> Entity:
    """That a message could not be shown, as the viewer says it."""
    return said("viewer", f"message {count} of {key} that cannot be shown: {why}", rr.TextLogLevel.ERROR)


def pace(there_is_room: bool) -> Entity:
    """How many frames are shown from now on, as the viewer says it."""
    if there_is_room:
        return said("viewer", f"the machine has room again: {MOST_PER_SECOND[FRAMES]} frames a second are shown")
    return said("viewer", f"the machine is full: {IN_A_FULL_MACHINE} frames a second are shown", rr.TextLogLevel.WARN)


def count_entities(what: str, counts: dict[str, int]) -> list[Entity]:
    """What the viewer did with messages, by topic."""
    return [(f"viewer/{what}/{_part(topic)}", [rr.Scalars(float(count))]) for topic, count in counts.items()]


def _goal(goal: GraspGoal) -> str:
    if goal.s is not None:
        return f" at s = {goal.s:.3f}"
    where, place = ("pixel", goal.pixel) if goal.pixel is not None else ("point", goal.point_camera)
    return f" at {where} ({', '.join(f'{number:.4g}' for number in ([] if place is None else place))})"


def _agent(agent: str, instance: str) -> str:
    return _part(agent) if instance == "main" else f"{_part(agent)}/{_part(instance)}"


def _part(name: str) -> str:
    return rr.escape_entity_path_part(name)
