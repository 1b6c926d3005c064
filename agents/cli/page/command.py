"""`suturegrasp page`: the operator's page, beside a rig that runs or with one that it starts."""

import asyncio
import contextlib
import json
import logging
import os
import ssl
import tempfile
import threading
import webbrowser
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

from agents.cli.live.up import FIRST_CONTACT_S, started
from agents.cli.page.options import Page
from agents.cli.page.recording import RigRecording
from agents.cli.page.trials import trials_of
from agents.configuration.hosts import OPERATOR
from agents.configuration.rig import RigConfig
from agents.diagnostics.status.health_watch import Fare
from agents.diagnostics.status.judgement import judge
from agents.diagnostics.status.watch import StatusWatch
from agents.launch.audit import audit_of
from agents.launch.host_facts import telling
from agents.launch.process import EXIT_OK, stopping
from agents.launch.supervisor import Supervisor
from agents.operator.desk import Desk
from agents.operator.page_server import Access, server_tls, serving
from agents.operator.pictures import Resample
from agents.operator.surroundings import Surroundings
from schemas.messages import StereoCalibration
from shared.clock import now_ns
from shared.rectification import RectificationError, rectification, rectify_image
from shared.runtime.config import ConfigError
from shared.runtime.connection import ROUTER_WAIT_S, Connection, NoRouterError, connected
from shared.runtime.session import on_loopback
from shared.terminal import UsageError, say

LOGGER = logging.getLogger("suturegrasp.page")
LOOK_S = 0.5
LOOPBACK = "127.0.0.1"
LOCAL_NAMES = (LOOPBACK, "localhost", "[::1]")
SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")


def run(rig: RigConfig, options: Page) -> int:
    """Serve until stopped; the exit status."""
    stopped = stopping()
    tls = _tls(rig, options.listen)
    begun = started(rig, restart=True) if options.start else contextlib.nullcontext()
    within_s = FIRST_CONTACT_S if options.start else ROUTER_WAIT_S
    try:
        with begun as supervisor, contextlib.ExitStack() as stack:
            connection = stack.enter_context(connected(rig.session, within_s, stopped))
            watch = stack.enter_context(contextlib.closing(StatusWatch(connection, rig)))
            recording = stack.enter_context(contextlib.closing(RigRecording(rig, connection)))
            watch.start()
            stack.enter_context(telling(connection, rig, OPERATOR, LOGGER))
            around = Surroundings(
                rig=rig.rig,
                arms=tuple(rig.robot),
                audit=_audit(rig),
                resample=_resample,
                wellbeing=lambda: _wellbeing(watch),
                recording=recording,
                trials=None if options.experiment is None else trials_of(options.experiment),
            )
            asyncio.run(_serve(connection, around, options, tls, _until(stopped, supervisor)))
    except NoRouterError as error:
        if stopped.is_set():
            return EXIT_OK
        raise UsageError(str(error)) from None
    except OSError as error:
        raise UsageError(f"the page cannot be served on port {options.port}: {error.strerror or error}") from None
    return EXIT_OK


async def _serve(
    connection: Connection, around: Surroundings, options: Page, tls: ssl.SSLContext | None, until: Callable[[], bool]
) -> None:
    access, listen = Access(), options.listen or LOOPBACK
    names = LOCAL_NAMES if options.listen is None else (_in_address(options.listen),)
    async with serving(Desk(connection, around), access, listen, options.port, names, tls) as (_, address):
        say(f"the operator's page: {address}#token={access.link}")
        opens = options.open and any(os.environ.get(name) for name in SCREENS)
        with _leading_file(f"{address}#token={access.link}") if opens else contextlib.nullcontext() as leading:

            def changed(link: str) -> None:
                if leading is not None:
                    leading.unlink(missing_ok=True)
                say(f"for another screen, open {address}#token={link}")

            access.changed = changed
            if leading is not None:
                webbrowser.open(leading.as_uri())
            while not until():
                await asyncio.sleep(LOOK_S)


@contextlib.contextmanager
def _leading_file(link: str) -> Generator[Path | None]:
    """A file of this user's own that leads a browser to a link: everybody reads in a list of processes what it opens.

    It lies in the home folder, for a browser of a snap reads neither temporary nor hidden folders. It is None where
    that cannot be written: the link was printed too.
    """
    try:
        file, name = tempfile.mkstemp(prefix="suturegrasp-page-", suffix=".html", dir=Path.home())
    except (OSError, RuntimeError):
        yield None
        return
    try:
        with os.fdopen(file, "w", encoding="utf-8") as written:
            written.write(f"<!doctype html><script>location.replace({json.dumps(link)})</script>\n")
        yield Path(name)
    finally:
        Path(name).unlink(missing_ok=True)


def _tls(rig: RigConfig, listen: str | None) -> ssl.SSLContext | None:
    """What the page is served with: nothing on loopback, the operator's certificate elsewhere.

    Raises:
        ConfigError: where it would have to be served without.
    """
    if listen is None or on_loopback(f"tcp/{_in_address(listen)}:1"):
        return None
    identity = rig.session.identity
    if identity is None:
        raise ConfigError(
            f"--listen {listen} leaves this machine, which needs TLS: describe [hosts] and [security], and put "
            "operator into the runs of this host (docs/deployment.md)"
        )
    try:
        return server_tls(str(identity.certificate), str(identity.key))
    except (OSError, ssl.SSLError) as error:
        raise ConfigError(f"the certificate {identity.certificate} cannot be used: {error}") from None


def _in_address(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _until(stopped: threading.Event, supervisor: Supervisor | None) -> Callable[[], bool]:
    """Whether it is over; tells meanwhile what has happened to processes."""

    def over() -> bool:
        for change in supervisor.watch() if supervisor is not None else ():
            say(change.sentence)
        return stopped.is_set()

    return over


def _audit(rig: RigConfig) -> Callable[..., None]:
    log = audit_of(rig, "operator page")

    def written(what: str, **told: Any) -> None:
        log.add(what, now_ns(), **told)

    written("started")
    return written


def _resample(calibration: StereoCalibration) -> Resample | None:
    try:
        map_left = rectification(calibration).map_left
    except RectificationError:
        return None
    return None if map_left is None else lambda image: rectify_image(image, map_left)


def _wellbeing(watch: StatusWatch) -> dict[str, Any]:
    gathered = watch.gathered()
    agents = [{"name": fare.name, "state": fare.state, "rates": _rates(fare)} for fare in gathered.fares]
    return {"agents": agents, "wrong": [{"text": w.text, "grave": w.grave} for w in judge(gathered)]}


def _rates(fare: Fare) -> str:
    outputs = fare.health.outputs if fare.health is not None else ()
    return ", ".join(f"{o.topic.rpartition('/')[2]} {o.rate_hz:.0f}" for o in outputs if o.rate_hz > 0)
