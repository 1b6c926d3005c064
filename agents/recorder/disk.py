"""Whether the disk has room: a recording ends, and says so, before it fills the disk that others write to as well."""

import os
from pathlib import Path

SHARE, MOST_BYTES = 0.02, 500 << 20
"""Left free unless told otherwise: 2 % of the disk, 500 MB at most."""


class DiskGuard:
    """Watches the disk of a folder; `keep_free_bytes` is what is to stay free, None for the rule above."""

    def __init__(self, folder: Path, keep_free_bytes: int | None = None) -> None:
        self._folder, self._keep_bytes = folder, keep_free_bytes

    def problem(self) -> str:
        """Why nothing more should be written; empty where there is room, or the system does not tell."""
        free, keep = self._room()
        if free is None or free >= keep:
            return ""
        return (
            f"{_mb(free)} are free where {self._folder} lies, and {_mb(keep)} are to stay free: "
            "make room, or record elsewhere"
        )

    def has_room_again(self) -> bool:
        """Whether there is twice the room that is to stay free, so that a recording may begin anew and last a while."""
        free, keep = self._room()
        return free is None or free >= 2 * keep

    def _room(self) -> tuple[int | None, int]:
        """Bytes that are free, None where the system does not tell or nothing can fill, and that are to stay free."""
        try:
            disk = os.statvfs(self._folder)
        except OSError:
            return None, 0
        free, total = disk.f_bavail * disk.f_frsize, disk.f_blocks * disk.f_frsize
        keep = min(int(SHARE * total), MOST_BYTES) if self._keep_bytes is None else self._keep_bytes
        # what has no size, such as /dev, is no disk that fills
        return (free if total else None), keep


def _mb(size: int) -> str:
    return f"{size / 1e6:.0f} MB" if size >= 10e6 else f"{size / 1e6:.1f} MB"
