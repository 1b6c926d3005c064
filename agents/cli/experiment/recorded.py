"""A recorder beside the rig of an experiment."""

import contextlib
import threading
from collections.abc import Callable, Generator
from pathlib import Path

from agents.cli.experiment.trial import ExperimentError
from agents.cli.live.up import NO_RECORDER, RECORDER, start_recorder
from agents.configuration.rig import RigConfig
from agents.launch.session_folder import new_session_folder
from agents.launch.supervisor import Supervisor, last_line, supervised
from shared.runtime.connection import ROUTER_WAIT_S, connected
from shared.terminal import say


@contextlib.contextmanager
def recorded(
    rig: RigConfig, folder: Path, wanted: bool, stopped: threading.Event
) -> Generator[tuple[Path | None, Callable[[], None]]]:
    """What records a thread's session, and what raises an ExperimentError where that has ended.

    It is None where that is not wanted, or a recorder of the rig's own does so.

    Raises:
        NoRouterError: where no router answers.
    """
    with connected(rig.session, ROUTER_WAIT_S, stopped) as connection:
        recorders = [name for name in connection.present() if name.startswith(f"{RECORDER}/")]
    session = None
    with supervised(restart=False) as supervisor:
        if wanted and recorders:
            say("a recorder of the rig's own keeps this session")
        elif wanted:
            session = new_session_folder(folder)
            if not start_recorder(supervisor, rig, session):
                say(f"this session is not recorded: {NO_RECORDER}")
                session.path.rmdir()
                session = None
        yield None if session is None else session.recording, lambda: _check(supervisor)
    if session is not None:
        say(last_line(session.log(RECORDER)))


def _check(supervisor: Supervisor) -> None:
    for change in supervisor.watch():
        raise ExperimentError(change.sentence)
