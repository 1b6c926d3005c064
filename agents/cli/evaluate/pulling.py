"""`suturegrasp evaluate pulling`: threads pulled through tissue in closed loop, taken up again where it was left."""

import json
from collections.abc import Callable, Generator

from agents.cli.evaluate.command import DOCUMENT, EXIT_LEFT, JOURNAL, PAGE, shown, taken_up
from agents.cli.evaluate.options import EvaluatePulling
from agents.cli.evaluate.pulling_field import Eyes, PullField
from agents.cli.evaluate.pulling_planner import InStep
from agents.cli.evaluate.trials import rig_for
from agents.cli.evaluate.workers import shared_out
from agents.cli.whole_file import whole_file
from agents.launch.process import EXIT_OK
from agents.simulated_trials.pulling.driving import Driver, Task
from agents.simulated_trials.pulling.protocol import (
    PullCame,
    PullJournal,
    PullProtocol,
    PullTrial,
    asked_mm,
    pointed_px,
    trials_of,
)
from agents.simulated_trials.pulling.results import document, overview
from agents.simulated_trials.pulling.trial import Bench, pulled
from agents.simulator.field import MM
from shared.camera import project
from shared.clock import processor_s
from shared.runtime.config import ConfigError, parse_config
from shared.terminal import say, show

METHOD = "refined"


DRIVERS: dict[str, Callable[[Task], Driver]] = {"planner": InStep}
"""Whose decisions can be judged, by name."""


def run(options: EvaluatePulling) -> int:
    """Try what is left; the exit status."""
    return taken_up(options.output, lambda: _evaluated(options))


def _evaluated(options: EvaluatePulling) -> int:
    journal = PullJournal(options.output / JOURNAL, None if options.report else protocol_of(options))
    todo = journal.left(trials_of(journal.protocol))
    left = len(todo)
    try:
        if not options.report:
            came = shared_out(tried_in, [(journal.protocol, trial) for trial in todo], options.jobs)
            for one in shown(came, "pulling", left + len(journal.came), len(journal.came)):
                journal.note(one)
                left -= 1
    except KeyboardInterrupt:
        say("interrupted; the same command goes on where this one was")
    came = sorted(journal.came, key=lambda one: one.trial.number)
    text = overview(journal.protocol, came)
    with whole_file(options.output / DOCUMENT) as path:
        path.write_text(json.dumps(document(journal.protocol, came), indent=1) + "\n", encoding="utf-8")
    with whole_file(options.output / PAGE) as path:
        path.write_text(text, encoding="utf-8")
    for line in text.splitlines():
        show(line)
    where = options.output
    say(f"{where / PAGE} and {DOCUMENT} are written; {f'{left} trials are left' if left else 'all was tried'}")
    return EXIT_LEFT if left else EXIT_OK


def protocol_of(options: EvaluatePulling) -> PullProtocol:
    """What the options ask for.

    Raises:
        ConfigError: where they ask for nothing that can be tried.
    """
    if options.jobs < 1:
        raise ConfigError(f"--jobs {options.jobs}: give 1 or more")
    if options.puller not in DRIVERS:
        raise ConfigError(f"--puller {options.puller} is not known; known: {', '.join(DRIVERS)}")
    told = {
        "puller": options.puller,
        "seed": options.seed,
        "trials": options.trials,
        "tool_error_mm": options.tool_error,
        "hand_eye_mm": options.hand_eye[0],
        "hand_eye_deg": options.hand_eye[1],
        "instrument": options.instrument,
    }
    return parse_config(json.dumps(told), PullProtocol, "of the evaluation.json")


def tried_in(protocol: PullProtocol, trial: PullTrial) -> Generator[PullCame]:
    """What comes of a trial; one in which something raises has failed, and says why.

    Raises:
        SceneError: where its stitch cannot be drawn.
    """
    began_s, field = processor_s(), PullField(protocol, trial)
    try:
        came = pulled(trial, protocol, bench_of(protocol, trial, field))
    except Exception as error:
        came = PullCame(trial=trial, outcome="failed", code="FAULT", sentence=f"{type(error).__name__}: {error}")
    yield came.model_copy(update={"processor_s": processor_s() - began_s})


def bench_of(protocol: PullProtocol, trial: PullTrial, field: PullField) -> Bench:
    """A trial's field, eyes and driver."""
    state = field.world.state
    goal_mm = asked_mm(protocol, trial, state.tail_mm)
    exit_px = pointed_px(protocol, trial, project(field.camera, state.tail[:1])[0][0])
    errors = MM * protocol.tool_error_mm, MM * protocol.hand_eye_mm
    driver = DRIVERS[protocol.puller](Task(MM * goal_mm, exit_px, field.T_camera_base, *errors))
    eyes = Eyes(rig_for(METHOD), driver.began_ns)
    return Bench(
        move=field.move,
        look=lambda arm, at_s: eyes.look(field.images(arm), at_s),
        driver=driver,
        asked_mm=goal_mm,
        knot_mm=field.stitch.knot_mm,
    )
