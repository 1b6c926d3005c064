"""One pull: images of the true field five times a second, whoever drives the arm, and the physics that follows it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float64

from agents.simulated_trials.look import Look
from agents.simulated_trials.pulling.driving import ArmState, Driver, Measured, Stop, covered
from agents.simulated_trials.pulling.protocol import WITHIN_MM, PullCame, PullProtocol, PullTrial

STEP_S, FRAME_S = 0.02, 0.2
"""The arm is measured so often, and seen so often; what a frame shows is told when the next one is taken."""
MM = 1e-3
MOVED_M = 1e-3


class Truth(Protocol):
    """What is true of a pulled thread, in millimetres and newtons."""

    @property
    def tail_mm(self) -> float: ...
    @property
    def pulled_out(self) -> bool: ...
    @property
    def at_knot(self) -> bool: ...
    @property
    def jaw_n(self) -> float: ...
    @property
    def tissue_n(self) -> float: ...
    @property
    def slipped_mm(self) -> float: ...


@dataclass(frozen=True)
class Bench:
    """Where a pull is tried.

    Fields:
        move: brings the tool, as measured, there in so many seconds, and says what is true then.
        look: at the field as it is, with the arm there, at a time in seconds.
        asked_mm: how long the tail is to be; `knot_mm`: of the tail's end, None without a knot.
    """

    move: Callable[[ArmState, float], Truth]
    look: Callable[[ArmState, float], Look]
    driver: Driver
    asked_mm: float
    knot_mm: float | None


@dataclass
class _Notes:
    """What is noted while a trial lasts; `start` is the pose in which the arm was measured first."""

    frames: int = 0
    told: list[tuple[Measured, float]] = field(default_factory=list[tuple[Measured, float]])
    peak_n: float = 0.0
    jaw_n: float = 0.0
    start: Float64[np.ndarray, "4 4"] | None = None
    moved: bool = False


def pulled(trial: PullTrial, protocol: PullProtocol, bench: Bench) -> PullCame:
    """Try one pull."""
    notes, driver = _Notes(), bench.driver
    every, waiting = round(FRAME_S / STEP_S), None
    arm = driver.advance(0.0)
    truth = bench.move(arm, STEP_S)
    before, steps = truth.tail_mm, round(protocol.longest_s / STEP_S)
    end, step = None, 0
    for step in range(steps):
        if step % every == 0:
            if waiting is not None:
                look, tail_m = waiting
                measured = driver.see(look)
                if measured is not None:
                    notes.told.append((measured, tail_m))
            end = driver.ended
            if end is not None or truth.pulled_out:
                break
            waiting = bench.look(arm, step * STEP_S), MM * truth.tail_mm
            notes.frames += 1
        arm = driver.advance(STEP_S)
        truth = bench.move(arm, STEP_S)
        _note(notes, arm, truth)
    known: dict[str, Any] = {
        "asked": bench.asked_mm,
        "tail_before": before,
        "knot": bench.knot_mm,
        "frames": notes.frames,
        "measured": len(notes.told),
        "covered": covered(notes.told),
        "peak_force": notes.peak_n,
        "peak_tension": notes.jaw_n,
        "took_s": step * STEP_S,
    }
    return PullCame.model_validate({"trial": trial, **known, **_judged(protocol, bench.asked_mm, truth, end, notes)})


def _note(notes: _Notes, arm: ArmState, truth: Truth) -> None:
    notes.peak_n, notes.jaw_n = max(notes.peak_n, truth.tissue_n), max(notes.jaw_n, truth.jaw_n)
    if notes.start is None:
        notes.start = arm.T_camera_tool
    off = float(np.linalg.norm(arm.T_camera_tool[:3, 3] - notes.start[:3, 3]))
    notes.moved = notes.moved or off > MOVED_M


def _judged(
    protocol: PullProtocol, asked_mm: float, truth: Truth, end: Stop | None, notes: _Notes
) -> dict[str, object]:
    """What has become of the thread, and whether it was told right."""
    off_mm = truth.tail_mm - asked_mm
    reached = end is not None and end.reached
    is_right = abs(off_mm) <= WITHIN_MM
    outcome, code = "failed", end.code if end is not None else "ENDLESS"
    said = end.sentence if end is not None else f"the pull had not ended after {protocol.longest_s:g} s"
    if truth.pulled_out:
        code, said = "PULLED_OUT", "the tail came through its hole"
    elif notes.peak_n > protocol.force_limit_n:
        code = "FORCE_EXCEEDED"
        said = f"{notes.peak_n:.2f} N on the tissue, where {protocol.force_limit_n:g} N are allowed; {said}"
    elif reached and is_right:
        outcome, code = "completed", "COMPLETED"
    elif reached:
        code, said = "WRONG_LENGTH", f"the tail is {off_mm:+.1f} mm off; {said}"
    elif not notes.moved and end is not None:
        outcome = "declined"
    elif truth.at_knot:
        code = "AT_KNOT"
    told = None if end is None else end.measured
    return {
        "outcome": outcome,
        "code": code,
        "sentence": said,
        "tail": truth.tail_mm,
        "told": None if told is None else told.tail_m / MM,
        "told_deviation": None if told is None else told.deviation_m / MM,
        "wrongly_told": reached and not is_right,
        "end_covered": None if told is None else told.covers(MM * truth.tail_mm),
        "pulled_out": truth.pulled_out,
        "slipped": truth.slipped_mm,
    }
