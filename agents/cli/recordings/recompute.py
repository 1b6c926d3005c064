"""`suturegrasp recompute session.mcap --through perception`: agents on what they consumed, and what differs.

Exit status: 0 where all is the same within tolerance, 1 where something differs, 2 where nothing can be compared, 3
where what can be read of a damaged recording is the same.
"""

import contextlib
import dataclasses
import functools
import mimetypes
import socket
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import schemas
from agents.cli.places import check_new, check_outputs
from agents.cli.recordings.config import (
    ATTACHED,
    attached_config,
    changed,
    found_config,
    in_force,
    recorded_config,
    settings_otherwise,
)
from agents.cli.recordings.options import Recompute
from agents.cli.recordings.recompute_report import ThroughResult, lacking, report
from agents.cli.whole_file import whole_file
from agents.configuration.rig import RigConfig
from agents.launch.builders import build
from agents.launch.process import EXIT_DAMAGED
from agents.recorder.cutting import DerivedFile, derived_from
from agents.registry import NAMES
from agents.replay.differences import compared
from agents.replay.through import Outcome, Stage, replay_through
from schemas.checks import MessageError
from schemas.topics import MAIN, is_known, topic_of
from shared.clock import monotonic_s
from shared.recording.completeness import Completeness, completeness, no_message_in
from shared.recording.derivation import MADE_NO_MORE, UNKNOWN_TOPICS, Anew
from shared.recording.mcap_file import Entry, Note, RecordingWriter, UntilDamage, read_attachments
from shared.runtime.config import ConfigError, load_config
from shared.runtime.parameters import ALLOWED
from shared.runtime.replay import Place, place_of
from shared.terminal import UsageError, say, show, warn

EXIT_SAME, EXIT_DIFFERENT = 0, 1
RUN = "run"
"""The note of a recording that names the versions of what made it."""
COMPUTING = ("numpy", "opencv-python-headless", "scipy")
"""Packages whose versions may round differently."""


def run(options: Recompute) -> int:
    """Replay, say what differs, write what is asked for, and return the exit status."""
    try:
        result = replayed(options)
    except MessageError as error:
        raise UsageError(f"{options.recording} holds a message that cannot be read: {error}") from None
    for doubt in result.said.doubts_of(result.damage):
        warn(doubt)
    for line in report(result):
        show(line)
    if options.output is not None:
        _write(options.output, options.recording, result)
    if not result.comparison.is_same:
        return EXIT_DIFFERENT
    return EXIT_DAMAGED if result.damage else EXIT_SAME


def replayed(options: Recompute) -> ThroughResult:
    """Replay and compare, without a word.

    Raises:
        UsageError, ConfigError, RecordingError, ReplayError, MessageError, OSError: where that cannot be done.
    """
    _check_output(options)
    started_s = monotonic_s()
    entries, notes, unknown, damage = _read(options.recording)
    if not entries:
        raise UsageError(no_message_in(options.recording, damage))
    try:
        given, recorded = _configurations(options)
    except ConfigError as error:
        if not damage or options.config is not None:
            raise
        raise UsageError(f"{damage}, and its configuration is none ({error}); give one by --config") from None
    config = with_simulated_arms(changed(given, options.set))
    changing = [setting for setting in options.set if changed(given, (setting,)) != given]
    as_recorded = with_simulated_arms(recorded) if recorded is not None and config != recorded else None
    stages = _stages(config, options.through.split(","), as_recorded)
    _check_outputs(stages, entries, damage)
    said = completeness(options.recording)
    made_by = _made_by(stages, said, notes)
    otherwise = _otherwise(options, made_by, changing)
    _check_settings(options.set, given, [stage.name for stage in stages])
    outcomes, after = replay_through(stages, entries)
    _check_repeatable(
        outcomes,
        {place_of(entry) for entry in entries},
        damage or ("" if said.finished else f"{options.recording}: {said.sentence}"),
    )
    published = {(e.key, e.epoch, e.sequence): e.published_ns for e in entries}
    outputs = [output for outcome in outcomes for output in outcome.outputs]
    exactly = options.tolerances == "none" or (options.tolerances == "auto" and not otherwise)
    of_another = made_by.get("suturegrasp", schemas.__version__) != schemas.__version__
    comparison = compared(outputs, lambda r: published[r.key, r.epoch, r.sequence], exactly, of_another)
    return ThroughResult(
        before=entries,
        after=after,
        notes=notes,
        outcomes=outcomes,
        comparison=comparison,
        exactly=exactly,
        otherwise=otherwise,
        recorded=recorded,
        used=config,
        said=said,
        unknown=unknown,
        damage=damage,
        wall_s=monotonic_s() - started_s,
    )


