"""How far a reconstruction can be trusted, as Rerun shows it.

    world/thread/posterior      the tube that holds the thread with 95 % probability, across it; at true scale
    world/{side}/centrelines    the middle of the thread as that image shows it, by piece
    world/{side}/residuals_x20  whiskers from the projected curve toward the centrelines' points, twenty times as long
                                as the residuals, and at most 40 px
    deviation/along_s           a chart along the thread: standard deviation across it, in the worst direction
    residual_px/{side}          `median` and `percentile_95` of the points that the curve explains
    deviation/…                 `mean` and `worst` of the chart
    share/…                     `unseen` of the thread in any image; `left_over_{side}` of the points of its centrelines

Curve, tube and whiskers have the colours of confidence: whiskers are green where the curve runs through the middle of
the thread's image, and red where it runs along its edge or farther out. Thread that not both images show is grey.
"""

from typing import Any

import numpy as np
import rerun as rr
from jaxtyping import Float64

from agents.viewer import colours
from agents.viewer.cross_sections import CORNERS, CrossSections, tube_triangles
from agents.viewer.entity import HALF_PX, Entity
from agents.viewer.polyline import Polyline
from agents.viewer.residuals import EXAGGERATION, Residuals, both_residuals, closeness, summary, whiskers
from schemas.messages import Centrelines, ThreadObservations
from shared.right_eye import IN_LINE, Affine, moved

BARS = 100
ALONG = np.linspace(0.0, 1.0, BARS)
"""Shares of the thread's length at which there are bars."""
# made once: Rerun takes longer to find out of what kind the numbers of a chart are than it does for all else in it
_PLACES: Any = rr.components.TensorDataBatch(ALONG).as_arrow_array()
_WIDTHS: Any = rr.components.LengthBatch(np.full(BARS, 1 / BARS)).as_arrow_array()
_KIND = [field.name for field in _PLACES.type.field("buffer").type].index("F64")


def bars_along(heights: Float64[np.ndarray, "n"], rgb: tuple[int, int, int]) -> rr.BarChart:
    """Bars at `ALONG` of these heights."""
    return rr.BarChart(_like_places(heights), abscissa=_PLACES, color=rgb, widths=_WIDTHS)


def _like_places(heights: Float64[np.ndarray, "n"]) -> Any:
    """As many numbers, as Rerun holds those of the places: a structure of a shape, names, and numbers of some kind."""
    kinds = _PLACES.field("buffer")
    places = kinds.field(_KIND)
    numbers = rr.components.ScalarBatch(heights).as_arrow_array()
    children = [kinds.field(kind) for kind in range(kinds.type.num_fields)]
    children[_KIND] = places.from_buffers(places.type, 1, places.buffers()[:2], children=[numbers])
    # of what says which kind each element is, and where
    about = [None, *kinds.buffers()[1:3]]
    buffer = kinds.from_buffers(kinds.type, 1, about, children=children)
    return _PLACES.from_arrays([_PLACES.field("shape"), _PLACES.field("names"), buffer], fields=list(_PLACES.type))


WHISKERS_ABOUT = 300
"""Whiskers in each image; neighbouring points of a centreline err alike."""

TUBE_OPACITY = 120

SIDES = ("left", "right")


def curve_looks() -> list[Entity]:
    """The colours of the curves over time, as in the picture: one for each image, the median thicker."""
    residuals = [
        (f"residual_px/{side}/{what}", _looks(rgb, width, f"{side}, {called}"))
        for side, rgb in zip(SIDES, (colours.LEFT_EYE, colours.RIGHT_EYE), strict=True)
        for what, called, width in (("median", "median", 2.0), ("percentile_95", "95 %", 1.0))
    ]
    shares = [
        (f"share/left_over_{side}", _looks(rgb, 1.0, f"left over, {side}"))
        for side, rgb in zip(SIDES, (colours.LEFT_EYE, colours.RIGHT_EYE), strict=True)
    ]
    return [
        *residuals,
        *shares,
        ("share/unseen", _looks(colours.UNKNOWN, 2.0, "unseen")),
        ("deviation/mean", _looks(colours.KEPT, 2.0, "mean")),
        ("deviation/worst", _looks(colours.WARNING, 1.0, "worst")),
    ]


