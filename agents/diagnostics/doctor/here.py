"""What the doctor finds on this machine: Python, packages, clock, disk, certificates, and whether agents can start."""

import importlib.metadata
import pathlib
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator

import agents
import schemas
import shared
from agents.camera.agent import Camera
from agents.camera.image_files import ImageFileError
from agents.camera.sources import SourceError
from agents.configuration.reading_session import certificate_names
from agents.configuration.rig import RigConfig
from agents.deployment.places import CERTIFICATES, HOME, RIG_FILE, SESSIONS
from agents.diagnostics.doctor.finding import UNKNOWN, Finding
from agents.diagnostics.status.health_watch import name_of, span_of
from agents.diagnostics.status.judgement import LEAST_FREE_BYTES, NS_PER_S, expiry
from agents.launch.builders import build
from shared.calibration import CalibrationError
from shared.clock import now_ns
from shared.rendering.backdrop_files import SceneError
from shared.runtime.config import ConfigError
from shared.runtime.identity import AUTHORITY_FILE, IdentityError, identity_in, validity_ns

FIRST_SANE_NS = 1_700_000_000_000_000_000
"""The end of 2023: a clock before that was never set."""
ASKED_WITHIN_S = 5.0
CHRONYC = ("chronyc", "-c", "tracking")
"""What it prints, with commas between: a reference, its name, the stratum, a time, the offset in seconds, and so on;
the last is Normal where the clock is synchronised (chronyc's manual)."""
TIMEDATECTL = ("timedatectl", "show", "--property=NTPSynchronized", "--value")
ROUTER_CERTIFICATE = "router.main"
RECORDER = "recorder"


def examine_here(rig: RigConfig) -> Iterator[Finding]:
    """Look at this machine."""
    yield Finding("Python", f"{platform.python_version()} in {sys.prefix}")
    yield from _names()
    yield _clock()
    yield synchronisation(len(rig.hosts) > 1)
    yield from _disk(rig)
    yield from _certificates(rig)
    yield from _agents(rig)


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


def _said_by(command: tuple[str, ...]) -> str | None:
    """What a program of this system prints; None where it is not there, fails, or takes long."""
    if shutil.which(command[0]) is None:
        return None
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=ASKED_WITHIN_S)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def synchronisation(several_hosts: bool, said_by: Callable[[tuple[str, ...]], str | None] = _said_by) -> Finding:
    """Whether something keeps this machine's clock right, as far as its system tells."""
    what, remedy = (
        "clock synchronisation",
        "have chrony run, with the same source on every host" if several_hosts else "",
    )
    tracked = (said_by(CHRONYC) or "").split(",")
    if len(tracked) > 10:
        if tracked[-1] == "Normal":
            return Finding(
                what, f"by chrony with {tracked[1] or tracked[0]}, {abs(float(tracked[4])) * 1e3:.3f} ms off"
            )
        return Finding(what, f"chrony runs and says {tracked[-1]!r}", remedy)
    told = said_by(TIMEDATECTL)
    if told == "yes":
        return Finding(what, "by the system's own service, as timedatectl tells; how well it does not tell")
    if told == "no":
        return Finding(what, "none, as timedatectl tells (it knows nothing of PTP)", remedy)
    return Finding(what, f"{UNKNOWN}, for neither chronyc nor timedatectl answers here")


def _disk(rig: RigConfig) -> Iterator[Finding]:
    """Room where this machine records, if it does: units have a folder of their own for that."""
    if rig.hosts and (rig.host is None or RECORDER not in rig.hosts[rig.host].runs):
        return
    folder = rig.recorder.folder if rig.recorder is not None else pathlib.Path()
    if rig.hosts and pathlib.Path(SESSIONS).exists():
        folder = pathlib.Path(SESSIONS)
    existing = next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())
    free = shutil.disk_usage(existing).free
    found = f"{free / (1 << 30):.1f} GiB free for recordings in {existing}"
    remedy = "make room, a minute of everything takes some 700 MB" if free < LEAST_FREE_BYTES else ""
    yield Finding("disk", found, remedy)


def _certificates(rig: RigConfig) -> Iterator[Finding]:
    """Every certificate in this host's folder."""
    if rig.security is None:
        return
    folder, at_ns = rig.security.certificates, now_ns()
    names = certificate_names(folder)
    if not names:
        made = "where suturegrasp deploy certificates has made them, suturegrasp deploy install puts them"
        made = f"{made} into {CERTIFICATES}: look then with --config {HOME / RIG_FILE}"
        yield Finding("certificates", f"there are none in {folder}, or they cannot be read", made)
        return
    router = [ROUTER_CERTIFICATE] if identity_in(folder, ROUTER_CERTIFICATE).certificate.exists() else []
    for name in (*names, *router, AUTHORITY_FILE.removesuffix(".pem")):
        try:
            begins_ns, ends_ns = validity_ns(folder / f"{name}.pem")
        except IdentityError as error:
            yield Finding(f"certificate {name}", "cannot be read", str(error))
            continue
        if begins_ns > at_ns:
            yield Finding(f"certificate {name}", "is not valid yet", "set this machine's clock")
            continue
        wrong = expiry(name, ends_ns, at_ns)
        found = f"expires in {span_of((ends_ns - at_ns) / NS_PER_S)}" if ends_ns > at_ns else "has expired"
        yield Finding(f"certificate {name}", found, "renew it with suturegrasp deploy certificates" if wrong else "")


def _agents(rig: RigConfig) -> Iterator[Finding]:
    """Each configured agent is built, which reads calibrations and opens sources."""
    for kind, instance in rig.agents_here():
        name = f"agent {name_of(kind, instance)}"
        try:
            agent = build(rig, kind, instance)
            if isinstance(agent, Camera):
                # a device that stays open is busy for the camera that starts next
                agent.close()
        except (ConfigError, SourceError, ImageFileError, CalibrationError, SceneError, OSError) as error:
            yield Finding(name, "cannot start", str(error))
        else:
            yield Finding(name, "can start")
