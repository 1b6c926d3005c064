"""The tissue around the thread as Rerun shows it, and how a plan's jaws stand to it, in millimetres.

world/surface               a cloud of points, by how sure their depth is: from green over yellow to red
world/plan/{arm}/contact    the place of the jaws that comes nearest to the tissue, or deepest into it
"""

import numpy as np
import rerun as rr

from agents.viewer import colours
from agents.viewer.clearance import clearance_sentence
from agents.viewer.entity import Entity
from agents.viewer.mapping import FAINT
from agents.viewer.units import MM_PER_METRE, camera_in_mm
from schemas.messages import GraspPlan, Status, TissueSurface
from shared.camera import backproject

HALF_SURE = 0.004
"""Share of the depth that a deviation is, at which a cell is shown as half sure: 0.4 mm at 100 mm."""


def surface_entities(surface: TissueSurface) -> list[Entity]:
    """A point for each cell whose depth is known, grey where nothing tells how well."""
    v, u = np.nonzero(surface.valid)
    pixel = np.column_stack((surface.u_px[u], surface.v_px[v]))
    camera = camera_in_mm(surface.camera)
    # of the same camera, in another unit
    depth = surface.depth[v, u] * (camera.baseline / surface.camera.baseline)
    points = backproject(camera, pixel, depth)
    if surface.deviation is None:
        rgb = np.broadcast_to(np.array(colours.UNKNOWN, np.uint8), points.shape)
    else:
        rgb = colours.confidence_rgb(0.5 ** (surface.deviation[v, u] / surface.depth[v, u] / HALF_SURE))
    rgba = np.column_stack((rgb, np.full(len(rgb), FAINT, np.uint8)))
    return [("world/surface", [rr.Points3D(points, colors=rgba, radii=[-1.5])])]


def contact_entities(plan: GraspPlan) -> list[Entity]:
    """Where the jaws of a plan, or of the best that tissue forbade, come nearest to the tissue; nothing else."""
    path = f"world/plan/{rr.escape_entity_path_part(plan.arm)}/contact"
    tissue = plan.tissue
    if tissue is None or tissue.place_camera is None:
        return [(path, [rr.Points3D([])])]
    rgb = colours.WARNING if plan.status is Status.OK else colours.BAD
    place = rr.Points3D(
        [MM_PER_METRE * tissue.place_camera],
        colors=[rgb],
        radii=[-6.0],
        labels=[clearance_sentence(tissue)],
        show_labels=True,
    )
    return [(path, [place])]
