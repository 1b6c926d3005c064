"""How far the course of a thread is right, and its probability one; and the weights behind both.

    .venv/bin/python -m benchmarks.courses --scenes ../shared/data          # renders: a table
    .venv/bin/python -m benchmarks.courses --seeds 40000 40040              # scenes drawn now: a table
    .venv/bin/python -m benchmarks.courses --seeds 20000 20060 30000 30060 --fit    # weights, written into the product

A thread lies over tissue, over a print or a plain ground; behind a shaft that hides a third of it, and in view; its
mask is true, or perception's. The true course is the order in which the true thread passes pieces of its centreline.
Weights are the likeliest ones: the mean of log p(true course) is greatest, with a normal prior about round numbers. For
that each scene counts once more with short gaps cut into either eye's centrelines, as by glints, and now and then with
clutter, or with a needle at its end.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import tyro
from jaxtyping import Float64, Int64
from rich.progress import track
from scipy.optimize import minimize

from agents.camera.scene_source import calibration_of
from agents.reconstruction.refined import course, paths
from agents.reconstruction.refined.method import METHOD
from agents.reconstruction.refined.paths import pieces_of
from agents.reconstruction.refined.sightings import map_of, with_covered_ends
from benchmarks.hiding_tool import hiding_shaft
from benchmarks.measures import evenly, places_along
from benchmarks.scenes import HIDDEN, RENDERS, TRUTH_SAMPLES, Scene, TrueThread, reconstructed, scenes
from benchmarks.tables import CONSOLE, print_rows
from schemas.messages import Centrelines, ThreadObservations
from shared.arc_length import even_parameters
from shared.camera import project
from shared.disparities import disparities_of
from shared.rendering.render import BACKGROUNDS, SceneError, make_scene, render
from shared.rendering.thread_shapes import ShapeError
from shared.splines import evaluate

KINDS = (
    ("crossing", True, True),
    ("crossing", False, True),
    ("crossing", False, False),
    ("hard", True, True),
    ("medium", True, True),
    ("crossing", True, False),
)
"""Of each seed: how the thread lies, whether a shaft hides a third of it, and whether masks are true."""
TRUTH_PLACES, PIECE_PLACES = 240, 60
LEAP, DOUBLE = 0.06, 0.05
"""Of the thread: a piece that leaps so far along it, and pieces that share so much of it, have no place in a course."""
MOST_FITTED_PIECES = 6
START = {
    "join": 1.0,
    "direction_rad": 0.2,
    "bend_of_gap": 0.016,
    "most_bend": 8.0,
    "most_kink": 12.0,
    "most_bend_hidden": 4.0,
    "right_bend": 0.3,
    "goes_on": 0.5,
    "gap": 0.5,
    "gap_hidden": 0.2,
    "gap_unknown": 0.4,
    "disparity_px": 1.0,
    "disparity_of_gap": 1.0,
    "most_step": 6.0,
    "hidden_end": 1.0,
    "tip": 0.5,
    "length": 0.4,
}
SIGNED = "join", "goes_on", "hidden_end", "tip"
"""All others are positive: of those the logarithm is fitted."""
PRIOR, MOST_LOSS = 0.002, 8.0
"""Weight of the squares of how far weights leave START; and what one scene may cost, whose label may be wrong."""
CUT_PX, CUTS, CLUTTER, NEEDLES = (2.0, 12.0), 0.4, 0.15, 0.05
NEEDLE_PX, NEEDLE_GAP_PX = (60.0, 160.0), (3.0, 15.0)
SURE = 0.95
BINS = 0.0, 0.5, 0.8, 0.95, 0.99, 0.999, 1.0


@dataclass(frozen=True)
class Options:
    """What is judged, or learned from."""

    scenes: Path | None = None
    """Folder with renders."""
    seeds: tuple[int, ...] = ()
    """First, and one past the last, of scenes to draw; of several stretches one after the other."""
    fit: bool = False
    """Find the weights, and write them."""


@dataclass(frozen=True)
class Case:
    """What perception saw of a thread that is known."""

    name: str
    observations: ThreadObservations
    truth: Float64[np.ndarray, "n 3"]


@dataclass(frozen=True)
class Labelled:
    """The evidence of a scene's pieces, and the path that the true thread takes through them."""

    name: str
    evidence: course.Evidence
    path: paths.Path


