"""The `suturegrasp` command and its sub-commands."""

import os
import sys

from agents.camera import LARGEST_IMAGE_PIXELS
from shared.terminal import UsageError, complain, flush_output, open_missing_streams, show

EXIT_OK, EXIT_UNUSABLE, EXIT_INTERRUPTED = 0, 2, 130
TOLD = (
    ("shared.terminal", "UsageError"),
    ("shared.runtime.config", "ConfigError"),
    ("shared.runtime.connection", "NoRouterError"),
    ("shared.runtime.session", "RouterError"),
    ("shared.runtime.replay", "ReplayError"),
    ("shared.calibration.stated", "CalibrationError"),
    ("shared.rectification", "RectificationError"),
    ("shared.recording.entry", "RecordingError"),
    ("shared.rendering.backdrop_files", "SceneError"),
    ("agents.camera.image_files", "ImageFileError"),
    ("agents.deployment.certificates", "AuthorityError"),
    ("agents.deployment.install", "InstallError"),
    ("agents.perception.segmentation.promptable_model", "PromptableFileError"),
    ("agents.replay.contents", "SelectionError"),
    ("agents.replay.contents", "WindowError"),
    ("agents.viewer.sinks", "ViewerError"),
)
"""Errors whose text is a sentence for whoever typed the command; one whose module is not loaded was not raised."""


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
        how = "cannot be read" if isinstance(error, FileNotFoundError) else "cannot be read or written"
        what = f"{error.filename} {how}" if error.filename else "the system refused"
        status = complain(f"{what}: {error.strerror or error}", EXIT_UNUSABLE)
    except Exception as error:
        if not _is_told(error):
            raise
        status = complain(str(error), EXIT_UNUSABLE)
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
    except OSError:
        # parsing prints help and does no more, so nobody reads it
        flush_output()
        return EXIT_OK
    command = COMMANDS[name]
    try:
        run = loaded(command.runs)
    except ImportError as error:
        raise UsageError(f"this command cannot be loaded: {error}") from error
    if not command.on_rig:
        return run(options)
    from agents.configuration.this_host import rig_of

    return run(rig_of(options.config, options.host), options)


def _is_told(error: Exception) -> bool:
    return any(module in sys.modules and isinstance(error, getattr(sys.modules[module], name)) for module, name in TOLD)
