"""The rig that a command works on, and what is said where it cannot."""

from collections.abc import Callable
from typing import Any

from agents.cli.rig.config import RigConfig, simulated_rig
from agents.cli.rig.on_rig import OnRig
from agents.cli.rig.this_host import at_host, certificates_of, configured_file
from agents.cli.running.process import EXIT_UNUSABLE
from agents.cli.terminal import complain
from shared.runtime.config import ConfigError, load_config
from shared.runtime.connection import NoRouterError


def rig_of(options: OnRig) -> RigConfig:
    """The rig that a command works on.

    Raises:
        ConfigError: where its configuration cannot be used.
    """
    config = options.config or configured_file()
    if config is None:
        return simulated_rig()
    rig = load_config(config, RigConfig)
    return certificates_of(at_host(rig, options.host), config)


def carried_out(command: Callable[[RigConfig, Any], int], options: OnRig) -> int:
    """Carry out a command on a rig; the exit status."""
    try:
        return command(rig_of(options), options)
    except (ConfigError, NoRouterError) as error:
        return complain(str(error), EXIT_UNUSABLE)
