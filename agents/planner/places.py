"""The places along the thread that a goal is planned with: where they are, and what makes no difference to the jaws."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from agents.planner.chances import Known
from agents.planner.curve import ThreadCurve, decided, passing_distance, seen, strand_distance
from agents.planner.needle import NeedleAround
from schemas.messages import Policy
from shared.kinematics.psm import FINGER_M


@dataclass(frozen=True)
class Places:
    """Candidates for the capture, one of which is the goal, and what every depth and opening of the jaws shares.

    Fields:
        goal: the index of the goal.
        aims_camera: where the tool is aimed for each of them.
        beside_m: how far to the side another strand passes, as `strand_distance` has it.
        needle_m: how far a needle is, whatever is not known of it included.
        seen: whether both images show it.
        decided: whether it is known where the thread leads from it.
    """

    s: Float64[np.ndarray, "n"]
    goal: int
    aims_camera: Float64[np.ndarray, "n 3"]
    tangents: Float64[np.ndarray, "n 3"]
    beside_m: Float64[np.ndarray, "n"]
    needle_m: Float64[np.ndarray, "n"]
    seen: Bool[np.ndarray, "n"]
    decided: Bool[np.ndarray, "n"]
    known: Known


def places_along(
    curve: ThreadCurve,
    s: Float64[np.ndarray, "n"],
    goal: int,
    policy: Policy,
    known: Known,
    needle: NeedleAround | None = None,
    beside: Float64[np.ndarray, "k 3"] | None = None,
) -> Places:
    """All of s where the thread may be slid along, and the goal alone where it may not.

    Args:
        known: at the same places.
        needle: what is known of one; beside: places along a strand that is no part of the curve.

    Raises:
        NoGraspError: where the curve has no direction.
    """
    asked = asked_of(goal, policy)
    tangents = curve.tangents(s)[asked]
    beside_m = strand_distance(curve, s[asked], FINGER_M)
    if beside is not None:
        beside_m = np.minimum(beside_m, passing_distance(curve.points(s[asked]), beside, FINGER_M))
    return Places(
        s=s[asked],
        goal=0 if policy is Policy.DIRECT else goal,
        aims_camera=curve.points(s)[asked] + known.aim_camera,
        tangents=tangents,
        beside_m=beside_m,
        needle_m=np.full(len(tangents), np.inf) if needle is None else needle.off(curve.points(s)[asked]),
        seen=seen(curve, s)[asked],
        decided=decided(curve, s)[asked],
        known=known,
    )


def asked_of(goal: int, policy: Policy) -> slice:
    """Which of the candidates a policy can capture at."""
    return slice(goal, goal + 1) if policy is Policy.DIRECT else slice(None)
