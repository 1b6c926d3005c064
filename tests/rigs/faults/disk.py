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
        for tries_left in reversed(range(TRIES)):
            disk = os.statvfs(self.folder)
            used = (disk.f_blocks - disk.f_bfree) * disk.f_frsize
            try:
                _mount("-o", f"remount,size={used + PAGE}", str(self.folder))
                break
            except CannotError:
                # whoever writes meanwhile may use more by now
                if not tries_left:
                    raise
        try:
            yield
        finally:
            _mount("-o", f"remount,size={ROOM_MB}m", str(self.folder))


@contextmanager
def small_disk(folder: Path) -> Generator[Disk]:
    """A disk mounted at a new folder, and let go of in the end, or by the next one where we are killed.

    Raises:
        CannotError: where this system mounts none.
    """
    for line in Path("/proc/mounts").read_text().splitlines():
        source, place, *_ = line.split()
        if (owner := re.fullmatch(rf"{PREFIX}(\d+)", source)) and not psutil.pid_exists(int(owner[1])):
            _let_go(place)
    folder.mkdir()
    _mount("-t", "tmpfs", "-o", f"size={ROOM_MB}m", f"{PREFIX}{os.getpid()}", str(folder))
    try:
        yield Disk(folder)
    finally:
        _let_go(str(folder))


def _let_go(place: str) -> None:
    subprocess.run(["umount", "--lazy", place], timeout=LIMIT_S, check=False)  # noqa: S607


def _mount(*arguments: str) -> None:
    done = subprocess.run(["mount", *arguments], capture_output=True, text=True, timeout=LIMIT_S, check=False)  # noqa: S607
    if done.returncode != 0:
        raise CannotError(f"this system mounts no disk in memory: {done.stderr.strip()}")