def main() -> None:
    """Judge or fit, and print."""
    options = tyro.cli(Options, description=__doc__)
    cases = [*(rendered(options.scenes) if options.scenes else ()), *drawn(options.seeds)]
    if options.fit:
        random = np.random.default_rng(0)
        every = [*cases, *(replace(c, observations=disturbed(c.observations, random)) for c in cases)]
        weights = fitted([each for case in every if (each := labelled(case)) is not None])
        course.WEIGHTS.write_text(json.dumps(weights, indent=2) + "\n")
        course.fitted_weights.cache_clear()
    print_rows("courses of more than one piece", table([e for case in cases if (e := labelled(case)) is not None]))


def drawn(bounds: tuple[int, ...]) -> Iterator[Case]:
    """Scenes of these seeds."""
    stretches = zip(bounds[::2], bounds[1::2], strict=True)
    seeds = [seed for first, end in stretches for seed in range(first, end)]
    for seed in track(seeds, "drawn", transient=True):
        for config, is_hidden, is_true in KINDS:
            try:
                scene = drawn_scene(config, is_hidden, seed)
            except (SceneError, ShapeError, ValueError):
                continue
            result = reconstructed(scene, scene.masks if is_true else None, method=METHOD)
            name = f"{config}{' behind a shaft' if is_hidden else ''}, {'true masks' if is_true else 'raw'}"
            yield Case(f"{name}: {seed}", result.observations, scene.threads[0].points)


def drawn_scene(config: str, is_hidden: bool, seed: int) -> Scene:
    """A thread of the light renderer over the background that is the seed's turn, behind a shaft or in view.

    Raises:
        SceneError, ShapeError, ValueError: where it cannot be drawn, or hidden.
    """
    scene = make_scene(config, BACKGROUNDS[seed % len(BACKGROUNDS)], seed)
    pair, thread = render(scene), scene.thread
    spline = thread.knots, thread.control_points, thread.degree
    truth = evaluate(*spline, even_parameters(*spline, TRUTH_SAMPLES))
    visible = np.ones((len(truth), 2), bool)
    images, masks = (pair.left_bgr, pair.right_bgr), (pair.coverage_left, pair.coverage_right)
    if is_hidden:
        images, masks = hiding_shaft(scene.camera, truth, visible, seed).painted(images, masks)
    true = TrueThread(truth, visible)
    return Scene("drawn", f"{config} {seed}", images, calibration_of(scene.camera), masks, "true", (true,))


def rendered(data: Path) -> Iterator[Case]:
    """The renders of a folder, raw and with true masks."""
    for name, group, load in scenes(data):
        if group not in RENDERS:
            continue
        scene = load()
        for masks in (scene.masks,) if group == HIDDEN else (None, scene.masks):
            result = reconstructed(scene, masks, method=METHOD)
            what = "raw" if masks is None else "true masks"
            yield Case(f"{group}, {what}: {name}", result.observations, scene.threads[0].points)


def labelled(case: Case) -> Labelled | None:
    """The scene with its true course; None where it has none, or but one piece."""
    seen = case.observations
    left, right = with_covered_ends(seen.centrelines_left), with_covered_ends(seen.centrelines_right)
    pieces = pieces_of(left)
    if not 1 < len(pieces) <= course.MOST_PIECES or not len(right.piece):
        return None
    path = true_path(left, pieces, project(seen.camera, case.truth)[0])
    if not path:
        return None
    size = seen.camera.image_width, seen.camera.image_height
    occluders = None if seen.occluders is None else map_of(seen.occluders.left)
    shown = course.BothImages(left, right, disparities_of(seen), size, occluders)
    return Labelled(case.name, course.evidence_of(shown, pieces), path)


def true_path(
    left: Centrelines, pieces: list[Int64[np.ndarray, "k"]], truth_px: Float64[np.ndarray, "n 2"]
) -> paths.Path:
    """The pieces in the order in which the true thread passes them; empty where one of them leaps along it."""
    true, width = evenly(truth_px, TRUTH_PLACES), float(np.median(left.width_px))
    found: list[tuple[float, float, int, bool]] = []
    for number, piece in enumerate(pieces):
        points = evenly(left.point_px[piece], min(PIECE_PLACES, len(piece)))
        place = places_along(points, true)
        if np.median(np.linalg.norm(points - true[place], axis=1)) > width + 1.0:
            continue
        share = place / (TRUTH_PLACES - 1)
        if np.abs(np.diff(share)).max() > LEAP:
            return []
        found.append((float(share.min()), float(share.max()), number, bool(share[-1] >= share[0])))
    found.sort(key=lambda each: each[0] + each[1])
    if any(before[1] - after[0] > DOUBLE for before, after in pairwise(found)):
        return []
    return [(number, forward) for _, _, number, forward in found]


