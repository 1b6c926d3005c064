"""A tool is found: from what is known beforehand to a correction that the edges bear out.

Colours are learnt where the tool probably is, it is searched for with them, colours are learnt anew around what was
found, it is searched for there, and edges refine it. Where tissue is as grey as steel the first colours lead astray, so
some searches begin with long edges in their stead. Random numbers are those of a generator that is handed in, so that
the same images give the same correction.
"""

import enum

import numpy as np
from jaxtyping import Float64, UInt8

from agents.tool_tracker.correction import Correction, about
from agents.tool_tracker.evidence import Table, eye, learnt, likeness, softened
from agents.tool_tracker.lines import lined
from agents.tool_tracker.refinement import Refined, View, refined
from agents.tool_tracker.search import likely, probably_within, searched

NARROWER = 0.4
"""The second search's spread over the first's."""
FOUND_M, FOUND_RAD = 0.004, 0.04
"""How far (one deviation) what was searched for may be off."""
REACH_PX = 25.0
HELD, LINES_HELD = 0.01, 0.003
"""What the square of a deviation costs, in shares of what fits."""

Soft = tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w 3"]]


def soft_pair(left: UInt8[np.ndarray, "h w 3"], right: UInt8[np.ndarray, "h w 3"]) -> Soft:
    """Both images, blue first and rectified, with less noise."""
    return softened(left), softened(right)


class Begin(enum.Enum):
    """With what a search begins: that instruments are grey, with long edges, or with neither."""

    GREY = 0
    LINES = 1
    PLACE = 2


def acquired(
    soft: Soft, view: View, before: Correction, rng: np.random.Generator, begin: Begin
) -> tuple[Refined, Table]:
    """The correction that these images speak for, and the colours of the tool; `view.eyes` is not looked at."""
    camera, pivot, deviation = view.camera, before.pivot, np.sqrt(np.diag(before.covariance))
    parts, twist = view.parts(np.eye(4)), before.twist
    if begin is Begin.LINES:
        twist = searched(lined(camera, soft, parts, pivot), deviation, rng, twist, LINES_HELD)
    table = np.zeros((16, 16, 16), np.float32)
    for share in (NARROWER,) if begin is Begin.LINES else (1.0, NARROWER):
        moved = tuple(part.moved(about(pivot, twist)) for part in parts)
        within = probably_within(camera, moved, share * deviation, pivot, rng)
        table = learnt(soft, within, begin is Begin.GREY)
        maps = (likeness(soft[0], table), likeness(soft[1], table))
        twist = searched(likely(camera, maps, parts, pivot), share * deviation, rng, twist, HELD)
    found = Correction(twist, np.diag(np.repeat((FOUND_M, FOUND_RAD), 3) ** 2), pivot)
    return refined(looking(view, soft, table), found, first_reach_px=REACH_PX), table


def looking(view: View, soft: Soft, table: Table) -> View:
    """A view with its images made ready."""
    eyes = (eye(soft[0], table), eye(soft[1], table))
    return View(view.camera, eyes, view.T_camera_base, view.T_base_tool, view.jaw_rad)


def prior(pivot: Float64[np.ndarray, "3"], metres: float, radians: float) -> Correction:
    """What is known before anything was seen: deviations of each axis."""
    return Correction(np.zeros(6), np.diag(np.repeat((metres, radians), 3) ** 2), pivot)