def _looks(rgb: tuple[int, int, int], width: float, name: str) -> list[rr.AsComponents]:
    return [rr.SeriesLines(colors=[rgb], widths=[width], names=[name])]


def centreline_entities(observations: ThreadObservations, to_shown: Affine = IN_LINE) -> list[Entity]:
    """The pieces of both centrelines as thin lines in the images; the right one's as it is shown."""
    return [
        ("world/left/centrelines", [_pieces(observations.centrelines_left)]),
        ("world/right/centrelines", [_pieces(observations.centrelines_right, to_shown)]),
    ]


def posterior_entities(sections: CrossSections) -> list[Entity]:
    """The tube, its deviation along the thread, and the mean and the worst of it."""
    mean, worst = (float(pick(sections.deviation)) if len(sections.along) else None for pick in (np.mean, np.max))
    return [
        ("world/thread/posterior", [_tube(sections)]),
        ("deviation/along_s", [_bars(sections)]),
        ("deviation/mean", [_scalar(mean)]),
        ("deviation/worst", [_scalar(worst)]),
    ]


def residual_entities(
    observations: ThreadObservations | None, thread: Polyline | None, to_shown: Affine = IN_LINE
) -> list[Entity]:
    """The residuals in both images, in pixels and in numbers; empty where there is no thread, or nothing to compare.

    Args:
        to_shown: from pixels of the right image in line to those of the one that is shown.
    """
    share = None if thread is None else float(thread.unseen.mean())
    entities: list[Entity] = [("share/unseen", [_scalar(share)])]
    found = (None, None) if observations is None or thread is None else both_residuals(observations, thread)
    for side, of_side, by in zip(SIDES, found, (IN_LINE, to_shown), strict=True):
        numbers = None if of_side is None else summary(of_side)
        entities += [
            (f"world/{side}/residuals_x{EXAGGERATION}", [_whiskers(of_side, by)]),
            (f"residual_px/{side}/median", [_scalar(numbers and numbers.median_px)]),
            (f"residual_px/{side}/percentile_95", [_scalar(numbers and numbers.percentile_95_px)]),
            (f"share/left_over_{side}", [_scalar(numbers and numbers.left_over)]),
        ]
    return entities


def _scalar(value: float | None) -> rr.Scalars:
    """A number, or that there is none, so that a curve ends instead of going on as before."""
    return rr.Scalars(np.nan if value is None else value)


def _pieces(line: Centrelines, to_shown: Affine = IN_LINE) -> rr.LineStrips2D:
    cuts = np.flatnonzero(np.diff(line.piece)) + 1
    points = moved(line.point_px, to_shown) + HALF_PX
    strips = np.split(points, cuts) if len(line.piece) else []
    return rr.LineStrips2D(strips, colors=[colours.CENTRELINE], radii=[-0.6])


def _whiskers(found: Residuals | None, to_shown: Affine) -> rr.LineStrips2D:
    if found is None or not len(found.along):
        return rr.LineStrips2D([])
    some = found.every(1 + len(found.along) // WHISKERS_ABOUT)
    lines = (moved(whiskers(some), to_shown) + HALF_PX).astype(np.float32)
    return rr.LineStrips2D(lines, colors=colours.confidence_rgb(closeness(some)), radii=[-0.8])


def _tube(sections: CrossSections) -> rr.Mesh3D | rr.Clear:
    count = len(sections.along)
    if count < 2:
        return rr.Clear(recursive=False)
    rgb = colours.thread_rgb(sections.confidence, sections.unseen)
    return rr.Mesh3D(
        vertex_positions=sections.rings_camera.reshape(-1, 3),
        triangle_indices=tube_triangles(count),
        vertex_colors=np.repeat(rgb, CORNERS, axis=0),
        albedo_factor=(255, 255, 255, TUBE_OPACITY),
    )


def _bars(sections: CrossSections) -> rr.BarChart:
    if not len(sections.along):
        return rr.BarChart(np.zeros(1), abscissa=np.zeros(1))
    return bars_along(np.interp(ALONG, sections.along, sections.deviation), colours.BAND)
