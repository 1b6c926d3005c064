"""What following a moving thread from frame to frame comes to, in rendered sequences (tests/rigs/sequences.py).

    .venv/bin/python -m benchmarks.tracking                            # reconstruction, from true masks
    .venv/bin/python -m benchmarks.tracking --images --seeds 40 44     # perception and reconstruction, from raw images

With true masks each frame is reconstructed alone and as the live agent would with tracking: error, steadiness of s,
restarts and time. From images of a thread on tissue both agents run as on a rig, each with what the other said last:
the error, how often it is wrong though ok, and in how many frames the thread was followed or looked for. Times are the
processor's.
"""

import statistics
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tyro
from jaxtyping import Float64

from agents.camera.scene_source import calibration_of
from agents.perception.agent import Perception
from agents.reconstruction.agent import Reconstruction
from agents.reconstruction.methods import METHODS, TRACKERS
from agents.reconstruction.refined.method import METHOD
from benchmarks.tables import Row, print_rows, write_json
from schemas.messages import ImageEncoding, Status, StereoFrame, ThreadObservations, ThreadReconstruction, TrackStep
from schemas.topics import CALIBRATION, FRAMES, OBSERVATIONS, THREAD, Topic
from shared.arc_length import even_parameters
from shared.clock import processor_s
from shared.images import encode_image
from shared.runtime.agent import Agent, Received, outputs_in
from shared.splines import evaluate
from tests.rigs.sequences import CAMERA, KINDS, Frame, Kind, images_of, sequence, stamp_of

THREADS = (("medium", 3), ("hard", 2), ("crossing", 4))
CONFIGS = "medium", "hard", "crossing"
"""Of the seeds in turn."""
REPEATS, WRONG_MM = 2, 1.0
OUTER = 20
"""Material points at each end that do not count for the steadiness of s: a curve that ends early has no place there."""
CURVE_SAMPLES = 601


@dataclass(frozen=True)
class Options:
    """Which sequences."""

    images: bool = False
    """From raw images, in place of true masks."""
    seeds: tuple[int, int] = (40, 44)
    """Of the images: first, and one past the last."""
    frames: int = 45
    """Of each sequence."""
    only: str = ""
    """Sequences whose name contains this."""
    json: Path = Path("out/tracking.json")


def main() -> None:
    """Run the benchmark from the command line."""
    options = tyro.cli(Options, description=__doc__)
    cv2.setNumThreads(1)
    rows = list(_from_images(options) if options.images else _from_masks(options))
    if not rows:
        raise SystemExit(f"no sequence has a name that contains {options.only!r}")
    print_rows(f"sequences of {METHOD}; lengths in mm, times of the processor", rows)
    write_json(options.json, rows)


def _from_masks(options: Options) -> Iterator[Row]:
    """A row for each sequence: alone → tracked."""
    for kind in KINDS:
        for config, seed in THREADS:
            if options.only not in f"{kind.name} {config}":
                continue
            frames = list(sequence(config, seed, kind, options.frames, False))
            alone = figures(frames, lambda frame, _: METHODS[METHOD](frame.observations))
            tracked = figures(frames, lambda frame, last: TRACKERS[METHOD](frame.observations, last))
            both = {name: f"{alone[name]} → {tracked[name]}" for name in alone}
            yield {"motion": kind.name, "thread": config} | both


def figures(
    frames: list[Frame], step: Callable[[Frame, ThreadReconstruction | None], ThreadReconstruction]
) -> dict[str, str]:
    """Errors in mm, the deviation of s from frame to frame in mm along the thread, failures, restarts, and times."""
    errors: list[float] = []
    places: list[np.ndarray] = []
    ms: list[float] = []
    last: ThreadReconstruction | None = None
    restarted = 0
    for frame in frames:
        taken: list[float] = []
        thread = last
        for _ in range(REPEATS):
            before_s = processor_s()
            thread = step(frame, last)
            taken.append(1e3 * (processor_s() - before_s))
        assert thread is not None
        last = thread
        ms.append(min(taken))
        restarted += _restarted(thread)
        if thread.status is Status.OK:
            place, distance = on_curve(thread, frame.truth)
            errors.append(float(distance.mean()))
            places.append(place[OUTER:-OUTER])
    length = float(np.linalg.norm(np.diff(frames[0].truth, axis=0), axis=1).sum())
    return {
        "error": f"{statistics.median(errors):.3f}",
        "worst": f"{max(errors):.3f}",
        "s": f"{length * float(np.std(places, axis=0).mean()):.3f}",
        "worst s": f"{length * float(np.abs(places - np.median(places, axis=0)).mean(axis=1).max()):.3f}",
        "failed": str(len(frames) - len(errors)),
        "restarted": str(restarted),
        "ms": f"{statistics.median(ms):.1f}",
    }


