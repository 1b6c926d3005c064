"""`suturegrasp experiment`: the paper's protocol on a rig, with a journal that survives whatever ends it."""

import json
import threading
from collections.abc import Callable
from pathlib import Path

from agents.cli.alone import alone
from agents.cli.experiment.options import Experiment
from agents.cli.experiment.recorded import recorded
from agents.cli.experiment.terminal import LeftError, Nobody, Person, outcome_sentence
from agents.cli.experiment.trial import ExperimentError, Rig, carried_out
from agents.cli.whole_file import whole_file
from agents.configuration.rig import RigConfig
from agents.experiment.journal import THREAD, Journal, Protocol
from agents.experiment.results import document, results_of
from agents.experiment.table import page
from agents.launch.process import EXIT_OK, stopping
from shared.runtime.config import ConfigError, parse_config
from shared.runtime.connection import NoRouterError, connected
from shared.terminal import UsageError, complain, say, show

EXIT_LEFT = 3
JOURNAL, PAGE, DOCUMENT = "journal.json", "results.md", "results.json"
DEFAULTS = {"goals": 20, "seed": 1, "arm": "psm1", "verdicts": "operator"}


def experiment(rig: RigConfig, options: Experiment) -> int:
    """Go on with an experiment; exit status 0 once all of it was tried, 3 where something is left.

    Raises:
        UsageError, ConfigError: where the options, the journal or the rig's configuration cannot be used.
    """
    if options.folder is None:
        raise UsageError("give a folder for the journal and the results: suturegrasp experiment FOLDER")
    journal = opened(options.folder, options)
    if journal.protocol.arm not in rig.robot:
        arms = ", ".join(rig.robot) or "none"
        raise ConfigError(f"the configuration has no arm {journal.protocol.arm!r}; its arms: {arms}")
    options.folder.mkdir(parents=True, exist_ok=True)
    write(options.folder, journal)
    if options.report:
        return report(options.folder, journal)
    with alone(options.folder, "experiment"):
        return _tried(rig, options, options.folder, journal)


def opened(folder: Path, options: Experiment) -> Journal:
    """The journal of a folder, or a new one; of one that exists the options may change nothing.

    Raises:
        UsageError, ConfigError: as `experiment`.
    """
    told = {name: getattr(options, name) for name in ("threads", *DEFAULTS)}
    given = {name: value for name, value in told.items() if value not in (None, ())}
    path = folder / JOURNAL
    if path.exists():
        journal = read(path)
        for name, value in given.items():
            if (noted := getattr(journal.protocol, name)) != value:
                raise UsageError(f"{path} has {name} {noted!r}, not {value!r}; leave it out, or give another folder")
        return journal
    if options.report:
        raise UsageError(f"there is no {path}, so there is nothing to report")
    for thread in options.threads:
        if not THREAD.fullmatch(thread):
            raise UsageError(f"--threads {thread} must read CONFIGURATION/BACKGROUND, such as easy/paper")
    if not options.threads or len(set(options.threads)) != len(options.threads):
        raise UsageError("give --threads, each once, such as easy/paper hard/chicken hard/chicken/2")
    return Journal(protocol=parse_config(json.dumps(DEFAULTS | given), Protocol, "of the experiment.json"))


def read(path: Path) -> Journal:
    """A journal.

    Raises:
        ConfigError: where it cannot be read.
    """
    try:
        return parse_config(path.read_text(encoding="utf-8"), Journal, str(path))
    except UnicodeDecodeError:
        raise ConfigError(f"the journal {path} cannot be read: it is no text in UTF-8") from None


def write(folder: Path, journal: Journal) -> None:
    """Write the journal, whole or not at all."""
    with whole_file(folder / JOURNAL) as path:
        path.write_text(journal.model_dump_json(indent=1) + "\n")


def report(folder: Path, journal: Journal) -> int:
    """Write what the attempts come to, and show it."""
    results = results_of(journal)
    with whole_file(folder / DOCUMENT) as path:
        path.write_text(json.dumps(document(journal, results), indent=1) + "\n")
    with whole_file(folder / PAGE) as path:
        path.write_text(page(results))
    for line in page(results).splitlines():
        show(line)
    left = sum(len(journal.left(thread)) for thread in journal.protocol.threads)
    say(
        f"{folder / PAGE} and {folder / DOCUMENT} are written; {f'{left} trials are left' if left else 'all was tried'}"
    )
    return EXIT_LEFT if left else EXIT_OK


def _tried(rig: RigConfig, options: Experiment, folder: Path, journal: Journal) -> int:
    """Try what is left, thread by thread."""
    stopped = stopping()
    kept = _Kept(folder, journal)
    try:
        for thread in journal.protocol.threads:
            if kept.journal.left(thread):
                _thread_tried(rig, options, thread, kept, stopped)
    except (LeftError, ExperimentError, NoRouterError) as error:
        report(folder, kept.journal)
        where = f" --config {options.config}" if options.config is not None else ""
        return complain(f"{error}; to go on: suturegrasp experiment {folder}{where}", EXIT_LEFT)
    return report(folder, kept.journal)


class _Kept:
    """The journal, which is written at every change."""

    def __init__(self, folder: Path, journal: Journal) -> None:
        self.folder, self.journal = folder, journal

    def change(self, changed: Callable[[Journal], Journal]) -> None:
        self.journal = changed(self.journal)
        write(self.folder, self.journal)


def _thread_tried(rig: RigConfig, options: Experiment, thread: str, kept: _Kept, stopped: threading.Event) -> None:
    protocol = kept.journal.protocol
    simulated, real = protocol.verdicts == "simulated", rig.robot[protocol.arm].dvrk is not None
    say(f"thread {thread}: {len(kept.journal.left(thread))} trials")
    with recorded(rig, kept.folder / thread.replace("/", "-"), options.record, stopped) as (session, check):
        if session is not None:
            name = str(session.relative_to(kept.folder))
            kept.change(lambda journal: journal.recorded(thread, name))
        attendant = Nobody(stopped) if simulated and not real else Person(stopped)
        while left := kept.journal.left(thread):
            kept.change(lambda journal, trial=left[0]: journal.begin(trial))
            with connected(rig.session, None, stopped) as connection:
                on = Rig(connection, protocol.arm, attendant, simulated, stopped, check)
                attempt = carried_out(left[0], len(left), on)
            kept.change(lambda journal, attempt=attempt: journal.note(attempt))
            say(outcome_sentence(attempt))
