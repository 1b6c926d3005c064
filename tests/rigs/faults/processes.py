"""The processes of a lab, which can be stopped too, and see at once where their clocks are set."""

import contextlib
import signal
import subprocess
from collections.abc import Generator

from agents.cli.lab.rehearsal.processes import Processes

STOPS_S = 30.0


def at_once(environment: dict[str, str]) -> dict[str, str]:
    """Of a faked clock: it is seen with the next look, and not within a second.

    Each look reads the file then, of which one that hears a console takes thousands a second.
    """
    kept = {name: value for name, value in environment.items() if name != "FAKETIME_CACHE_DURATION"}
    return {**kept, "FAKETIME_NO_CACHE": "1"} if kept else {}


class LabProcesses(Processes):
    """What runs on the hosts of a lab."""

    @contextlib.contextmanager
    def stopped(self, name: str) -> Generator[None]:
        """A process stands still."""
        self._running[name].send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            self._running[name].send_signal(signal.SIGCONT)

    def said(self, name: str) -> str:
        """What a process printed, as text."""
        return self.log(name).read_text(errors="replace") if self.log(name).exists() else ""

    def all_ended(self) -> list[str]:
        """All that have ended by themselves."""
        return [said for name in self._running if (said := self.ended(name))]

    def stop(self, name: str) -> bool:
        """Ask a process to end; whether it did within a while, or had to be killed."""
        self._running[name].terminate()
        try:
            self._running[name].wait(STOPS_S)
        except subprocess.TimeoutExpired:
            return False
        finally:
            self.forget(name)
        return True

    def _clock_of(self, host: str) -> dict[str, str]:
        return at_once(super()._clock_of(host))
