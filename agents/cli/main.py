"""The `suturegrasp` command and its sub-commands."""

import importlib
import os
import sys

from agents.camera import LARGEST_IMAGE_PIXELS
from agents.cli.terminal import complain, flush_output, open_missing_streams

EXIT_UNUSABLE, EXIT_INTERRUPTED = 2, 130


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
        return 0
    # Loading OpenCV and SciPy takes a second, during which Ctrl-C must end as quietly as later.
    from agents.cli.calibrate.hand_eye_options import HandEye
    from agents.cli.command_line import parsed
    from agents.cli.evaluate.options import Evaluate
    from agents.cli.lab.emulate_options import Emulate
    from agents.cli.lab.options import LAB_RUNNERS, Deploy
    from agents.cli.lab.scenes_options import Scenes
    from agents.cli.live.options import Demo
    from agents.cli.page.options import Page
    from agents.cli.reconstruct.options import Reconstruct, UsageError
    from agents.cli.recordings.options import RUNNERS, OnRecording
    from agents.cli.segment.options import Segment

    try:
        options = parsed(arguments)
    except UsageError as error:
        return complain(str(error), EXIT_UNUSABLE)
    except OSError:
        # parsing prints help and does no more, so nobody reads it
        flush_output()
        return 0
    if isinstance(options, Reconstruct):
        from agents.cli.reconstruct.command import run

        return run(options)
    if isinstance(options, Segment):
        from agents.cli.segment.command import run as segment

        return segment(options)
    if isinstance(options, Demo):
        from agents.cli.demo.command import demo

        return demo(options)
    if isinstance(options, OnRecording):
        return importlib.import_module(RUNNERS[type(options)]).run(options)
    if isinstance(options, Deploy):
        return importlib.import_module(LAB_RUNNERS[type(options)]).run(options)
    if isinstance(options, Scenes):
        from agents.cli.lab.scenes import run as render_scenes

        return render_scenes(options)
    if isinstance(options, Evaluate):
        from agents.cli.evaluate.command import run as evaluate

        return evaluate(options)
    if isinstance(options, Emulate):
        from agents.cli.lab.emulate import run as emulate

        return emulate(options)
    if isinstance(options, HandEye):
        from agents.cli.calibrate.hand_eye import run as calibrate_hand_eye

        return calibrate_hand_eye(options)
    if isinstance(options, Page):
        from agents.cli.page.command import run as serve_page

        return serve_page(options)
    from agents.cli.live.command import run_live

    return run_live(options)
