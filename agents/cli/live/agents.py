"""The commands that run one agent as a process."""

from agents.cli.live.options import AgentOptions
from agents.cli.rig.config import RigConfig
from agents.cli.running.agent_process import run_agent
from schemas.topics import MAIN


def agent(rig: RigConfig, options: AgentOptions) -> int:
    """Run the agent of the kind that these are options of, until it is told to stop; the exit status."""
    return run_agent(rig, options.kind, getattr(options, "arm", None) or MAIN)
