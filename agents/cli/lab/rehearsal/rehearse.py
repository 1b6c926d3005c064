"""`suturegrasp deploy rehearse`: a rig of several hosts on this machine alone, and what may happen to it in a lab.

Every host of the rig's file is a network namespace with the address that the file gives it, its own certificates, and
the processes that its units start. What the rig says of itself is what `status` says on the operator's host.
"""

import contextlib
import datetime
import json
import os
import re
import shlex
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Any

from agents.cli.lab.deploy import layout_of
from agents.cli.lab.options import Deploy
from agents.cli.lab.rehearsal.network import CannotError, Network, connected_hosts
from agents.cli.lab.rehearsal.processes import Processes, faketime
from agents.cli.lab.rehearsal.rehearsed import (
    CONFIG,
    PROGRAM_HERE,
    Started,
    name_in,
    started_on,
    without_hardware,
    write_hosts,
)
from agents.configuration.hosts import OPERATOR
from agents.configuration.rig import RigConfig
from agents.deployment.certificates import issue
from agents.deployment.layout import Layout
from agents.deployment.units import NOT_OURS
from agents.diagnostics.status.agents import RESTARTED
from agents.launch.process import EXIT_OK, EXIT_UNUSABLE, stopping
from agents.registry import Pace, with_pace
from shared.clock import monotonic_s, now_ns
from shared.runtime.config import ConfigError
from shared.terminal import say, show

EXIT_WRONG = 1
STATUS = "status"
STARTS_S, RECOVERS_S = 180.0, 60.0
LOOK_S, RESTART_S = 0.1, 0.5
LINKS_S = 12.0
"""Rates are over two seconds, told once a second, and `status` names a link that was slow for five."""
CLOCKS_S = 20.0
"""`status` asks for clocks every ten seconds, which takes some where agents are slow to answer."""
STEADY = 5
"""So many times in a row `status`, which looks once a second, must find all well.

Rates are over two seconds and told once a second: what a break leaves behind is told within four.
"""
DOCTOR_S = 120.0
LATE = "link to ", "status (slow)", "status (old)"
"""What `doctor` finds late, which no machine that plays several can help."""
RATE = re.compile(r"(\d+) ?(?:Mbit|mbit)(?:/s)?")
SECONDS = re.compile(r"([+-]?\d+(?:\.\d+)?) ?s?")


class RehearsalError(RuntimeError):
    """The rig did not come up; the text says what kept it."""


@dataclass(frozen=True)
class Break:
    """Something that goes wrong for a while.

    Fields:
        what: in words.
        during: makes it so for as long as it lasts.
        least_s: how long it must last for `status` to look at it.
        over_s: how long it must be over before the rig can be called well, for the same reason.
    """

    what: str
    during: Callable[["Rehearsal"], AbstractContextManager[None]]
    least_s: float = 0.0
    over_s: float = 0.0


@dataclass
class Rehearsal:
    """A rig that is rehearsed.

    Fields:
        started: what runs, by name.
        folder: of everything that it writes.
        watcher: the host that `status` runs on.
        beside: where files lie that the rig's file names.
    """

    network: Network
    processes: Processes
    started: dict[str, Started]
    folder: Path
    watcher: str
    beside: Path
    stopped: threading.Event
    _due_s: dict[str, float] = field(default_factory=dict[str, float])
    _read: int = 0

    def start(self, name: str) -> None:
        """Start a process of a host, for the first time or again."""
        one = self.started[name]
        self.processes.start(one.host, name, *one.command, environment=one.environment, folder=self.beside)

    def command(self, *words: str) -> tuple[str, ...]:
        """A command of the operator's on the host that watches."""
        config = str(self.folder / self.watcher / CONFIG)
        return (*PROGRAM_HERE, *words, "--config", config, "--host", self.watcher)

    def documents(self) -> Iterator[dict[str, Any]]:
        """What `status` has said since the last call."""
        with self.processes.log(STATUS).open("rb") as file:
            file.seek(self._read)
            said = file.read()
        whole = said[: said.rfind(b"\n") + 1]
        self._read += len(whole)
        for line in whole.decode(errors="replace").splitlines():
            if line.startswith("{"):
                yield json.loads(line)

    def tend(self) -> None:
        """Start again what has ended, as its unit would.

        Raises:
            RehearsalError: where something cannot run at all.
        """
        for name in self.started:
            status = self.processes.status(name)
            if status == EXIT_UNUSABLE:
                raise RehearsalError(f"{self.processes.ended(name)}; its log is {self.processes.log(name)}")
            if status not in (None, 0) and name not in self._due_s:
                self._due_s[name] = monotonic_s() + RESTART_S
        if said := self.processes.ended(STATUS):
            raise RehearsalError(f"{said}; its log is {self.processes.log(STATUS)}")
        for name in [name for name, due_s in self._due_s.items() if monotonic_s() >= due_s]:
            del self._due_s[name]
            self.start(name)

    def restart_later(self, name: str) -> None:
        """Have something that was killed started again, as its unit would."""
        self._due_s[name] = monotonic_s() + RESTART_S

    def watch(
        self, limit_s: float, until_well: float | None, tell: Callable[[float, str], None], said: set[tuple[str, str]]
    ) -> float | None:
        """Tell what `status` finds wrong and is not `said` yet, for so long; or until all is well, when that was.

        `until_well` is after how many seconds that counts; None to go on in any case.
        """
        began_s, well, well_s = monotonic_s(), 0, 0.0
        while (past_s := monotonic_s() - began_s) < limit_s and not self.stopped.wait(LOOK_S):
            self.tend()
            for document in self.documents():
                well = well + 1 if document["well"] else 0
                well_s = past_s if well == 1 else well_s
                if document["well"] and limit_s == inf:
                    said.clear()
                restarted = [note for note in document["notes"] if note["code"] == RESTARTED]
                for wrong in (*document["wrong"], *restarted):
                    if (kind := (wrong["code"], wrong["about"])) not in said:
                        said.add(kind)
                        tell(past_s, wrong["text"])
            if until_well is not None and well >= STEADY and past_s >= until_well:
                return max(well_s, until_well)
        return None


