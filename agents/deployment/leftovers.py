"""Removes what an earlier plan of a rig made and today's does not, of hosts that are no more and of what has moved.

Each plan lists what it made in `{rig}.made` beside the hosts' folders, for several rigs may share one. Nothing else is
touched, but for our units by their names, and in the folder of a host that the rig has no more certificates and keys,
which `deploy certificates` made there.
"""

from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from agents.deployment.certificates import CERTIFICATES

LIST = ".made"
UNITS = "systemd/suturegrasp*.service"


def remove_leftovers(folder: Path, rig: str, made: Iterable[PurePosixPath]) -> list[PurePosixPath]:
    """Remove what is left of the plan before, and list what this one made; what was removed, by place in the folder."""
    now = set(made)
    others = {place for path in folder.glob(f"*{LIST}") if path.stem != rig for place in _listed(path)}
    hosts = {place.parts[0] for place in now}
    units = {PurePosixPath(path.relative_to(folder)) for host in hosts for path in (folder / host).glob(UNITS)}
    before = _listed(folder / f"{rig}{LIST}") | units
    gone = {place.parts[0] for place in before} - hosts - {place.parts[0] for place in others}
    stale = before - now - others | {place for host in gone for place in _certificates(folder, host)}
    removed = sorted(place for place in stale if _inside(folder, place) and (folder / place).is_file())
    for place in removed:
        (folder / place).unlink()
        _remove_empty(folder, place.parent)
    (folder / f"{rig}{LIST}").write_text("".join(f"{place}\n" for place in sorted(now)), encoding="utf-8")
    return removed


def _listed(path: Path) -> set[PurePosixPath]:
    """The places in a list; none where there is no list."""
    return {PurePosixPath(line) for line in path.read_text("utf-8").splitlines() if line} if path.is_file() else set()


def _certificates(folder: Path, host: str) -> Iterable[PurePosixPath]:
    home = folder / host / CERTIFICATES
    found = [path for ending in ("pem", "key") for path in home.glob(f"*.{ending}")]
    return (PurePosixPath(path.relative_to(folder)) for path in found)


def _inside(folder: Path, place: PurePosixPath) -> bool:
    """Whether a place is within the folder, whoever has written the list."""
    return (folder / place).resolve().is_relative_to(folder.resolve())


def _remove_empty(folder: Path, place: PurePosixPath) -> None:
    """A folder of the plan that holds nothing any more, and those that hold only such."""
    while place.parts and not any((folder / place).iterdir()):
        (folder / place).rmdir()
        place = place.parent
