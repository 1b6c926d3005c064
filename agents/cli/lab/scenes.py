"""`suturegrasp scenes render`: path-traced stereo pairs with truth, many at once, taken up again where it was left."""

import math
from collections.abc import Iterable

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from agents.cli.lab.scenes_options import Scenes
from agents.launch.process import EXIT_OK, EXIT_UNUSABLE
from schemas.messages import RectifiedStereo, Severity
from shared.calibration import CalibrationError, read_calibration
from shared.rendering.path_traced.batch import LARGEST_OFFSET_PX, Done, Job, make_all, outstanding
from shared.rendering.path_traced.engine import engine
from shared.rendering.path_traced.eyes import Rig, calibrated_rig, rectified_rig
from shared.rendering.path_traced.meshes import driver_parts
from shared.rendering.path_traced.recipe import Recipe
from shared.rendering.render import SceneError
from shared.terminal import complain, say, warn

EXIT_SOME = 1
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
        made = list(shown(make_all(missing, options.workers), len(jobs), len(jobs) - len(missing)))
    except SceneError as error:
        return complain(str(error), EXIT_UNUSABLE)
    say(summary(options, len(jobs), made))
    for one in made:
        if remark := _remark(one):
            warn(remark)
    return EXIT_SOME if any(one.problem for one in made) else EXIT_OK


def jobs_of(options: Scenes) -> list[Job]:
    """A job for each configuration, background and seed.

    Raises:
        SceneError: where the options name something unknown.
    """
    rig = rig_of(options)
    meshes = None if options.meshes is None else str(options.meshes)
    if meshes is not None:
        driver_parts(meshes)
    return [
        Job(
            options.output,
            f"{config}_{background}_{seed:04d}",
            Recipe(config, background, seed, options.extras, options.colour, meshes, options.distance),
            rig,
            options.samples,
        )
        for seed in range(options.seed, options.seed + options.count)
        for config in options.config
        for background in options.background
    ]


def rig_of(options: Scenes) -> Rig:
    """The camera of a calibration, or the rectified one of the published renders.

    Raises:
        SceneError: where the calibration cannot be used.
    """
    if not options.calibration:
        return endoscope(*options.size)
    try:
        read = read_calibration(options.calibration, unit=options.unit, image_size=options.size)
    except CalibrationError as error:
        raise SceneError(str(error)) from error
    for judgement in read.judgements:
        if judgement.severity is Severity.FAULT:
            raise SceneError(f"the calibration cannot be used: {judgement.finding} {judgement.remedy}")
    return calibrated_rig(read.calibration)


def endoscope(width: int, height: int) -> Rig:
    """The rectified camera of the published renders, with images of that size."""
    focal = FOCAL_WIDTHS * width
    middle = (0.5 * (width - 1), 0.5 * (height - 1))
    return rectified_rig(RectifiedStereo(width, height, focal, focal, *middle, BASELINE_MM, 1e-3))


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
    if not all(LEAST_PX <= length <= MOST_PX for length in options.size):
        raise SceneError(f"--size {options.size[0]} {options.size[1]}: give {LEAST_PX} to {MOST_PX} for either")
    if options.output.exists() and not options.output.is_dir():
        raise SceneError(f"--output {options.output} is a file; name a folder")


def shown(done: Iterable[Done], total: int, before: int) -> Iterable[Done]:
    """The same, with a bar on standard error where that is a terminal."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        bar = progress.add_task("rendering", total=total, completed=before)
        for one in done:
            progress.update(bar, advance=1, description=one.name)
            yield one


def _remark(one: Done) -> str:
    """What is to be said of a pair beside that it is there."""
    if one.problem:
        return f"{one.name} was left out: {one.problem}"
    if one.mask_offset_px > LARGEST_OFFSET_PX:
        return (
            f"the masks of {one.name} lie {one.mask_offset_px:.3f} px from its truth, more than "
            f"{LARGEST_OFFSET_PX} px: measure nothing by it"
        )
    return ""


def summary(options: Scenes, total: int, done: list[Done]) -> str:
    """How many pairs there are now, what those that are new took, and how far their masks lie from their truth."""
    made = [one for one in done if not one.problem]
    there = f"{total - len(done) + len(made)} pairs in {options.output}"
    if not done:
        return f"{there}: all were there already"
    if not made:
        return f"{there}, none of them new"
    offsets = [one.mask_offset_px for one in made if not math.isnan(one.mask_offset_px)]
    seconds = sum(one.processor_s for one in made) / len(made)
    truth = (
        f"; masks lie {sum(offsets) / len(offsets):.3f} px from the truth, {max(offsets):.3f} at worst"
        if offsets
        else ""
    )
    return f"{there}, {len(made)} of them new: {seconds:.1f} s of processor time each{truth}"
