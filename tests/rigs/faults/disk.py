"""A disk in memory, which can be full without harm to any other."""

import os
import re
import subprocess
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil

from agents.cli.lab.rehearsal.network import LIMIT_S, PREFIX, CannotError

ROOM_MB = 2048
PAGE = 1 << 16
TRIES = 50


@dataclass(frozen=True)
class Disk:
    """A folder with a size of its own."""

    folder: Path

    @contextmanager
    def full(self) -> Generator[None]:
        """No room is left on it for a while."""
        self._shrink()
        try:
            yield
        finally:
            _mount("-o", f"remount,size={ROOM_MB}m", str(self.folder))

    def _shrink(self) -> None:
        """Leave no more than a page beside what is used; whoever writes meanwhile may use more, which is refused."""
        for tries_left in reversed(range(TRIES)):
            disk = os.statvfs(self.folder)
            used = (disk.f_blocks - disk.f_bfree) * disk.f_frsize
            try:
                _mount("-o", f"remount,size={used + PAGE}", str(self.folder))
            except CannotError:
                if not tries_left:
                    raise
            else:
                return


@contextmanager
def small_disk(folder: Path) -> Generator[Disk]:
    """A disk mounted at a new folder, and let go of in the end, or by the next one where we are killed.

    Raises:
        CannotError: where this system mounts none.
    """
    for source, place in _mounted():
        if (owner := re.fullmatch(rf"{PREFIX}(\d+)", source)) and not psutil.pid_exists(int(owner[1])):
            subprocess.run(["umount", "--lazy", place], timeout=LIMIT_S, check=False)  # noqa: S607
    folder.mkdir()
    _mount("-t", "tmpfs", "-o", f"size={ROOM_MB}m", f"{PREFIX}{os.getpid()}", str(folder))
    try:
        yield Disk(folder)
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], timeout=LIMIT_S, check=False)  # noqa: S607


def _mounted() -> list[tuple[str, str]]:
    lines = Path("/proc/mounts").read_text().splitlines()
    return [(line.split()[0], line.split()[1]) for line in lines]


def _mount(*arguments: str) -> None:
    done = subprocess.run(["mount", *arguments], capture_output=True, text=True, timeout=LIMIT_S, check=False)  # noqa: S607
    if done.returncode != 0:
        raise CannotError(f"this system mounts no disk in memory: {done.stderr.strip()}")
