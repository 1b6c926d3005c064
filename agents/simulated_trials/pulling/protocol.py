"""What an evaluation of pulling tries: one pull in each of so many drawn stitches, and all that is drawn for it."""

import zlib

import numpy as np
from jaxtyping import Float64
from pydantic import Field

from agents.simulated_trials.journal import JournalOf
from agents.simulated_trials.protocol import Tried
from shared.runtime.config import Settings

ASKED_MM = (10.0, 25.0)
"""How long the tail is to be; it is at least SHORTER_MM longer before."""
SHORTER_MM = 10.0
POINTED_PX = 3.0
"""How well somebody points at the tail's hole: deviation of either coordinate (assumed)."""
WITHIN_MM = 2.0
"""A tail that differs from what was asked by no more has its length."""


class PullProtocol(Settings):
    """What is tried, and with which errors.

    Fields:
        puller: whose decisions are judged.
        tool_error_mm: deviation of each axis of the tool tip, drawn anew for each trial.
        hand_eye_mm, hand_eye_deg: the most that the registration of a trial is wrong by.
        instrument: whether images show the instrument.
        force_limit_n: on the tissue, above which a trial has failed.
        longest_s: of a trial.
    """

    puller: str
    seed: int = Field(ge=0)
    trials: int = Field(ge=1, le=100_000)
    tool_error_mm: float = Field(ge=0, le=20)
    hand_eye_mm: float = Field(ge=0, le=20)
    hand_eye_deg: float = Field(ge=0, le=30)
    instrument: bool = False
    force_limit_n: float = Field(default=1.0, gt=0)
    longest_s: float = Field(default=180.0, gt=0)


class PullTrial(Settings):
    """One pull to be tried: the how many-th."""

    number: int

    @property
    def name(self) -> str:
        """As it is called in tables and files."""
        return str(self.number)


class PullCame(Tried):
    """What came of a pull. Millimetres, newtons, seconds of the simulated world.

    Fields:
        outcome: `completed` where the puller says that the tail has the asked length, and it has; `declined` where it
            ended before anything moved.
        code: the cause in one word; sentence: the same in words.
        asked, tail_before, tail: asked for, and true before and after.
        knot: where on the tail a knot is, from its end; None without one.
        told, told_deviation: what the puller said at the end; None where it could not tell.
        wrongly_told: it said that the tail has the asked length, and it has not.
        end_covered: whether the 95 % interval told at the end has the true tail in it; None where nothing was told.
        frames, measured, covered: images, those in which the puller told a tail, and those whose interval had it.
        peak_force: on the tissue; peak_tension: at the jaw; slipped: thread that ran through closed fingers.
        took_s: until the puller ended it.
    """

    trial: PullTrial
    outcome: str
    code: str
    sentence: str
    asked: float = 0.0
    tail_before: float = 0.0
    tail: float = 0.0
    knot: float | None = None
    told: float | None = None
    told_deviation: float | None = None
    wrongly_told: bool = False
    end_covered: bool | None = None
    frames: int = 0
    measured: int = 0
    covered: int = 0
    pulled_out: bool = False
    peak_force: float = 0.0
    peak_tension: float = 0.0
    slipped: float = 0.0
    took_s: float = 0.0
    processor_s: float = 0.0


class PullJournal(JournalOf[PullProtocol, PullCame]):
    """Of an evaluation of pulling."""

    protocol_type, came_type = PullProtocol, PullCame


def trials_of(protocol: PullProtocol) -> list[PullTrial]:
    """All trials."""
    return [PullTrial(number=number) for number in range(1, protocol.trials + 1)]


def field_seed(protocol: PullProtocol, trial: PullTrial) -> int:
    """Of the stitch, its field and its images."""
    return _seed(protocol, trial, "field")


def error_seed(protocol: PullProtocol, trial: PullTrial) -> int:
    """Of the errors of tool and registration."""
    return _seed(protocol, trial, "errors")


def asked_mm(protocol: PullProtocol, trial: PullTrial, tail_mm: float) -> float:
    """Which length the tail is to have, of one that is so long before."""
    rng = np.random.default_rng(_seed(protocol, trial, "asked"))
    return float(rng.uniform(ASKED_MM[0], min(ASKED_MM[1], tail_mm - SHORTER_MM)))


def pointed_px(protocol: PullProtocol, trial: PullTrial, exit_px: Float64[np.ndarray, "2"]) -> Float64[np.ndarray, "2"]:
    """Where somebody points who means the tail's hole."""
    return exit_px + np.random.default_rng(_seed(protocol, trial, "pointed")).normal(0.0, POINTED_PX, 2)


def _seed(protocol: PullProtocol, trial: PullTrial, what: str) -> int:
    return zlib.crc32(f"{protocol.seed}/{trial.name}/{what}".encode())
