"""The log of a process that is no agent, such as the router, as its topic."""

import logging
import os
from collections.abc import Generator
from contextlib import contextmanager

from schemas.codec import encode
from schemas.messages import LogRecord
from schemas.topics import LOG, MAIN, key
from shared.clock import now_ns
from shared.runtime.attachment import Attachment, pack
from shared.runtime.delivery import declare_publisher
from shared.runtime.log_topic import LogTopic
from shared.runtime.session import Session


@contextmanager
def logs_published(session: Session, rig: str, kind: str, logger: logging.Logger) -> Generator[None]:
    """Publish each record of a logger under the key root of `kind`, for as long as it is needed."""
    publisher = declare_publisher(session, key(rig, LOG, MAIN, kind), LOG)
    epoch, sequence = int.from_bytes(os.urandom(7), "big"), 0

    def publish(record: LogRecord) -> None:
        nonlocal sequence
        publisher.put(encode(record), attachment=pack(Attachment(epoch, sequence, now_ns(), 0.0)))
        sequence += 1

    # a handler takes one record after another, whichever thread it comes from
    handler = LogTopic(kind, MAIN, publish)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        publisher.undeclare()