def rehearse(options: Deploy, rig: RigConfig) -> int:
    """Rehearse a rig; the exit status is 1 where it did not come up, or did not recover.

    Raises:
        ConfigError: where something is asked for that the rig does not have, or this machine cannot play.
    """
    if not options.seconds > 0:
        raise ConfigError(f"--seconds {options.seconds:g} is no time; give how long a break is to last")
    rehearsed, told = without_hardware(rig)
    layout = layout_of(rehearsed)
    breaks = breaks_of(options, rig, layout)
    for sentence in told:
        say(sentence)
    folder = Path(tempfile.mkdtemp(prefix="suturegrasp-rehearsal-"))
    try:
        with _playing(
            rehearsed, layout, folder, options.config.resolve().parent, tuple(dict(options.skew))
        ) as rehearsal:
            return _played(rehearsal, options, breaks)
    except CannotError as error:
        raise ConfigError(f"a rig cannot be rehearsed here: {error}") from None
    except (RehearsalError, subprocess.TimeoutExpired) as error:
        say(str(error))
        return EXIT_WRONG
    finally:
        if options.keep_logs:
            say(f"what every process said lies in {folder}")
        else:
            shutil.rmtree(folder, ignore_errors=True)


def breaks_of(options: Deploy, rig: RigConfig, layout: Layout) -> list[Break]:
    """What is to go wrong, in the order of the options.

    Raises:
        ConfigError: where the rig has no such host or process, or a number is none.
    """
    ours = ((process, host) for host in layout.hosts for process in host.processes if process.kind not in NOT_OURS)
    runs = [name_in(layout, *one) for one in ours]
    return [
        *(_cut(_host(name, rig, "--cut")) for name in options.cut),
        *(_slow(_host(name, rig, "--slow"), _rate(rate)) for name, rate in options.slow),
        *(_kill(name, runs) for name in options.kill),
        *(_skew(_host(name, rig, "--skew"), _number(off, SECONDS, "--skew", "2s")) for name, off in options.skew),
    ]


def _cut(host: str) -> Break:
    return Break(f"{host} is cut off", lambda r: r.network.cut_off(host))


def _slow(host: str, megabits: int) -> Break:
    carries = f"the link of {host} carries {megabits} Mbit/s"
    return Break(carries, lambda r: r.network.narrowed(megabits, (host,)), LINKS_S)


def _kill(name: str, runs: list[str]) -> Break:
    if name not in runs:
        raise ConfigError(f"--kill {name!r} is nothing that the rig runs; it runs {', '.join(runs)}")
    return Break(f"{name} is killed", lambda r: _killed(r, name))


def _skew(host: str, ahead_s: float) -> Break:
    skewed = f"the clock of {host} is {ahead_s:+g} s off"
    return Break(skewed, lambda r: _skewed(r, host, ahead_s), CLOCKS_S, CLOCKS_S)


def _host(name: str, rig: RigConfig, option: str) -> str:
    if name not in rig.hosts:
        raise ConfigError(f"{option} {name} is none of the rig's hosts {', '.join(rig.hosts)}")
    return name


def _number(text: str, pattern: re.Pattern[str], option: str, example: str) -> float:
    found = pattern.fullmatch(text)
    if found is None:
        raise ConfigError(f"{option} ... {text} must read like {example}")
    return float(found[1])


def _rate(text: str) -> int:
    """A rate in Mbit/s."""
    megabits = round(_number(text, RATE, "--slow", "10Mbit"))
    if megabits < 1:
        raise ConfigError(f"--slow ... {text} is no rate; nothing at all is --cut")
    return megabits


@contextlib.contextmanager
def _killed(rehearsal: Rehearsal, name: str) -> Generator[None]:
    # it may have ended by itself a moment ago
    with contextlib.suppress(RuntimeError, KeyError):
        rehearsal.processes.kill(name)
    rehearsal.restart_later(name)
    yield


