"""The list of an experiment's goals as the operator's page walks through it; the journal is the experiment's own."""

import threading
from pathlib import Path
from typing import Any

from agents.cli.experiment.command import JOURNAL, read, write
from agents.experiment.journal import CAUSES, Attempt, Journal, Trial
from shared.clock import now_ns
from shared.runtime.config import ConfigError
from shared.terminal import UsageError


class JournalTrials:
    """What is left of an experiment, and what came of it; each verdict is written before it is told."""

    def __init__(self, folder: Path, journal: Journal) -> None:
        self._folder, self._journal, self._lock = folder, journal, threading.Lock()

    def told(self) -> dict[str, Any]:
        """The next goal, and how many are left."""
        with self._lock:
            left = self._left()
        tried = len(self._journal.attempts)
        if not left:
            return {"text": f"All {tried} trials are done.", "causes": CAUSES}
        next_one = left[0]
        where = f"{next_one.thread}: {next_one.policy} at s = {next_one.s:.3f}"
        return {"text": f"{tried} tried, {len(left)} left. Next: {where}.", "causes": CAUSES}

    def begin(self) -> tuple[float, str]:
        """Place and policy of the next goal; that it was begun is written down."""
        with self._lock:
            left = self._left()
            if not left:
                raise RuntimeError("all trials of this experiment are done")
            self._change(self._journal.begin(left[0]))
            return left[0].s, left[0].policy

    def judged(self, plan: dict[str, Any], held: bool, cause: str, note: str, took_s: float | None) -> str:
        """Write down what came of the trial that was begun."""
        with self._lock:
            if self._journal.begun is None:
                raise RuntimeError("no goal of the list was begun")
            if not held and cause not in CAUSES:
                raise RuntimeError("say why it failed")
            attempt = Attempt(
                trial=self._journal.begun[0],
                outcome="held" if held else "failed",
                cause="" if held else cause,  # pyright: ignore[reportArgumentType] - one of CAUSES
                note=note,
                plan_id=plan["id"],
                probability=plan["probability"],
                slide_m=1e-3 * plan["slide_mm"],
                execution_s=took_s,
                at_ns=now_ns(),
            )
            self._change(self._journal.note(attempt))
            return f"{attempt.trial.thread}, {attempt.trial.policy} at s = {attempt.trial.s:.3f}: {attempt.outcome}."

    def _left(self) -> list[Trial]:
        return [trial for thread in self._journal.protocol.threads for trial in self._journal.left(thread)]

    def _change(self, journal: Journal) -> None:
        try:
            write(self._folder, journal)
        except (OSError, UsageError) as error:
            raise RuntimeError(f"the journal cannot be written: {error}") from None
        self._journal = journal


def trials_of(folder: Path) -> JournalTrials:
    """The experiment of a folder.

    Raises:
        ConfigError: where it holds none.
    """
    path = folder / JOURNAL
    if not path.is_file():
        begin = f"begin it with suturegrasp experiment {folder} --threads ..., and leave it with Ctrl-C"
        raise ConfigError(f"there is no journal {path}; {begin}")
    return JournalTrials(folder, read(path))
