"""`suturegrasp replay`: a recording on the live keys again."""

import contextlib
import os
import sys
from collections.abc import Generator

from agents.cli.recordings.options import Replay
from agents.cli.recordings.replay_keys import steered
from agents.configuration.rig import RigConfig, simulated_rig
from agents.launch.process import EXIT_DAMAGED, EXIT_OK, on_stop
from agents.replay.contents import (
    Contents,
    Selection,
    contents_of,
    name_of,
    select,
    window_ns,
)
from agents.replay.flow import Flow, StuckError
from agents.replay.items import items
from agents.replay.player import Controls, Played, Player
from schemas.messages import Outcome
from shared.clock import monotonic_s
from shared.recording.completeness import completeness
from shared.recording.mcap_file import UntilDamage
from shared.runtime.config import load_config
from shared.runtime.republishing import REPLAY, Republisher, republishing
from shared.runtime.session import SessionSettings
from shared.terminal import UsageError, complain, say, warn

EXIT_INCOMPLETE = 1
FASTEST = 100.0
LISTEN_S = 0.5
"""How long to listen whether anybody else publishes on a key, without being an agent."""
KEPT_RATE = 2.0
"""Up to here a replay mostly sleeps, and may go before others; a faster one would take a processor for itself."""
SWITCH_S = 0.0005
"""How long the thread that reads ahead may keep the one that sends waiting."""


def run(options: Replay) -> int:
    """Replay until the end, or until stopped; the exit status."""
    if not 0 < options.rate <= FASTEST:
        raise UsageError(f"--rate {options.rate:g} must lie above 0, and be {FASTEST:g} at most; see --fast")
    if options.fast and options.rate != 1:
        raise UsageError("--fast goes as fast as consumers take it: leave --rate out")
    contents = contents_of(options.recording)
    for doubt in completeness(options.recording).doubts_of(contents.damage):
        warn(doubt)
    window = window_ns(options.from_, options.to, contents.first_ns, contents.last_ns, contents.zero_ns)
    settings = _settings(options, contents)
    controls = Controls(held=options.step)
    on_stop(controls.stop)
    kept = not options.fast and options.rate <= KEPT_RATE
    with _time_kept() if kept else contextlib.nullcontext(), republishing(settings, waits=options.fast) as republisher:
        selection = _selection(options, contents, republisher, settings.rig)
        _agree(options, selection)
        keys = tuple("/".join((*k.split("/")[:1], settings.rig, *k.split("/")[2:])) for k in selection.keys)
        _refuse_other_publishers(republisher, keys, controls)
        republisher.stand_for(keys)
        for line in _announced(options, selection, settings, window):
            say(line)
        flow = Flow(republisher.progress, republisher.epoch) if options.fast else None
        player = Player(republisher, options.rate, controls, flow)
        commands = [c for c in contents.commands if c.topic in selection.commands]
        began_s, stuck = monotonic_s(), ""
        with steered(controls, by_lines=options.step), player.telling_time(window[0]):
            try:
                began_s = monotonic_s()
                while not controls.stopped:
                    source = items(
                        UntilDamage(options.recording).entries(), selection.keys, commands, window, settings.rig
                    )
                    player.play(source, window[0])
                    if not options.loop:
                        break
            except StuckError as error:
                stuck = str(error)
            took_s = monotonic_s() - began_s
    return _told(options, player.played, took_s, flow, stuck, contents.damage)


