"""`suturegrasp scenes render`: path-traced stereo pairs with truth, many at once, taken up again where it was left."""

import math

from agents.cli.lab.options import Scenes
from agents.cli.progress import counted
from agents.launch.process import EXIT_OK
from schemas.messages import RectifiedStereo, Severity
from shared.calibration import read_calibration
from shared.rendering.path_traced.batch import LARGEST_OFFSET_PX, Done, Job, make_all, outstanding
from shared.rendering.path_traced.engine import engine
from shared.rendering.path_traced.eyes import Rig, calibrated_rig, rectified_rig
from shared.rendering.path_traced.meshes import driver_parts
from shared.rendering.path_traced.recipe import Recipe
from shared.rendering.render import SceneError
from shared.terminal import say, warn

EXIT_SOME = 1
MOST_PX, LEAST_PX = 3840, 64
FOCAL_WIDTHS = 1000.0 / 960.0
BASELINE_MM = 5.5


def run(options: Scenes) -> int:
    """Render what is missing; the exit status."""
    _check(options)
    jobs = jobs_of(options)
    missing = outstanding(jobs)
    if missing:
        # here rather than in the first worker, so that a missing extra is said at once
        engine()
    done = make_all(missing, options.workers)
    made = list(counted(done, "rendering", len(jobs), len(jobs) - len(missing), lambda one: one.name))
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
        SceneError, CalibrationError: where the calibration cannot be used.
    """
    if not options.calibration:
        return endoscope(*options.size)
    read = read_calibration(options.calibration, unit=options.unit, image_size=options.size)
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
    for name in ("count", "samples", "workers"):
        if (value := getattr(options, name)) < 1:
            raise SceneError(f"--{name} {value}: give 1 or more")
    if options.seed < 0:
        raise SceneError(f"--seed {options.seed}: give 0 or more")
    if not all(LEAST_PX <= length <= MOST_PX for length in options.size):
        raise SceneError(f"--size {options.size[0]} {options.size[1]}: give {LEAST_PX} to {MOST_PX} for either")
    if options.output.exists() and not options.output.is_dir():
        raise SceneError(f"--output {options.output} is a file; name a folder")


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