def _restarted(thread: ThreadReconstruction) -> bool:
    return thread.track is not None and thread.track.step is TrackStep.RESTARTED


def on_curve(
    thread: ThreadReconstruction, truth: Float64[np.ndarray, "n 3"]
) -> tuple[Float64[np.ndarray, "n"], Float64[np.ndarray, "n"]]:
    """Which place of the thread each true point is, on the scale of the first curve, and how far from the curve."""
    knots, control_points = thread.knots, thread.control_points_camera
    points = evaluate(knots, control_points, 3, even_parameters(knots, control_points, 3, CURVE_SAMPLES))
    chord = np.diff(points, axis=0)
    off = truth[:, None] - points[None, :-1]
    t = np.clip(np.einsum("nka,ka->nk", off, chord) / np.maximum((chord**2).sum(axis=1), 1e-18), 0.0, 1.0)
    distance = np.linalg.norm(off - t[..., None] * chord, axis=2)
    nearest = distance.argmin(axis=1)
    every = np.arange(len(truth))
    s = (nearest + t[every, nearest]) / (CURVE_SAMPLES - 1)
    first, last = thread.track.material_s if thread.track else (0.0, 1.0)
    return first + (last - first) * s, distance[every, nearest]


@dataclass(frozen=True)
class Seen:
    """One frame: error of the curve in mm, None where it failed; what perception did; the processor's milliseconds."""

    error_mm: float | None
    how: str
    restarted: bool
    perception_ms: float
    reconstruction_ms: float


def _from_images(options: Options) -> Iterator[Row]:
    """A row for each kind of motion."""
    for kind in KINDS:
        if options.only not in kind.name:
            continue
        seen = [each for seed in range(*options.seeds) for each in _seen(kind, seed, options.frames)]
        errors = np.array([each.error_mm for each in seen if each.error_mm is not None])
        how = Counter(each.how for each in seen)
        yield {
            "motion": kind.name,
            "frames": len(seen),
            "ok": len(errors),
            "median": float(np.median(errors)),
            "95 %": float(np.percentile(errors, 95)),
            "worst": float(errors.max()),
            f"wrong though ok (> {WRONG_MM:g})": int((errors > WRONG_MM).sum()),
            **{name: how[name] for name in ("followed", "near", "looked")},
            "restarted": sum(each.restarted for each in seen),
            "perception ms": float(np.mean([each.perception_ms for each in seen])),
            "reconstruction ms": float(np.mean([each.reconstruction_ms for each in seen])),
        }


def _seen(kind: Kind, seed: int, frames: int) -> Iterator[Seen]:
    """The frames of one sequence."""
    perception, reconstruction = Perception(), Reconstruction()
    _fed(perception, CALIBRATION, calibration_of(CAMERA))
    last: ThreadReconstruction | None = None
    for number, drawn in enumerate(images_of(CONFIGS[seed % len(CONFIGS)], seed, kind, frames, background="tissue")):
        if last is not None:
            _fed(perception, THREAD, last)
        left, right = (encode_image(image, ImageEncoding.RAW) for image in drawn.images)
        before_s = processor_s()
        observations = _fed(perception, FRAMES, StereoFrame(stamp_of(number), left, right))[OBSERVATIONS]
        seen_s = processor_s()
        thread: ThreadReconstruction = _fed(reconstruction, OBSERVATIONS, observations)[THREAD]
        last = thread
        yield Seen(
            float(on_curve(thread, drawn.truth)[1].mean()) if thread.status is Status.OK else None,
            _how(observations, number),
            _restarted(thread),
            1e3 * (seen_s - before_s),
            1e3 * (processor_s() - seen_s),
        )


def _fed(agent: Agent, topic: Topic, message: object) -> dict[Topic, Any]:
    """What an agent says to a message, by topic."""
    return {out.topic: out.message for out in outputs_in(agent.step(Received(topic, str(topic), 1, message)))}


def _how(seen: ThreadObservations, number: int) -> str:
    if seen.looked_sequence == number:
        return "looked"
    return "near" if seen.segmented_sequence in (None, number) else "followed"


if __name__ == "__main__":
    main()