@contextlib.contextmanager
def _time_kept() -> Generator[None]:
    """Have this process run before others when its moment has come, where the system lets it.

    All threads that are started meanwhile do so, since one that is kept waiting with the interpreter's lock in its hand
    keeps the one that sends waiting too.
    """
    interval_s, policy = sys.getswitchinterval(), os.SCHED_OTHER
    sys.setswitchinterval(SWITCH_S)
    with contextlib.suppress(OSError, AttributeError):
        policy = os.sched_getscheduler(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    try:
        yield
    finally:
        sys.setswitchinterval(interval_s)
        with contextlib.suppress(OSError, AttributeError):
            os.sched_setscheduler(0, policy, os.sched_param(0))


def _settings(options: Replay, contents: Contents) -> SessionSettings:
    """Where to: the rig that is named, or else configured, or else recorded."""
    rig = simulated_rig() if options.config is None else load_config(options.config, RigConfig)
    recorded = contents.rigs[0] if contents.rigs else rig.rig
    name = options.rig or (recorded if options.config is None else rig.rig)
    return SessionSettings(name, rig.session.endpoint, otherwise=rig.rows_otherwise)


def _selection(options: Replay, contents: Contents, republisher: Republisher, rig: str) -> Selection:
    present = republisher.present_if_told()
    if present is None:
        raise UsageError(f"the router does not tell which agents run on rig {rig}; try again")
    if any(name.startswith(f"{REPLAY}/") for name in present):
        raise UsageError(f"a recording is replayed on rig {rig} already: stop that one, or give another --rig")
    selection = select(contents, options.topics or None, present)
    if not selection.keys and not selection.commands:
        why = "; ".join(sorted({f"{name_of(key)}: {reason}" for key, reason in selection.left_out.items()}))
        raise UsageError(f"nothing is left to be replayed ({why}); name --topics, or another --rig")
    return selection


def _agree(options: Replay, selection: Selection) -> None:
    """Have it confirmed that agents will act on what is sent."""
    if not selection.acted_on or options.yes_execute:
        return
    named = ", ".join(selection.acted_on)
    if not (sys.stdin is not None and sys.stdin.isatty()):
        raise UsageError(f"agents would act on {named}: add --yes-execute if that is meant")
    print(f"agents would act on {named}, and an arm might move. Send it all the same? Type yes: ", end="", flush=True)
    if sys.stdin.readline().strip().lower() != "yes":
        raise UsageError(f"{named} must not be sent unless that is meant; leave it out of --topics")


def _refuse_other_publishers(republisher: Republisher, keys: tuple[str, ...], controls: Controls) -> None:
    with republisher.hearing(keys) as heard:
        controls.wait(LISTEN_S)
    if heard:
        named = ", ".join(sorted(map(name_of, heard)))
        raise UsageError(f"somebody publishes {named} on this rig already: stop it, or give another --rig")


def _announced(options: Replay, selection: Selection, settings: SessionSettings, window: tuple[int, int]) -> list[str]:
    named = ", ".join(dict.fromkeys((*map(name_of, selection.keys), *map(str, selection.commands))))
    seconds = (window[1] - window[0]) * 1e-9
    lines = [f"{options.recording}: {seconds:.1f} s on rig {settings.rig} at {settings.endpoint}: {named}"]
    reasons: dict[str, list[str]] = {}
    for key, reason in selection.left_out.items():
        reasons.setdefault(reason, []).append(name_of(key))
    lines += [f"left out, {reason}: {', '.join(dict.fromkeys(names))}" for reason, names in sorted(reasons.items())]
    if sys.stdin is not None and sys.stdin.isatty():
        lines.append("space holds and goes on, n steps to the next frame, q ends")
    return lines


def _told(options: Replay, played: Played, took_s: float, flow: Flow | None, stuck: str, damage: str) -> int:
    """Say what was sent and how well; the exit status."""
    for topic, answer in played.answers:
        say(f"{topic}: {'accepted' if answer.outcome is Outcome.ACCEPTED else answer.reason}")
    total, spacing = sum(played.sent.values()), played.spacing(options.rate)
    how = f"sent {total} messages on {len(played.sent)} keys in {took_s:.1f} s"
    if flow is not None:
        waited = ", ".join(sorted(flow.consumers)) or "nobody"
        gone = f"; {', '.join(sorted(flow.gone))} left meanwhile" if flow.gone else ""
        say(f"{how}; waited for {waited}{gone}")
    elif spacing is not None:
        errors = f"p50 {spacing.p50_ms:.2f} ms, p99 {spacing.p99_ms:.2f} ms, worst {spacing.worst_ms:.2f} ms"
        say(f"{how}; spacing error {errors}; latest by {played.behind_s * 1e3:.1f} ms")
    else:
        say(how)
    if not (stuck or damage):
        return EXIT_OK
    return complain(f"not all was replayed: {stuck or damage}", EXIT_INCOMPLETE if stuck else EXIT_DAMAGED)