def disturbed(seen: ThreadObservations, random: np.random.Generator) -> ThreadObservations:
    """The same thread with short gaps in either eye, and now and then with what is none."""
    left, right = seen.centrelines_left, seen.centrelines_right
    if min(len(left.piece), len(right.piece)) < PIECE_PLACES:
        return seen
    if random.random() < CUTS:
        left = cut(left, random)
    if random.random() < CUTS:
        right = cut(right, random)
    if random.random() < CLUTTER:
        left, right = cluttered(left, right, random)
    if random.random() < NEEDLES:
        left, right = with_needle(left, right, random)
    return replace(seen, centrelines_left=left, centrelines_right=right)


def cut(lines: Centrelines, random: np.random.Generator) -> Centrelines:
    """The same lines with one to three gaps more."""
    piece, kept = lines.piece.astype(np.float64), np.ones(len(lines.piece), bool)
    for place in random.integers(0, len(piece), random.integers(1, 4)):
        mine = np.flatnonzero(piece == piece[place])
        at, half = int(np.searchsorted(mine, place)), 1 + int(random.uniform(*CUT_PX) / 2)
        kept[mine[max(0, at - half) : at + half]] = False
        piece[mine[at:]] += random.uniform(0.1, 0.4)
    number = np.unique(piece[kept], return_inverse=True)[1]
    order = np.argsort(number, kind="stable")
    part = Centrelines(lines.point_px[kept], np.sort(number), lines.width_px[kept], lines.deviation_px[kept])
    return replace(
        part, point_px=part.point_px[order], width_px=part.width_px[order], deviation_px=part.deviation_px[order]
    )


def cluttered(left: Centrelines, right: Centrelines, random: np.random.Generator) -> tuple[Centrelines, Centrelines]:
    """Both with one to three bent lines beside the thread, of which the right eye shows some."""
    for _ in range(random.integers(1, 4)):
        count = int(np.exp(random.uniform(np.log(6), np.log(75))))
        heading = random.uniform(0, 2 * np.pi) + random.normal(0, 1 / 30) * np.arange(count)
        line = np.cumsum(2.0 * np.column_stack((np.cos(heading), np.sin(heading))), axis=0)
        line += left.point_px[random.integers(len(left.point_px))] + random.normal(0, 60, 2)
        if (line < 5).any() or np.linalg.norm(left.point_px[:, None] - line[None, ::4], axis=2).min() < 8:
            continue
        left = with_line(left, line)
        if random.random() < 0.6:
            right = with_line(right, line - (random.uniform(40, 75), 0.0))
    return left, right


def with_needle(left: Centrelines, right: Centrelines, random: np.random.Generator) -> tuple[Centrelines, Centrelines]:
    """Both with an arc that begins beside an end of the left lines, in any direction, at the depth of a right end."""
    ends = np.flatnonzero(np.diff(left.piece, prepend=-1, append=-1))
    length, start = random.uniform(*NEEDLE_PX), random.uniform(0, 2 * np.pi)
    heading = start + random.choice((-1, 1)) * np.linspace(0.0, random.uniform(1.5, 3.2), int(length / 2))
    gap = random.uniform(*NEEDLE_GAP_PX) * np.array((np.cos(start), np.sin(start)))
    end = left.point_px[min(int(random.choice(ends)), len(left.point_px) - 1)]
    line = end + gap + np.cumsum(2.0 * np.column_stack((np.cos(heading), np.sin(heading))), axis=0)
    others = left.point_px[np.linalg.norm(left.point_px - end, axis=1) > 2 * np.linalg.norm(gap)]
    if (line < 5).any() or not len(others) or np.linalg.norm(others[:, None] - line[None, ::4], axis=2).min() < 8:
        return left, right
    right_ends = right.point_px[np.flatnonzero(np.diff(right.piece, prepend=-1))]
    near = right_ends[np.abs(right_ends[:, 1] - end[1]).argmin()]
    shift = end[0] - near[0] if abs(near[1] - end[1]) < NEEDLE_GAP_PX[1] else random.uniform(40, 75)
    return with_line(left, line), with_line(right, line - (shift, 0.0))


