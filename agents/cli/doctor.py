"""`suturegrasp doctor`: what would keep a rig from running, each with its remedy."""

import importlib.metadata
import pathlib
import platform
import shutil
import socket
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import agents
import schemas
import shared
from agents.camera.image_files import ImageFileError
from agents.camera.sources import SourceError
from agents.cli.builders import build, configured
from agents.cli.in_the_way import in_the_way
from agents.cli.process import EXIT_OK
from agents.cli.rig import RigConfig
from agents.cli.terminal import say
from shared.calibration import CalibrationError
from shared.clock import now_ns
from shared.runtime.clocks import ClockOffset, by_host
from shared.runtime.config import ConfigError
from shared.runtime.connection import NoRouterError, connected
from shared.scene.render import SceneError

EXIT_FOUND = 1
ROUTER_WAIT_S = 1.0
LEAST_FREE_BYTES = 2 << 30
CLOCKS_APART_MS = 100.0
"""Half of what a heartbeat may take; where clocks are farther apart, what is fresh soon seems old, or yet to come."""
FIRST_SANE_NS = 1_700_000_000_000_000_000
"""The end of 2023: a clock before that was never set."""


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at; `remedy` is empty where it is well."""

    what: str
    found: str
    remedy: str = ""


def doctor(rig: RigConfig) -> int:
    """Print every finding; the exit status is 1 where something is wrong."""
    findings = list(examine(rig))
    for finding in findings:
        mark = "WRONG" if finding.remedy else "ok"
        say(f"{mark:5}  {finding.what}: {finding.found}{f'; {finding.remedy}' if finding.remedy else ''}")
    return EXIT_FOUND if any(finding.remedy for finding in findings) else EXIT_OK


def examine(rig: RigConfig) -> Iterator[Finding]:
    """Look at everything in turn."""
    yield _python()
    yield from _names()
    yield _clock()
    yield _disk(rig)
    yield from _agents(rig)
    yield from _rig(rig)


def _python() -> Finding:
    return Finding("Python", f"{platform.python_version()} in {sys.prefix}")


def _names() -> Iterator[Finding]:
    """Our packages have generic names, which another distribution may use too."""
    home = pathlib.Path(schemas.__file__).parents[1]
    providers = importlib.metadata.packages_distributions()
    for package in (agents, shared, schemas):
        name = package.__name__
        others = set(providers.get(name, [])) - {"suturegrasp"}
        place = pathlib.Path(package.__file__ or "").parents[1]
        if others or place != home:
            others_named = ", ".join(sorted(others)) or f"a folder {place}"
            yield Finding(f"package {name}", f"also provided by {others_named}", "use a virtual environment of its own")
        else:
            yield Finding(f"package {name}", f"ours, version {schemas.__version__}")


def _clock() -> Finding:
    if now_ns() < FIRST_SANE_NS:
        return Finding("clock", "it was never set", "set it, with chrony or by hand; captures carry its time")
    return Finding("clock", "set")


def clocks(offsets: Mapping[str, ClockOffset | None], here: str) -> Iterator[Finding]:
    """The clocks of the hosts of these agents by the one here; what cannot be told is unknown."""
    for name in (name for name, offset in offsets.items() if offset is None):
        yield Finding(f"clock of {name}", "unknown, for it gives no answer")
    hosts = by_host(offset for offset in offsets.values() if offset is not None)
    # of this host itself there is nothing to say, unless another one has its name
    others = [h for h in hosts if h.host != here or h.least_ms > CLOCKS_APART_MS]
    for offset in others:
        apart = f"{abs(offset.ahead_ms):.0f} ms {'ahead of' if offset.ahead_ms > 0 else 'behind'} this host"
        found, remedy = f"{apart}, give or take {offset.within_ms:.1f} ms", ""
        if offset.least_ms > CLOCKS_APART_MS:
            remedy = "synchronise both with chrony (chronyc tracking tells how far each is off)"
        elif abs(offset.ahead_ms) + offset.within_ms > CLOCKS_APART_MS:
            found = f"unknown, for its answer takes {2 * offset.within_ms:.0f} ms"
        yield Finding(f"clock of {offset.host}", found, remedy)
    if not others:
        yield Finding("clocks of other hosts", "unknown, for no agent answers from another host")


def _disk(rig: RigConfig) -> Finding:
    folder = rig.recorder.folder if rig.recorder is not None else pathlib.Path()
    existing = next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())
    free = shutil.disk_usage(existing).free
    found = f"{free / (1 << 30):.1f} GiB free for recordings"
    return Finding("disk", found, "make room, a minute of frames takes some 300 MiB" if free < LEAST_FREE_BYTES else "")


def _agents(rig: RigConfig) -> Iterator[Finding]:
    """Each configured agent is built, which reads calibrations and opens sources."""
    for kind, instance in configured(rig):
        name = f"agent {kind} {instance}".removesuffix(" main")
        try:
            build(rig, kind, instance)
        except (ConfigError, SourceError, ImageFileError, CalibrationError, SceneError, OSError) as error:
            yield Finding(name, "cannot start", str(error))
        else:
            yield Finding(name, "can start")


def _rig(rig: RigConfig) -> Iterator[Finding]:
    """The router, and who is there."""
    try:
        with connected(rig.session, ROUTER_WAIT_S) as connection:
            yield Finding("router", f"answers on {rig.router_endpoint}")
            yield Finding("running agents", ", ".join(connection.present()) or "none")
            yield from clocks(connection.clocks(), socket.gethostname())
    except NoRouterError:
        none = f"none answers on {rig.router_endpoint}"
        if rig.runs_here("router"):
            yield Finding("router", f"{none} yet; suturegrasp up starts one", in_the_way(rig))
        else:
            yield Finding("router", none, "start it: suturegrasp router")
