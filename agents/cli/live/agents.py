"""The commands that run one process of a rig."""

from agents.cli.live.options import AgentOptions, Guard, Router
from agents.configuration.rig import RigConfig
from schemas.topics import MAIN


def agent(rig: RigConfig, options: AgentOptions) -> int:
    """Run the agent of the kind that these are options of, until it is told to stop; the exit status."""
    from agents.launch.agent_process import run_agent

    return run_agent(rig, options.kind, getattr(options, "arm", None) or MAIN)


def router(rig: RigConfig, _: Router) -> int:
    """Run the rig's router until it is told to stop; the exit status."""
    from agents.launch.router_process import run_router

    return run_router(rig)


def guard(rig: RigConfig, options: Guard) -> int:
    """Watch one arm until stopped; the exit status."""
    from agents.launch.guard_process import run_guard

    return run_guard(rig, options.arm)
