"""`suturegrasp evaluate grasping`: the paper's experiment in closed loop, taken up again where it was left."""

import importlib.util
import json
from collections.abc import Callable, Generator, Iterable
from pathlib import Path
from typing import Literal, TypeVar

import cv2

from agents.cli.alone import alone
from agents.cli.evaluate.options import Evaluate
from agents.cli.evaluate.pictures import field_pictures, moments, strip
from agents.cli.evaluate.trials import Table, all_tried
from agents.cli.progress import counted
from agents.cli.recordings.recompute import write_recording
from agents.cli.whole_file import whole_file
from agents.launch.process import EXIT_OK
from agents.simulated_trials.journal import Journal
from agents.simulated_trials.look import Came
from agents.simulated_trials.protocol import Protocol, Tried, threads_of, trials_on
from agents.simulated_trials.report import document, report
from agents.simulated_trials.results import results_of
from agents.simulated_trials.table import overview
from agents.simulated_trials.trial import RIG
from schemas.messages import ImageEncoding
from shared.recording.mcap_file import Note
from shared.runtime.config import ConfigError, parse_config
from shared.terminal import say, show

EXIT_LEFT = 3
JOURNAL, DOCUMENT, PAGE, REPORT = "journal.jsonl", "results.json", "results.md", "report.html"
THREADS, GOALS = (1, 3), (5, 20)
"""Quick, and not."""


def run(options: Evaluate) -> int:
    """Try what is left; the exit status."""
    return taken_up(options.output, lambda: _evaluated(options))


def taken_up(output: Path, evaluated: Callable[[], int]) -> int:
    """The exit status of an evaluation that has a folder to itself."""
    output.mkdir(parents=True, exist_ok=True)
    with alone(output, "evaluation"):
        return evaluated()


def _evaluated(options: Evaluate) -> int:
    if options.record is not None:
        return _recorded(options, options.record)
    journal = Journal(options.output / JOURNAL, None if options.report else protocol_of(options))
    work = [(laid, journal.left(trials_on(journal.protocol, laid))) for laid in threads_of(journal.protocol)]
    left = sum(len(trials) for _, trials in work)
    total = left + len(journal.came)
    try:
        if not options.report:
            todo = [(laid, trials) for laid, trials in work if trials]
            tried = all_tried(journal.protocol, todo, options.jobs, options.output)
            for came in shown(tried, "grasping", total, total - left):
                journal.note(came)
                left -= 1
    except KeyboardInterrupt:
        say("interrupted; the same command goes on where this one was")
    write_results(options.output, journal.protocol, journal.came)
    where = options.output
    say(
        f"{where / PAGE}, {DOCUMENT} and {REPORT} are written; {f'{left} trials are left' if left else 'all was tried'}"
    )
    return EXIT_LEFT if left else EXIT_OK


def _recorded(options: Evaluate, name: str) -> int:
    """Carry out one trial of the folder's evaluation again, and keep all that is said in it."""
    journal = options.output / JOURNAL
    protocol = Journal(journal, None if journal.exists() else protocol_of(options)).protocol
    trials = [trial for laid in threads_of(protocol) for trial in trials_on(protocol, laid) if trial.name == name]
    if not trials:
        example = next(trials_on(protocol, threads_of(protocol)[0])).name
        raise ConfigError(f"--record {name} is no trial of this evaluation; one is {example}")
    table = Table(protocol, trials[0].laid, options.output, ImageEncoding.PNG)
    told = table.tried(trials[0], recorded=True)
    path = options.output / "recorded" / f"{name.replace('/', '_')}.mcap"
    path.parent.mkdir(exist_ok=True)
    with whole_file(path) as unfinished:
        write_recording(unfinished, told.entries, (Note("run", {"rig": RIG}),))
    seen = moments(table.view, told.entries)
    if seen:
        cv2.imwrite(str(path.with_suffix(".png")), strip(seen))
    say(f"{told.came.outcome}: {told.came.sentence}; {path} is written, for suturegrasp view {path}")
    return EXIT_OK


def protocol_of(options: Evaluate) -> Protocol:
    """What the options ask for.

    Raises:
        ConfigError: where they ask for nothing that can be tried.
    """
    if options.jobs < 1:
        raise ConfigError(f"--jobs {options.jobs}: give 1 or more")
    share, most_mm = options.inject
    told = {
        "seed": options.seed,
        "scenarios": [f"{config}/{background}" for config in options.config for background in options.background],
        "threads": options.threads if options.threads is not None else THREADS[not options.quick],
        "goals": options.goals if options.goals is not None else GOALS[not options.quick],
        "policies": options.policies,
        "methods": options.methods,
        "images": images_of(options),
        "judge": options.judge,
        "tool_errors_mm": options.tool_error,
        "hand_eye_mm": options.hand_eye[0],
        "hand_eye_deg": options.hand_eye[1],
        "injected_share": share,
        "injected_mm": most_mm,
        "attempts": options.attempts,
        "tissue": options.tissue,
        "instrument": options.instrument,
    }
    if options.judge == "contact" and not _is_there("mujoco"):
        raise ConfigError("--judge contact needs MuJoCo: install the extra sim (pip install suturegrasp[sim])")
    return parse_config(json.dumps(told), Protocol, "of the evaluation.json")


def images_of(options: Evaluate) -> Literal["traced", "light"]:
    """Which renderer makes the images.

    Raises:
        ConfigError: where it is not there.
    """
    asked = options.images or ("light" if options.quick else "auto")
    if asked == "auto":
        return "traced" if _is_there("mitsuba") else "light"
    if asked == "traced" and not _is_there("mitsuba"):
        raise ConfigError("--images traced needs Mitsuba: install the extra sim, or give --images light")
    return asked


def write_results(folder: Path, protocol: Protocol, came: list[Came]) -> None:
    """Write what the trials come to, and show it."""
    every = [results_of(protocol, came, tool_error_mm) for tool_error_mm in protocol.tool_errors_mm]
    whole = results_of(protocol, came)
    with whole_file(folder / DOCUMENT) as path:
        path.write_text(json.dumps(document(protocol, every, whole), indent=1) + "\n", encoding="utf-8")
    text = overview(protocol, every, whole)
    with whole_file(folder / PAGE) as path:
        path.write_text(text, encoding="utf-8")
    pictures = field_pictures(protocol, came, folder)
    with whole_file(folder / REPORT) as path:
        path.write_text(report(protocol, came, every, whole, pictures), encoding="utf-8")
    for line in text.splitlines():
        show(line)


def _is_there(module: str) -> bool:
    return importlib.util.find_spec(module) is not None


AnyCame = TypeVar("AnyCame", bound=Tried)


def shown(results: Iterable[AnyCame], what: str, total: int, before: int) -> Generator[AnyCame]:
    """The same, with a bar on standard error where that is a terminal."""
    return counted(results, what, total, before, lambda one: one.trial.name)