def with_simulated_arms(config: RigConfig) -> RigConfig:
    """The configuration with a simulated arm in place of each real one, which no replay may reach.

    A file that told where its base was, or its jaw closed, need not be on this machine: the simulated arm stands in a
    place of its own, and its jaw closes at 0.
    """
    simulated = {"backend": "simulated", "dvrk": None, "T_camera_base_file": None, "jaw_file": None}
    return config.model_copy(update={"robot": {a: s.model_copy(update=simulated) for a, s in config.robot.items()}})


def _configurations(options: Recompute) -> tuple[RigConfig, RigConfig | None]:
    """What to replay with, before `set`, and what was recorded; None where that is not known."""
    if options.config is None:
        recorded = recorded_config(options.recording)
        return recorded, recorded
    given = load_config(options.config, RigConfig)
    try:
        return given, found_config(options.recording)
    except ConfigError:
        return given, None


def _read(path: Path) -> tuple[list[Entry], list[Note], int, str]:
    """The messages whose keys are in the topic table, the notes, and how many have keys of another version.

    Of a damaged recording, what can be read; last, what broke the reading off.
    """
    unknown = 0
    entries: list[Entry] = []
    notes: list[Note] = []
    known = functools.cache(is_known)
    records = UntilDamage(path)
    for record in records:
        if isinstance(record, Note):
            notes.append(record)
        elif known(record.key):
            entries.append(record)
        else:
            unknown += 1
    return entries, notes, unknown, records.damage


def _made_by(stages: Sequence[Stage], said: Completeness, notes: Iterable[Note]) -> dict[str, str]:
    """The versions of what made the outputs of these agents: of the session, or of a replay that they are of."""
    replays = [one for one in said.derived if any(stage.name in one.agents for stage in stages)]
    if replays and all(stage.name in replays[-1].agents for stage in stages):
        return {"suturegrasp": replays[-1].version}
    return next((note.facts for note in notes if note.name == RUN), {})


def _otherwise(options: Recompute, run: dict[str, str], changing: Iterable[str]) -> str:
    """What is otherwise than when the recording was made, as far as it tells; empty where nothing is.

    Args:
        changing: those of `set` that are not as they were.
    """
    packages = {package: version(package) for package in COMPUTING}
    here = {"suturegrasp": schemas.__version__, "host": socket.gethostname(), **packages}
    changes = [
        f"{name} {run[name]} there, {here[name]} here" for name in here if run.get(name, here[name]) != here[name]
    ]
    changes += [f"--set {setting}" for setting in changing]
    return ", ".join([*changes, *([f"--config {options.config}"] if options.config else [])])


def _stages(config: RigConfig, names: Sequence[str], recorded: RigConfig | None) -> list[Stage]:
    found: dict[tuple[str, str], Stage] = {}
    for name in (name.strip() for name in names):
        kind, _, instance = name.partition("/")
        if kind not in NAMES:
            raise UsageError(f"--through {name!r} is no agent that can be replayed; choose from {', '.join(NAMES)}")
        instances = [i for k, i in config.agents_here() if k == kind and instance in ("", i)]
        if not instances:
            raise ConfigError(f"the configuration of this recording has no {name}; give another one by --config")
        found |= {(kind, i): _stage(config, kind, i, recorded) for i in instances}
    return [found[named] for named in sorted(found, key=lambda named: NAMES.index(named[0]))]


def _stage(config: RigConfig, kind: str, instance: str, recorded: RigConfig | None) -> Stage:
    name = kind if instance == MAIN else f"{kind}/{instance}"
    return Stage(name, lambda: build(config, kind, instance), _given(config, kind, instance, recorded))


def _given(config: RigConfig, kind: str, instance: str, recorded: RigConfig | None) -> frozenset[str]:
    """The fields of an agent's config that can be set while it runs, and are otherwise than recorded."""
    if recorded is None:
        return frozenset()
    with contextlib.suppress(ConfigError, OSError, ValueError):
        now, then = (_config_of(rig, kind, instance) for rig in (config, recorded))
        names = (f.name for f in dataclasses.fields(now) if ALLOWED in f.metadata) if now is not None else ()
        return frozenset(name for name in names if getattr(now, name) != getattr(then, name, None))
    return frozenset()


def _config_of(rig: RigConfig, kind: str, instance: str) -> Any:
    with contextlib.closing(build(rig, kind, instance)) as agent:
        return agent.config


def _check_outputs(stages: Sequence[Stage], entries: list[Entry], damage: str) -> None:
    """See that there is something to compare."""
    keys = {entry.key for entry in entries}
    spoke = sorted({key.split("/")[2] for key in keys if topic_of(key).agent in NAMES})
    if not any(_is_of(key, *stage.name.partition("/")[::2]) for stage in stages for key in keys):
        silent = ", ".join(stage.name for stage in stages)
        of_this = f"{damage}, which" if damage else "the recording"
        raise UsageError(f"{of_this} holds no output of {silent}; it has some of: {', '.join(spoke) or 'no agent'}")


def _is_of(key: str, kind: str, instance: str) -> bool:
    """Whether a key is of an agent's outputs."""
    topic = topic_of(key)
    return topic.agent == kind and (not topic.per_arm or not instance or key.split("/")[3] == instance)


