"""How far a recording is, on a line that is kept up to date: that it runs, how much there is, how full the disk is."""

import glob
import shutil
import threading
from pathlib import Path

from agents.cli.terminal import show
from shared.clock import monotonic_s

EVERY_S = 1.0
MB, GB = 1e6, 1e9
HOUR_S = 3600.0


def tell_progress(path: Path, stopped: threading.Event) -> None:
    """Keep a line on the terminal up to date until stopped."""
    began_s = monotonic_s()
    while not stopped.wait(EVERY_S):
        print(f"\r\x1b[K{sentence(path, monotonic_s() - began_s)}", end="", flush=True)
    show("")


def sentence(path: Path, seconds: float) -> str:
    """What the files of a recording hold after so long, and how long the disk has room for more."""
    parts = path.parent.glob(f"{glob.escape(path.stem)}_part*{path.suffix}")
    files = [file for file in (path, *parts) if file.is_file()]
    size, free = sum(file.stat().st_size for file in files), shutil.disk_usage(path.parent).free
    rate = size / seconds if seconds > 0 else 0.0
    room = f", room for {free / rate / HOUR_S:.1f} h of this" if rate > 0 else ""
    return f"recording {path}: {seconds:.0f} s, {size / MB:.1f} MB; {free / GB:.1f} GB free{room}; Ctrl-C ends it"
