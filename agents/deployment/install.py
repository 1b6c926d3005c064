"""Puts a host's part of the plan in its place: configuration, certificates and units; run on that host, as root."""

import filecmp
import os
import shutil
import subprocess
from collections.abc import Iterable, Set
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from agents.deployment.certificates import CERTIFICATES as CERTIFICATES_FOLDER
from agents.deployment.layout import Host
from agents.deployment.places import CERTIFICATES, GROUP, HOME, OPERATORS, RIG_FILE, ROBOT_USERS, UNITS
from agents.deployment.plan import UNITS_FOLDER
from agents.deployment.robot_zenoh import ROBOT_ZENOH
from agents.deployment.units import NOT_OURS, PEOPLE, TARGET, unit_name, user_of
from shared.runtime.identity import AUTHORITY_FILE, IdentityError, check_identity, identity_in

UNIT_FILES = "suturegrasp-*.service"
KEYS_SINCE_254 = ("'RestartSteps'", "'RestartMaxDelaySec'")
"""An older systemd says that it does not know them, and goes on."""


class InstallError(RuntimeError):
    """A host's part that cannot be installed; the text names what is wrong and the remedy."""


@dataclass
class Installed:
    """What was done.

    Fields:
        changed: files that are new or other than before, as they are called on the host.
        removed: units and certificates of processes that run elsewhere now.
        notes: what could not be checked or done here.
    """

    changed: list[PurePosixPath] = field(default_factory=list[PurePosixPath])
    removed: list[str] = field(default_factory=list[str])
    notes: list[str] = field(default_factory=list[str])


def install(folder: Path, host: Host, root: Path = Path("/")) -> Installed:
    """Install what the plan has for this host; everything is checked before anything is written.

    What else lies in `folder`, as where a newer plan was copied over an older one, is left out. `root` is another
    folder than / to see, or to pack, what would be installed; then nobody is made owner of anything, and systemd is
    not told.

    Raises:
        InstallError: where the plan is not complete, or a unit would not be accepted.
    """
    done = Installed()
    sources = _sources(folder, host)
    _check_units([source for source, place in sources if place.parent == UNITS], done)
    real = root == Path("/")
    if real and os.geteuid() != 0:
        raise InstallError("only root may install: sudo suturegrasp deploy install ...")
    if real:
        _make_users(host)
    for source, place in sources:
        target = root / place.relative_to("/")
        if not target.exists() or not filecmp.cmp(source, target, shallow=False):
            done.changed.append(place)
        _put(source, target, _mode(place), real)
    _remove_stale(root, {place for _, place in sources}, done, real)
    if real:
        _tell_systemd(done, host)
    else:
        done.notes.append("systemd was not told, since this is not its root")
    return done


def _sources(folder: Path, host: Host) -> list[tuple[Path, PurePosixPath]]:
    """Every file of the plan for this host and its place."""
    certificates, units = folder / CERTIFICATES_FOLDER, folder / UNITS_FOLDER
    if not any(certificates.glob("*.key")):
        raise InstallError(f"{certificates} holds no certificates; suturegrasp deploy certificates makes them")
    for process in host.processes:
        try:
            check_identity(identity_in(certificates, process.common_name))
        except IdentityError as error:
            raise InstallError(str(error)) from None
    own = [f"{process.common_name}.{ending}" for process in host.processes for ending in ("pem", "key")]
    services = [unit_name(process) for process in host.processes if process.kind not in NOT_OURS]
    beside = [path for path in folder.rglob("*") if path.is_file() and _is_beside(path.relative_to(folder))]
    sources = [
        (folder / RIG_FILE, HOME / RIG_FILE),
        *((path, HOME / PurePosixPath(path.relative_to(folder))) for path in sorted(beside)),
        *((certificates / name, CERTIFICATES / name) for name in (AUTHORITY_FILE, *own)),
        *((units / name, UNITS / name) for name in (*services, TARGET)),
    ]
    if missing := [source for source, _ in sources if not source.is_file()]:
        raise InstallError(f"{missing[0]} is missing; take the whole folder that suturegrasp deploy plan wrote")
    return sources


def _is_beside(relative: Path) -> bool:
    """What the rig's file names, such as a calibration; containers have no part in this."""
    first = relative.parts[0]
    return first not in (CERTIFICATES_FOLDER, UNITS_FOLDER) and relative.name not in (
        RIG_FILE,
        "compose.yaml",
        "router.json5",
    )


def _check_units(units: list[Path], done: Installed) -> None:
    if shutil.which("systemd-analyze") is None:
        done.notes.append("the units were not checked, for there is no systemd-analyze here")
        return
    complaints = verify(units)
    if complaints:
        raise InstallError(f"systemd would not take the units: {complaints[0]}")


