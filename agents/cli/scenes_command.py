"""`suturegrasp scenes render`: path-traced stereo pairs with truth, many at once, taken up again where it was left."""

import math
from collections.abc import Iterable

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from agents.cli.process import EXIT_OK, EXIT_UNUSABLE
from agents.cli.scenes_options import Scenes
from agents.cli.terminal import complain, say
from schemas.messages import RectifiedStereo
from shared.scene.path_traced.batch import Done, Job, make_all, outstanding
from shared.scene.path_traced.engine import engine
from shared.scene.path_traced.recipe import Recipe
from shared.scene.render import SceneError

MOST_PX, LEAST_PX = 3840, 64
FOCAL_WIDTHS = 1000.0 / 960.0
BASELINE_MM = 5.5


def run(options: Scenes) -> int:
    """Render what is missing; the exit status."""
    try:
        _check(options)
        jobs = jobs_of(options)
        missing = outstanding(jobs)
        if missing:
            # here rather than in the first worker, so that a missing extra is said at once
            engine()
        made = list(_shown(make_all(missing, options.workers), len(jobs), len(jobs) - len(missing)))
    except SceneError as error:
        return complain(str(error), EXIT_UNUSABLE)
    say(_summary(options, len(jobs), made))
    return EXIT_OK


def jobs_of(options: Scenes) -> list[Job]:
    """A job for each configuration, background and seed.

    Raises:
        SceneError: where the options name something unknown.
    """
    camera = endoscope(options.width)
    return [
        Job(
            options.output,
            f"{config}_{background}_{seed:04d}",
            Recipe(config, background, seed, options.extras, options.colour),
            camera,
            options.samples,
        )
        for seed in range(options.seed, options.seed + options.count)
        for config in options.config
        for background in options.background
    ]


def endoscope(width: int) -> RectifiedStereo:
    """The rectified camera of the published renders, with images of that width."""
    height = round(width * 9 / 16)
    focal = FOCAL_WIDTHS * width
    return RectifiedStereo(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1), BASELINE_MM, 1e-3)


def _check(options: Scenes) -> None:
    """Refuse numbers that make no batch."""
    for name, value, least in (
        ("count", options.count, 1),
        ("samples", options.samples, 1),
        ("workers", options.workers, 1),
    ):
        if value < least:
            raise SceneError(f"--{name} {value}: give {least} or more")
    if options.seed < 0:
        raise SceneError(f"--seed {options.seed}: give 0 or more")
    if not LEAST_PX <= options.width <= MOST_PX:
        raise SceneError(f"--width {options.width}: give {LEAST_PX} to {MOST_PX}")
    if options.output.exists() and not options.output.is_dir():
        raise SceneError(f"--output {options.output} is a file; name a folder")


def _shown(done: Iterable[Done], total: int, before: int) -> Iterable[Done]:
    """The same, with a bar on standard error where that is a terminal."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        bar = progress.add_task("rendering", total=total, completed=before)
        for one in done:
            progress.update(bar, advance=1, description=one.name)
            yield one


def _summary(options: Scenes, total: int, made: list[Done]) -> str:
    there = f"{total} pairs in {options.output}"
    if not made:
        return f"{there}: all were there already"
    offsets = [one.mask_offset_px for one in made if not math.isnan(one.mask_offset_px)]
    seconds = sum(one.processor_s for one in made) / len(made)
    truth = (
        f"; masks lie {sum(offsets) / len(offsets):.3f} px from the truth, {max(offsets):.3f} at worst"
        if offsets
        else ""
    )
    return f"{there}, {len(made)} of them new: {seconds:.1f} s of processor time each{truth}"
