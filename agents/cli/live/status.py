"""`suturegrasp status`: a live table of a rig with what is wrong in plain words, or documents of JSON."""

import contextlib
import json
import sys
import threading
from collections.abc import Callable, Generator

from rich.console import Console
from rich.live import Live

from agents.cli.live.options import RigStatus
from agents.cli.progress import printed
from agents.configuration.reading_session import reading_session
from agents.configuration.rig import RigConfig
from agents.configuration.topics import overrides
from agents.diagnostics.status.gathered import Gathered
from agents.diagnostics.status.health_watch import SILENT_S
from agents.diagnostics.status.judgement import judge
from agents.diagnostics.status.report import document, report
from agents.diagnostics.status.watch import StatusWatch
from agents.launch.process import EXIT_OK, stopping
from shared.clock import monotonic_s, now_ns
from shared.runtime.connection import ROUTER_WAIT_S, NoRouterError, connected
from shared.terminal import show

EXIT_WRONG = 1
EVERY_S = 1.0
HEARD_WITHIN_S = SILENT_S + 0.5
"""Health comes once a second; who is there and says nothing for so long hangs."""
LOOK_S = 0.05
PAGE_COLUMNS = 160
"""What is written to a file is not cut to a terminal's width."""
Emit = Callable[[Gathered], bool]
"""Shows a moment; whether anybody took it."""


def status(rig: RigConfig, options: RigStatus) -> int:
    """Show how the rig fares until stopped or nobody reads it; or once, with an exit status for all being well."""
    if options.once or not (options.json or sys.stdout.isatty()):
        return _once(rig, options)
    stopped = stopping()
    with _emitting(options.json) as emit, contextlib.ExitStack() as stack:

        def tell(gathered: Gathered) -> None:
            if not emit(gathered):
                stopped.set()

        with _telling_of_no_router(rig, tell):
            try:
                # once, for as long as it takes: each attempt keeps a session of Zenoh that cannot be taken back
                connection = stack.enter_context(connected(reading_session(rig), None, stopped))
            except NoRouterError:
                if stopped.is_set():
                    return EXIT_OK
                raise
        watch = stack.enter_context(contextlib.closing(StatusWatch(connection, rig)))
        watch.start()
        while not stopped.wait(EVERY_S):
            tell(watch.gathered())
    return EXIT_OK


def _once(rig: RigConfig, options: RigStatus) -> int:
    try:
        with connected(reading_session(rig)) as connection, contextlib.closing(StatusWatch(connection, rig)) as watch:
            gathered = gathered_on(watch)
    except NoRouterError:
        gathered = _nothing(rig)
    wrongs = judge(gathered)
    if options.json:
        show(json.dumps(document(gathered, wrongs)))
    else:
        printed(report(gathered, wrongs), None if sys.stdout.isatty() else PAGE_COLUMNS)
    return EXIT_WRONG if any(wrong.grave for wrong in wrongs) else EXIT_OK


def gathered_on(watch: StatusWatch) -> Gathered:
    """What is heard within a few seconds, once everybody who is there was heard, and has answered."""
    deadline_s, turn = monotonic_s() + HEARD_WITHIN_S, threading.Event()
    watch.ask()
    while monotonic_s() < deadline_s and not watch.all_heard():
        turn.wait(LOOK_S)
    return watch.gathered()


def _nothing(rig: RigConfig) -> Gathered:
    return Gathered(
        now_ns(), rig.rig, rig.router_endpoint, False, rig.router.host or "", overrides=overrides(rig.topics)
    )


@contextlib.contextmanager
def _emitting(as_json: bool) -> Generator[Emit]:
    """How a moment is shown: a line of JSON, or in place of the one before on the terminal."""
    if as_json:
        yield lambda gathered: show(json.dumps(document(gathered, judge(gathered))))
        return
    with Live(console=Console(), auto_refresh=False, vertical_overflow="visible") as live:

        def update(gathered: Gathered) -> bool:
            live.update(report(gathered, judge(gathered)), refresh=True)
            return True

        yield update


@contextlib.contextmanager
def _telling_of_no_router(rig: RigConfig, tell_of: Callable[[Gathered], None]) -> Generator[None]:
    """Tell again and again that no router answers, until one does."""
    answered = threading.Event()

    def tell() -> None:
        wait_s = ROUTER_WAIT_S
        while not answered.wait(wait_s):
            tell_of(_nothing(rig))
            wait_s = EVERY_S

    telling = threading.Thread(target=tell, name="no router", daemon=True)
    telling.start()
    try:
        yield
    finally:
        answered.set()
        telling.join()
