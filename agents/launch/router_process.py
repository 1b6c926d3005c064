"""`suturegrasp router`: where all agents of a rig meet, with certificates and access rules off loopback."""

import contextlib
import logging

from agents.configuration.rig import RigConfig
from agents.launch.process import EXIT_OK, EXIT_UNUSABLE, LOGGER, log_to_console, stopping
from agents.launch.refused_links import RefusedLinks
from shared.runtime.access import access_control
from shared.runtime.config import ConfigError
from shared.runtime.process import serving
from shared.runtime.session import RouterError, open_router
from shared.runtime.taps import logs_published
from shared.terminal import complain

LOG = logging.getLogger("suturegrasp.router.main")


def run_router(rig: RigConfig) -> int:
    """Run a router until it is told to stop; the exit status."""
    stopped = stopping(for_sure=True)
    with contextlib.ExitStack() as stack:
        stack.callback(LOGGER.removeHandler, log_to_console())
        if rig.security is not None:
            stack.enter_context(contextlib.closing(RefusedLinks(LOG.warning)))
        try:
            identity = rig.identity_of("router")
            # with certificates, each may do what is its own and nothing else
            access = None if identity is None else access_control(rig.rig, rig.common_names(), rig.sites)
            session = stack.enter_context(open_router(rig.router_endpoint, identity, access, rig.sites.connect))
        except (RouterError, ConfigError) as error:
            stack.close()
            return complain(str(error), EXIT_UNUSABLE)
        stack.enter_context(logs_published(session, rig.rig, "router", LOG, rig.rows_otherwise))
        print(f"router on {rig.router_endpoint}", flush=True)
        with serving():
            stopped.wait()
    return EXIT_OK
