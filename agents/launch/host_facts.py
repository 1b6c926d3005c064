"""What each process of a rig knows of its host and its file, to be told to whoever asks."""

import logging
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

from agents.configuration.digest import rig_sections
from agents.configuration.hosts import kind_and_instance
from agents.configuration.rig import RigConfig
from schemas.topics import MAIN
from shared.runtime.config import config_hash
from shared.runtime.connection import Connection
from shared.runtime.facts import Surroundings
from shared.runtime.identity import validity_ns
from shared.runtime.session import SessionSettings
from shared.terminal import say

PATIENCE_S = 3.0
"""Without a router for so long, somebody is told."""


def around(rig: RigConfig, name: str, **own: Any) -> Surroundings:
    """What a process, as `runs` writes it, knows; `own` is what it alone does.

    Raises:
        IdentityError: where its certificate cannot be read.
    """
    identity = rig.identity_of(name)
    return Surroundings(
        certificate_expires_ns=None if identity is None else validity_ns(identity.certificate)[1],
        overrides=rig.overrides,
        rig_sections=rig_sections(rig),
        **own,
    )


@contextmanager
def told_without(session: SessionSettings, what: str) -> Generator[Callable[[], None]]:
    """Say what does not happen, where no router answers for a while; what it gives is called once one did."""
    waiting = threading.Timer(
        PATIENCE_S, say, (f"no router answers on {session.endpoint} yet, and {what} until one does",)
    )
    waiting.daemon = True
    waiting.start()
    try:
        yield waiting.cancel
    finally:
        waiting.cancel()


@contextmanager
def telling(
    connection: Connection,
    rig: RigConfig,
    kind: str,
    logger: logging.Logger,
    fault: Callable[[], str] = str,
    **own: Any,
) -> Generator[None]:
    """Tell how what only looks on fares; of several on one host, the first alone, for they have one name."""
    instance = kind_and_instance(kind, rig.host or MAIN)[1]
    if f"{kind}/{instance}" in connection.present():
        yield
        return
    with connection.reporting(kind, instance, logger, fault, config_hash(rig), around(rig, kind, **own)):
        yield
