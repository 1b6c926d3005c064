"""Where an arm's base is, as a rig's configuration tells it: a 4x4 matrix, in rows."""

import itertools
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator

from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.rigid_transforms import nearest_rotation, orthonormality_error

Rows = tuple[tuple[float, float, float, float], ...]

ROTATION_TOLERANCE = 1e-3
"""Numbers that were typed in keep three or four digits; the rotation is made exact."""
EXACT = 1e-9
FARTHEST_M, LARGEST = 2.0, 1e6
NEAREST_M = 0.01
"""Two remote centres that are nearer than this are one place, told twice."""


def _rigid(rows: Any) -> Rows:
    """The rows of a pose with its rotation made exact.

    Raises:
        ValueError: where they are no pose, in a sentence.
    """
    shaped = isinstance(rows, list | tuple) and [len(r) for r in rows if isinstance(r, list | tuple)] == [4] * 4
    numbers = [x for row in rows for x in row] if shaped and len(rows) == 4 else []
    if not numbers or not all(type(x) in (int, float) and abs(x) < LARGEST for x in numbers):
        raise ValueError("write four rows of four numbers: the base's axes and place in the camera's frame, metres")
    T = np.array(rows, dtype=np.float64)
    R, place = T[:3, :3], T[:3, 3]
    if (T[3] != (0, 0, 0, 1)).any():
        raise ValueError("its last row must be 0, 0, 0, 1")
    error = float(orthonormality_error(R))
    if error > ROTATION_TOLERANCE or np.linalg.det(R) < 0:
        raise ValueError("its upper left 3x3 must be a rotation: orthonormal to three digits, right-handed")
    if not (distance := float(np.abs(place).max())) <= FARTHEST_M:
        far = f"the base would be {distance:g} m from the camera, and at most {FARTHEST_M:g} m make sense"
        raise ValueError(f"{far}; write metres")
    if error > EXACT:
        T[:3, :3] = nearest_rotation(R)
    return tuple((float(a), float(b), float(c), float(d)) for a, b, c, d in T)


BasePose = Annotated[Rows, BeforeValidator(_rigid)]


def standing_apart(poses: Mapping[str, Rows | None]) -> None:
    """Require that each arm has a place, told or its own, and that no two have the same.

    Raises:
        ValueError: naming the arms.
    """
    for arm, pose in poses.items():
        if pose is None and arm not in SIMULATED_BASES:
            known = " and ".join(SIMULATED_BASES)
            raise ValueError(f"{arm} needs T_camera_base; only {known} have a place of their own")
    places = {arm: np.array(SIMULATED_BASES[arm] if T is None else T)[:3, 3] for arm, T in poses.items()}
    for one, other in itertools.combinations(places, 2):
        if np.linalg.norm(places[one] - places[other]) < NEAREST_M:
            raise ValueError(f"{one} and {other} stand in the same place; give each a T_camera_base of its own")
