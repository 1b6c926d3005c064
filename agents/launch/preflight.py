"""What keeps a rig from being started here, each with its remedy, looked for before anything is started."""

import errno
import re
import socket

from agents.configuration.reading_session import reading_session
from agents.configuration.rig import RigConfig
from shared.runtime.connection import NoRouterError, connected

TCP = re.compile(r"(?:tcp|tls)/(?P<host>.+):(?P<port>\d+)")


def in_the_way(rig: RigConfig) -> str:
    """What speaks against starting it, in one line; empty where nothing does."""
    if not rig.agents_here():
        return (
            "the configuration has no agent for this machine; give it a section such as [camera], see docs/running.md"
        )
    if rig.camera is not None and rig.camera.source == "pipe" and rig.camera.left == "-":
        return (
            "camera.left = '-' reads standard input, which up has none of: give a named pipe, or leave [camera] out "
            "and start suturegrasp run camera behind the program that writes the frames"
        )
    if rig.runs_here("router") and taken(rig.router_endpoint):
        return (
            f"something listens on {rig.router_endpoint} already, perhaps another suturegrasp up: stop it, "
            "give the router another port, or join it with router.start = false"
        )
    return ""


def already_running(rig: RigConfig) -> str:
    """Which agents of the configuration run elsewhere already, in one line; two of a kind would act twice."""
    if rig.runs_here("router"):
        return ""
    try:
        with connected(reading_session(rig)) as connection:
            present = connection.present()
    except NoRouterError:
        return ""
    twice = [f"{kind}/{instance}" for kind, instance in rig.agents_here() if f"{kind}/{instance}" in present]
    return f"{', '.join(twice)} of rig {rig.rig!r} runs already; stop it there, or remove its section" if twice else ""


def taken(endpoint: str) -> bool:
    """Whether somebody listens on an endpoint of this machine; only asked of TCP."""
    if (address := TCP.fullmatch(endpoint)) is None:
        return False
    host, port = address["host"].strip("[]"), int(address["port"])
    try:
        with socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET):
            return False
    except OSError as error:
        return error.errno == errno.EADDRINUSE