def with_line(lines: Centrelines, line: Float64[np.ndarray, "n 2"]) -> Centrelines:
    """The lines with one more."""
    count = len(line)
    return Centrelines(
        np.vstack((lines.point_px, line)),
        np.append(lines.piece, np.full(count, lines.piece[-1] + 1)),
        np.append(lines.width_px, np.full(count, np.median(lines.width_px))),
        np.append(lines.deviation_px, np.full(count, np.median(lines.deviation_px))),
    )


def fitted(examples: list[Labelled]) -> dict[str, float]:
    """The likeliest weights."""
    groups = [
        (some, stacked(some))
        for count in range(2, MOST_FITTED_PIECES + 1)
        if (some := [each for each in examples if each.evidence.length.shape[-1] == count])
    ]
    start = numbers_of(START)

    def loss(numbers: Float64[np.ndarray, "w"]) -> float:
        each = np.concatenate([losses(some, evidence, weights_of(numbers)) for some, evidence in groups])
        return float(np.minimum(each, MOST_LOSS).mean() + PRIOR * np.sum((numbers - start) ** 2))

    found = minimize(loss, start, method="L-BFGS-B", options={"maxiter": 200})
    CONSOLE.print(
        f"{sum(len(some) for some, _ in groups)} scenes: {loss(start):.4f} at the start, {found.fun:.4f} fitted"
    )
    return {name: round(value, 4) for name, value in weights_of(found.x).items()}


def losses(some: list[Labelled], evidence: course.Evidence, weights: dict[str, float]) -> Float64[np.ndarray, "n"]:
    """−log p(true course), given that its longest piece is on the thread."""
    scores = course.scores_of(evidence, weights)
    longest = np.array([max((p for p, _ in each.path), key=lambda p: each.evidence.length[p]) for each in some])
    total = paths.log_total(scores, longest) - np.log(2.0)
    own = [paths.score(each.path, one_of(scores, k)) for k, each in enumerate(some)]
    return total - np.array(own)


def one_of(scores: paths.Scores, k: int) -> paths.Scores:
    """The scores of one of several sets."""
    return paths.Scores(scores.join[k], scores.piece[k], scores.end[k])


def stacked(some: list[Labelled]) -> course.Evidence:
    """The evidence of several scenes with as many pieces."""
    names = [field.name for field in fields(course.Evidence)]
    return course.Evidence(**{name: np.stack([getattr(each.evidence, name) for each in some]) for name in names})


def numbers_of(weights: dict[str, float]) -> Float64[np.ndarray, "w"]:
    """What is fitted: logarithms of positive weights."""
    return np.array([weights[name] if name in SIGNED else np.log(weights[name]) for name in START])


def weights_of(numbers: Float64[np.ndarray, "w"]) -> dict[str, float]:
    """The weights again."""
    return {n: float(x if n in SIGNED else np.exp(x)) for n, x in zip(START, numbers, strict=True)}


def table(examples: list[Labelled]) -> list[dict[str, object]]:
    """How many courses are right, by kind of scene and by their probability."""
    of_kind: dict[str, list[tuple[float, bool]]] = {}
    for each in examples:
        probability, is_right = judged(each)
        low = max(b for b in BINS if b <= probability)
        for key in (each.name.split(":")[0], f"probability from {low:g}"):
            of_kind.setdefault(key, []).append((probability, is_right))
        if not is_right and probability >= SURE:
            CONSOLE.print(f"  wrong though sure ({probability:.3f}): {each.name}")
    rows: list[dict[str, object]] = []
    for key, some in sorted(of_kind.items()):
        sure = [right for probability, right in some if probability >= SURE]
        rows.append(
            {
                "courses": key,
                "n": len(some),
                "right": sum(sure),
                "undecided": len(some) - len(sure),
                "wrong though sure": len(sure) - sum(sure),
                "mean probability": f"{np.mean([probability for probability, _ in some]):.3f}",
                "share right": f"{np.mean([right for _, right in some]):.3f}",
            }
        )
    return rows


def judged(each: Labelled) -> tuple[float, bool]:
    """The probability of the likeliest course, and whether it is the true one."""
    scores = course.scores_of(each.evidence, course.fitted_weights())
    path = paths.likeliest_path(scores)
    longest = max((p for p, _ in path), key=lambda p: each.evidence.length[p])
    probability = np.exp(paths.score(path, scores) - (paths.log_total(scores, longest) - np.log(2.0)))
    turned = [(p, not forward) for p, forward in path[::-1]]
    return min(float(probability), 1.0), each.path in (path, turned)


if __name__ == "__main__":
    main()
