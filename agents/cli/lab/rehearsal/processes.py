"""The processes of a lab, each on its host, which can be killed, and given another clock."""

import contextlib
import os
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from agents.cli.lab.rehearsal.network import CannotError, Network
from agents.launch.supervisor import SUPERVISED, ending

FAKETIME = "faketime/libfaketimeMT.so.1"
FOLDERS = ("/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib", "/usr/local/lib", "/usr/lib64")
ENDS_S = 5.0
YIELDING = 15
"""As `nice` counts."""


def faketime() -> Path:
    """The library that gives a process a clock of its own.

    Raises:
        CannotError: where it is not installed.
    """
    for folder in FOLDERS:
        if (path := Path(folder) / FAKETIME).exists():
            return path
    raise CannotError("clocks are set with libfaketime, which is not installed (Debian: faketime)")


def faked(file: Path) -> dict[str, str]:
    """The environment of a process whose clock stands in a file; it sees what is written there within a second.

    Raises:
        CannotError: where libfaketime is not installed.
    """
    return {
        "LD_PRELOAD": str(faketime()),
        "FAKETIME_TIMESTAMP_FILE": str(file),
        # intervals within a process go on as they do when a real clock is set
        "FAKETIME_DONT_FAKE_MONOTONIC": "1",
        "FAKETIME_CACHE_DURATION": "1",
    }


@dataclass
class Processes:
    """What runs, by name; all of it ends with us, even where we are killed.

    Fields:
        folder: where each writes what it says.
        clocks: hosts with a clock that can be set.
        yielding: processes that leave the processors to others, whose hosts would have their own.
    """

    network: Network
    folder: Path
    clocks: tuple[str, ...] = ()
    yielding: tuple[str, ...] = ()
    _running: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict[str, "subprocess.Popen[bytes]"])

    def start(
        self,
        host: str,
        name: str,
        *command: str,
        environment: Mapping[str, str] | None = None,
        folder: Path | None = None,
    ) -> subprocess.Popen[bytes]:
        """Start a command on a host, in a folder; its output goes to the end of a file of its name."""
        self.forget(name)
        with self.log(name).open("ab") as log:
            self._running[name] = subprocess.Popen(
                [*self.network.inside(host), *command],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
                cwd=folder,
                env={**os.environ, SUPERVISED: "1", **self._clock_of(host), **(environment or {})},
                # a host is none whose processes share one turn with whatever else this machine does
                start_new_session=True,
            )
        if name in self.yielding:
            _yield(self._running[name].pid)
        return self._running[name]

    def kill(self, name: str) -> None:
        """SIGKILL, which nothing in the process hears.

        Raises:
            RuntimeError: where it had ended before.
        """
        process = self._running[name]
        if process.poll() is not None:
            raise RuntimeError(f"{name} had ended before: {self.ended(name)}")
        self.forget(name)

    def set_clock(self, host: str, ahead_s: float) -> None:
        """Set the clock of everything on a host; the other clocks of this system stay as they are."""
        path = self._clock_file(host)
        fresh = path.with_suffix(".new")
        fresh.write_text(f"{ahead_s:+g}s\n")
        fresh.rename(path)

    def log(self, name: str) -> Path:
        """What a process printed."""
        return self.folder / f"{name}.log"

    def status(self, name: str) -> int | None:
        """With which exit status a process has ended by itself; None while it runs."""
        process = self._running.get(name)
        return None if process is None else process.poll()

    def ended(self, name: str) -> str:
        """How a process ended by itself, in words; empty while it runs."""
        status = self.status(name)
        return "" if status is None else f"{name} {ending(status, self.log(name))}"

    def forget(self, name: str) -> None:
        """End a process, if it is still there."""
        process = self._running.pop(name, None)
        if process is not None:
            process.kill()
            process.wait(ENDS_S)
            if process.stdin is not None:
                process.stdin.close()

    def close(self) -> None:
        """Stop all, and end what does not stop."""
        for process in self._running.values():
            process.terminate()
        for process in self._running.values():
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(ENDS_S)
        for name in tuple(self._running):
            self.forget(name)

    def _clock_file(self, host: str) -> Path:
        return self.folder / f"{host}.clock"

    def _clock_of(self, host: str) -> dict[str, str]:
        if host not in self.clocks:
            return {}
        if not self._clock_file(host).exists():
            self.set_clock(host, 0.0)
        return faked(self._clock_file(host))


def _yield(process: int) -> None:
    """Have a process get what others leave of the processors."""
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, process, YIELDING)
        # sessions share out the processors between them by this where the kernel groups them
        Path(f"/proc/{process}/autogroup").write_text(str(YIELDING))
