"""A click becomes a place on the thread: the nearest one, and any other strand that is about as near."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64

from agents.operator.drawn_thread import DrawnThread

WITHIN_PX = 60.0
"""Of an image 960 pixels wide; a click farther off names nothing."""
ALSO_PX = 14.0
"""Strands so much farther than the nearest are told too."""
APART = 0.03
"""Share of the length that lies between two strands; nearer places are one."""
IMAGE_WIDTH = 960.0


@dataclass(frozen=True)
class Snapped:
    """A place on the thread.

    Fields:
        off_px: how far from the click it is; off_mm: the same at the thread's depth, None where the unit is unknown.
        along_mm: from the thread's beginning.
    """

    s: float
    px: tuple[float, float]
    off_px: float
    off_mm: float | None
    along_mm: float
    confidence: float | None
    unseen: bool

    def document(self) -> dict[str, Any]:
        """For the page."""
        return {
            "s": round(self.s, 4),
            "px": [round(v, 1) for v in self.px],
            "off_px": round(self.off_px, 1),
            "off_mm": None if self.off_mm is None else round(self.off_mm, 2),
            "along_mm": round(self.along_mm, 1),
            "confidence": None if self.confidence is None else round(self.confidence, 3),
            "unseen": self.unseen,
        }


def snapped(thread: DrawnThread, pixel: tuple[float, float]) -> list[Snapped]:
    """The places of the thread that a click may mean, the nearest first; none where it is far from all of it.

    Each is nearer than what lies beside it on its strand.
    """
    scale = thread.camera.image_width / IMAGE_WIDTH
    place, off_px = _feet(thread.px, np.array(pixel))
    beside = np.pad(off_px, 1, constant_values=np.inf)
    strands = np.flatnonzero((off_px <= beside[:-2]) & (off_px <= beside[2:]))
    order = strands[np.argsort(off_px[strands])]
    nearest = float(off_px[order[0]])
    if not nearest <= WITHIN_PX * scale:
        return []
    found: list[Snapped] = []
    for i in order.tolist():
        if off_px[i] > nearest + ALSO_PX * scale:
            break
        s = float(place[i]) / (len(thread.along) - 1)
        if all(abs(s - other.s) > APART for other in found):
            found.append(_at(thread, float(place[i]), float(off_px[i])))
    return found


def at_place(thread: DrawnThread, s: float) -> Snapped:
    """A place that was named by s."""
    return _at(thread, s * (len(thread.along) - 1), 0.0)


def _at(thread: DrawnThread, place: float, off_px: float) -> Snapped:
    indices = np.arange(len(thread.along))
    s = float(np.interp(place, indices, thread.along))
    u, v = (float(np.interp(place, indices, thread.px[:, k])) for k in (0, 1))
    depth_mm = float(np.interp(place, indices, thread.points_mm[:, 2]))
    confidence = float(np.interp(place, indices, thread.confidence))
    return Snapped(
        s=s,
        px=(u, v),
        off_px=off_px,
        off_mm=None if thread.to_mm is None else off_px * depth_mm / thread.camera.fx_px,
        along_mm=s * thread.length_mm,
        confidence=confidence if np.isfinite(confidence) else None,
        unseen=bool(thread.unseen[round(place)]),
    )


def _feet(
    line_px: Float64[np.ndarray, "n 2"], pixel: Float64[np.ndarray, "2"]
) -> tuple[Float64[np.ndarray, "m"], Float64[np.ndarray, "m"]]:
    """On each piece of a line the place nearest to a pixel, counted in pieces, and how far it is."""
    start, step = line_px[:-1], np.diff(line_px, axis=0)
    squared = (step**2).sum(axis=1)
    share = np.clip(((pixel - start) * step).sum(axis=1) / np.where(squared > 0, squared, 1.0), 0.0, 1.0)
    off_px = np.linalg.norm(start + share[:, None] * step - pixel, axis=1)
    return np.arange(len(step)) + share, off_px
