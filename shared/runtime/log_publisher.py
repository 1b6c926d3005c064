"""The log of a process that is no agent, such as the router, as its topic."""

import logging
from collections.abc import Generator
from contextlib import contextmanager

from schemas.topics import LOG, MAIN
from shared.runtime.delivery import RouterLinks
from shared.runtime.log_topic import LogTopic
from shared.runtime.outlets import Outlets
from shared.runtime.replayed_time import AgentClock
from shared.runtime.session import Session


@contextmanager
def logs_published(
    session: Session, rig: str, kind: str, logger: logging.Logger, links: RouterLinks | None = None
) -> Generator[None]:
    """Publish each record of a logger under the key root of `kind`, for as long as it is needed."""
    out = Outlets(session, rig, (kind, MAIN), links or RouterLinks(), AgentClock())
    out.declare(LOG)
    handler = LogTopic(kind, MAIN, lambda record: out.publish(LOG, record))
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        handler.await_quiet()
        out.undeclare()