def _check_settings(settings: Iterable[str], given: RigConfig, agents: Sequence[str]) -> None:
    """See that one of these agents reads each setting, so that nobody takes the outcome for what it is not of."""
    before = with_simulated_arms(given)
    for setting in settings:
        after = with_simulated_arms(changed(given, (setting,)))
        if after != before and in_force(before, after, agents) == before:
            raise UsageError(
                f"--set {setting} changes nothing, for {', '.join(agents)} does not read it; "
                "name the agent that does by --through"
            )


def _check_repeatable(outcomes: list[Outcome], recorded: Set[Place], lacks: str) -> None:
    """See that something was compared; `lacks` says what may keep it from that."""
    if not any(outcome.outputs for outcome in outcomes):
        silent = ", ".join(outcome.stage for outcome in outcomes)
        nothing = f"{silent} said nothing in this recording, so that there is nothing to compare"
        raise UsageError(f"{nothing}; {lacks}" if lacks else nothing)
    spoke = [outcome for outcome in outcomes if outcome.outputs]
    if not any(outcome.compared for outcome in spoke):
        of_each = "; ".join(f"of {outcome.stage}, {lacking(outcome, recorded)}" for outcome in spoke)
        raise UsageError(f"no output of these agents can be repeated: {of_each}")


def _check_output(options: Recompute) -> None:
    output = options.output
    if output is None:
        return
    if output.suffix not in (".rrd", ".mcap"):
        raise UsageError(f"--output {output} must end in .rrd, to be looked at in Rerun, or in .mcap")
    check_outputs({"--output": output}, [("the recording", options.recording)])
    check_new(output)


def _write(path: Path, recording: Path, result: ThroughResult) -> None:
    if path.suffix == ".mcap":
        with whole_file(path) as unfinished:
            _write_derived(unfinished, recording, result)
    else:
        # the viewer's mapping loads Rerun, which takes longer than many a replay
        from agents.cli.recordings.recompute_report import write_side_by_side

        with whole_file(path) as unfinished:
            write_side_by_side(unfinished, result.before, result.after, result.comparison)
    say(f"wrote {path}")


def _write_derived(path: Path, recording: Path, result: ThroughResult) -> None:
    """Write the recording with the replayed outputs, and with what was done to it."""
    file = DerivedFile(path)
    try:
        said = result.said
        how = f"replayed through {', '.join(outcome.stage for outcome in result.outcomes)}"
        received_ns = {place_of(entry): entry.received_ns for entry in result.before}
        agents = {outcome.stage: _anew(outcome, received_ns) for outcome in result.outcomes}
        left_out = {
            MADE_NO_MORE: result.comparison.made_no_more,
            "outputs that were not recorded, for which it has no place": result.comparison.unrecorded,
            UNKNOWN_TOPICS: result.unknown,
        }
        left_out = {what: count for what, count in left_out.items() if count}
        attached, settings = read_attachments(recording), {"all": "not recorded -> those that were given"}
        if result.recorded is not None:
            effective = in_force(result.recorded, result.used, agents)
            settings = settings_otherwise(result.recorded, effective)
            attached[ATTACHED] = attached_config(attached.get(ATTACHED), effective, agents)
        began_ns = min((entry.published_ns for entry in result.before if not entry.repeated), default=0)
        told = derived_from(recording, said, how, agents=agents, settings=settings, left_out=left_out, from_ns=began_ns)
        if result.damage:
            told = replace(told, source_said=result.damage)
        file.begin(told, attached)
        for note in result.notes:
            file.note(note)
        for entry in result.after:
            file.write(topic_of(entry.key), entry)
        file.close(told, False if result.damage else said.complete, said.lost)
    finally:
        file.abandon()


def _anew(outcome: Outcome, received_ns: Mapping[Place, int]) -> Anew:
    p50, p99 = (float(p) for p in np.percentile(outcome.steps_ms, (50, 99))) if outcome.steps_ms else (None, None)
    keys = tuple(sorted({output.key for output in outcome.outputs}))
    made = sum(output.now is not None for output in outcome.compared)
    kept_ns = tuple(received_ns[place_of(output)] for output in outcome.unrepeatable)
    return Anew(keys, made, len(kept_ns), p50, p99, kept_ns)


def write_recording(
    path: Path, entries: Iterable[Entry], notes: Iterable[Note] = (), attachments: Mapping[str, bytes] | None = None
) -> None:
    """Write a recording; the same content always gives the same bytes.

    Raises:
        OSError: where it cannot be written.
    """
    writer = RecordingWriter(path)
    try:
        for note in notes:
            writer.note(note.name, note.facts)
        for name, data in (attachments or {}).items():
            writer.attach(name, mimetypes.guess_type(name)[0] or "application/octet-stream", data, 0)
        for entry in entries:
            writer.write(topic_of(entry.key), entry)
        writer.close()
    finally:
        writer.abandon()
