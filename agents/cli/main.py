"""The `suturegrasp` command and its sub-commands."""

import os
import sys
from collections.abc import Callable
from typing import Any

from agents.camera import LARGEST_IMAGE_PIXELS
from shared.terminal import UsageError, complain, flush_output, open_missing_streams, show

EXIT_OK, EXIT_UNUSABLE, EXIT_INTERRUPTED = 0, 2, 130


def main(arguments: list[str] | None = None) -> None:
    """Run one command and exit with its status."""
    # OpenCV refuses larger images by their header, before it takes memory for them, and reads this while it loads
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(LARGEST_IMAGE_PIXELS))
    # the agents themselves share the cores; threads that wait for each other's turn cost them a third of their rate
    for threads in ("OPENCV_FOR_THREADS_NUM", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(threads, "1")
    open_missing_streams()
    try:
        try:
            status = _run(sys.argv[1:] if arguments is None else arguments)
        finally:
            flush_output()
    except KeyboardInterrupt:
        status = complain("interrupted", EXIT_INTERRUPTED)
    except OSError as error:
        status = complain(f"the system refused: {error}", EXIT_UNUSABLE)
    sys.exit(status)


def _run(arguments: list[str]) -> int:
    if arguments == ["--version"]:
        from schemas import __version__

        print(f"suturegrasp {__version__}")
        return EXIT_OK
    # Loading OpenCV and SciPy takes a second, during which Ctrl-C must end as quietly as later.
    from agents.cli.command_line import COMPLETION, completion, named, overview, parsed
    from agents.cli.commands import COMMANDS, loaded

    if arguments[:1] == [COMPLETION]:
        completion(arguments)
    if told := overview(arguments):
        show(told)
        return EXIT_OK
    try:
        name, rest = named(arguments)
        options = parsed(name, COMMANDS[name], rest)
    except UsageError as error:
        return complain(str(error), EXIT_UNUSABLE)
    except OSError:
        # parsing prints help and does no more, so nobody reads it
        flush_output()
        return EXIT_OK
    command = COMMANDS[name]
    try:
        run = loaded(command.runs)
    except ImportError as error:
        return complain(f"this command cannot be loaded: {error}", EXIT_UNUSABLE)
    if not command.on_rig:
        return run(options)
    return _on_rig(run, options)


def _on_rig(run: Callable[[Any, Any], int], options: Any) -> int:
    """Carry out a command on the rig that its options name."""
    from agents.configuration.this_host import rig_of
    from shared.runtime.config import ConfigError
    from shared.runtime.connection import NoRouterError

    try:
        return run(rig_of(options.config, options.host), options)
    except (ConfigError, NoRouterError) as error:
        return complain(str(error), EXIT_UNUSABLE)