@contextlib.contextmanager
def _skewed(rehearsal: Rehearsal, host: str, ahead_s: float) -> Generator[None]:
    rehearsal.processes.set_clock(host, ahead_s)
    try:
        yield
    finally:
        rehearsal.processes.set_clock(host, 0.0)


@contextlib.contextmanager
def _playing(
    rig: RigConfig, layout: Layout, folder: Path, beside: Path, clocks: tuple[str, ...]
) -> Generator[Rehearsal]:
    """The rig with all of its processes started, and `status` beside them."""
    if clocks:
        faketime()
    issue(layout, folder, datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC))
    write_hosts(rig, layout, folder)
    names = tuple(host.name for host in layout.hosts)
    started = {one.name: one for host in layout.hosts for one in started_on(layout, host, folder)}
    watchers = [host.name for host in layout.hosts if any(process.kind == OPERATOR for process in host.processes)]
    computing = tuple(name for name in started if name.split()[0] in with_pace(Pace.STEPS_BACK))
    stopped = stopping()
    with contextlib.ExitStack() as stack:
        network = stack.enter_context(connected_hosts(names, {host.name: host.address for host in layout.hosts}))
        processes = stack.enter_context(contextlib.closing(Processes(network, folder, clocks, computing)))
        rehearsal = Rehearsal(network, processes, started, folder, (watchers or names)[0], beside, stopped)
        for name in sorted(started, key=lambda name: name.split()[0] not in ("router", "console")):
            rehearsal.start(name)
        processes.start(rehearsal.watcher, STATUS, *rehearsal.command("status", "--json"))
        for host in layout.hosts:
            runs = ", ".join(one.name for one in started.values() if one.host == host.name)
            say(f"{host.name} ({host.address}): {runs or 'nothing'}")
        yield rehearsal


def _played(rehearsal: Rehearsal, options: Deploy, breaks: list[Break]) -> int:
    wrong = list[str]()
    began_s = rehearsal.watch(STARTS_S, 0.0, lambda _, text: wrong.append(text), set())
    if began_s is None:
        if rehearsal.stopped.is_set():
            return EXIT_OK
        raise RehearsalError(
            f"not all is well after {STARTS_S:.0f} s: {'; '.join(wrong[-3:]) or 'status says nothing'}"
        )
    say(f"all well after {began_s:.0f} s, as status says on {rehearsal.watcher}")
    found = _doctor(rehearsal)
    recovered = [_broken(rehearsal, one, options.seconds) for one in breaks if not rehearsal.stopped.is_set()]
    if options.stay:
        inside = shlex.join([*rehearsal.network.inside(rehearsal.watcher), *rehearsal.command("status")])
        say(f"it runs until Ctrl-C; a command on {rehearsal.watcher}: {inside}")
        rehearsal.watch(inf, None, _tell, set())
    return EXIT_OK if all(recovered) and found else EXIT_WRONG


def _broken(rehearsal: Rehearsal, one: Break, seconds: float) -> bool:
    """Have something go wrong for a while, and tell what is said of it; whether the rig recovered."""

    told, seconds = set[tuple[str, str]](), max(seconds, one.least_s)
    say(f"{one.what}, for {seconds:g} s:")
    for _ in rehearsal.documents():
        pass
    with one.during(rehearsal):
        rehearsal.watch(seconds, None, _tell, told)
    if not told:
        show("  status finds nothing wrong with it")
    during = len(told)

    def tell_after(past_s: float, text: str) -> None:
        if len(told) == during + 1:
            show("  it is over, and what it left behind:")
        _tell(past_s + seconds, text)

    again_s = rehearsal.watch(RECOVERS_S, one.over_s, tell_after, told)
    well = (
        f"all well again {again_s:.1f} s after it ended"
        if again_s is not None
        else f"not well {RECOVERS_S:.0f} s after"
    )
    show(f"  {well}")
    return again_s is not None or rehearsal.stopped.is_set()


def _tell(past_s: float, text: str) -> None:
    show(f"  {past_s:5.1f} s  {text}")


def _doctor(rehearsal: Rehearsal) -> bool:
    """Have `doctor` look at it from the operator's host; whether it finds nothing wrong."""
    if rehearsal.stopped.is_set():
        return True
    command = [*rehearsal.network.inside(rehearsal.watcher), *rehearsal.command("doctor", "--json")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=DOCTOR_S, check=False)
    if not done.stdout.startswith("{"):
        say(f"doctor could not look: {done.stderr.strip() or 'it was stopped'}")
        return False
    findings = json.loads(done.stdout)["findings"]
    wrong = [one for one in findings if one["remedy"]]
    say(f"doctor on {rehearsal.watcher}: {len(findings)} findings, {len(wrong) or 'none'} of them wrong")
    late = [one for one in wrong if one["what"].startswith(LATE)]
    for one in wrong:
        why = f"here all hosts share {os.cpu_count()} processors" if one in late else one["remedy"]
        show(f"  {one['what']}: {one['found']}; {why}")
    return len(late) == len(wrong)