def verify(units: Iterable[Path]) -> list[str]:
    """What `systemd-analyze verify` has against units, but for the program not being there yet."""
    files = sorted(str(path.resolve()) for path in units)
    told = subprocess.run(["systemd-analyze", "verify", *files], capture_output=True, text=True, check=False)  # noqa: S607
    own = [line for line in told.stderr.splitlines() if "suturegrasp" in line]
    return [line for line in own if not _expected(line)]


def _expected(line: str) -> bool:
    """What is no fault: a program that is yet to be installed, and keys that systemd before 254 does not know."""
    return "is not executable" in line or ("Unknown key" in line and any(key in line for key in KEYS_SINCE_254))


def _make_users(host: Host) -> None:
    """A system user for each service, which owns nothing and cannot log in, and the groups of people."""
    for group in (GROUP, OPERATORS, ROBOT_USERS):
        if not _known("group", group):
            subprocess.run(["groupadd", "--system", group], check=True)  # noqa: S607
    for process in host.processes:
        if process.kind not in NOT_OURS and not _known("passwd", user_of(process)):
            made = ["useradd", "--system", "--gid", GROUP, "--no-create-home", "--shell", "/usr/sbin/nologin"]
            subprocess.run([*made, user_of(process)], check=True)


def _known(database: str, name: str) -> bool:
    return subprocess.run(["getent", database, name], capture_output=True, check=False).returncode == 0  # noqa: S607


def _mode(place: PurePosixPath) -> int:
    """What people read, each group one key; all others systemd hands out."""
    if place.suffix == ".key":
        return 0o640 if _readers(place) else 0o600
    return 0o644


def _readers(place: PurePosixPath) -> str:
    """The group that reads a key by itself; empty where none does."""
    kind = place.name.split(".")[0]
    return {PEOPLE: OPERATORS, ROBOT_ZENOH: ROBOT_USERS}.get(kind, "") if place.suffix == ".key" else ""


def _put(source: Path, target: Path, mode: int, real: bool) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    if target.parent.name == CERTIFICATES.name:
        # certificates are shown on each link; keys have modes of their own
        target.parent.chmod(0o755)
        if real:
            shutil.chown(target.parent, "root", "root")
    beside = target.with_name(f".{target.name}.new")
    beside.unlink(missing_ok=True)
    beside.touch(mode=0o600 if target.suffix == ".key" else mode)
    shutil.copyfile(source, beside)
    if real and (group := _readers(PurePosixPath(target))):
        shutil.chown(beside, "root", group)
    beside.chmod(mode)
    beside.replace(target)


def _remove_stale(root: Path, planned: Set[PurePosixPath], done: Installed, real: bool) -> None:
    """Nothing runs, and no key lies, where the plan has it no more."""
    for folder, pattern in ((UNITS, UNIT_FILES), (CERTIFICATES, "*.pem"), (CERTIFICATES, "*.key")):
        for path in sorted((root / folder.relative_to("/")).glob(pattern)):
            if folder / path.name in planned:
                continue
            if real and folder == UNITS:
                _systemctl("stop", path.name)
            path.unlink()
            done.removed.append(path.name)


def _tell_systemd(done: Installed, host: Host) -> None:
    if not Path("/run/systemd/system").exists():
        done.notes.append("systemd does not run here; nothing was started")
        return
    _systemctl("daemon-reload")
    _systemctl("enable", TARGET)
    if changed := affected(done.changed, host):
        _systemctl("restart", "--no-block", *changed)
    # an agent is ready once it has found the router, whose host may come last
    _systemctl("start", "--no-block", TARGET)


def affected(changed: Iterable[PurePosixPath], host: Host) -> list[str]:
    """The units that read any of these files: its own unit and certificate one alone, all else every one of them."""
    units: dict[PurePosixPath, str] = {}
    for process in host.processes:
        own = "" if process.kind in NOT_OURS else unit_name(process)
        certificate = CERTIFICATES / f"{process.common_name}.pem"
        units |= {UNITS / own: own, certificate: own, certificate.with_suffix(".key"): own}
    named = {units.get(place) for place in changed}
    return sorted((set(units.values()) if None in named else {unit for unit in named if unit}) - {""})


def _systemctl(*arguments: str) -> None:
    told = subprocess.run(["systemctl", *arguments], capture_output=True, text=True, check=False)  # noqa: S607
    if told.returncode != 0:
        raise InstallError(f"systemctl {' '.join(arguments)} failed: {told.stderr.strip()}")
