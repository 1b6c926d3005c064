"""What a message says that it shows (`schemas.shown`) as Rerun shows it, in millimetres.

world/shown/{agent}/{name}   curves, and places as ellipsoids of 95 %; over both images too
{agent}/{name}               figures
lanes/{agent}                its state
"""

import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from agents.viewer import colours
from agents.viewer.entity import Entity
from agents.viewer.session_mapping import lane, said
from agents.viewer.units import camera_in_mm
from schemas.messages import RectifiedStereo
from schemas.shown import Shown

SIGMAS = 2.8
"""The half-axes of an ellipsoid that holds 95 %, in standard deviations."""
RADIUS_PX = 2.0


def shown_entities(agent: str, camera: RectifiedStereo, shown: Shown, changed: bool) -> list[Entity]:
    """Entities of all that a message shows; its lane and its sentence where its state has `changed`."""
    scale = camera_in_mm(camera).baseline / camera.baseline
    path = rr.escape_entity_path_part(agent)
    entities: list[Entity] = []
    for name, points in shown.curves.items():
        curve = rr.LineStrips3D([scale * points], colors=[colours.CHOSEN], radii=[-RADIUS_PX])
        entities.append((f"world/shown/{path}/{rr.escape_entity_path_part(name)}", [curve]))
    for name, (point, covariance) in shown.places.items():
        variances, axes = np.linalg.eigh(scale**2 * covariance)
        axes[:, 0] *= np.linalg.det(axes)
        ellipsoid = rr.Ellipsoids3D(
            centers=[scale * point],
            half_sizes=[SIGMAS * np.sqrt(np.maximum(variances, 0.0))],
            quaternions=[Rotation.from_matrix(axes).as_quat()],
            colors=[colours.CHOSEN],
            labels=[name],
            show_labels=True,
        )
        entities.append((f"world/shown/{path}/{rr.escape_entity_path_part(name)}", [ellipsoid]))
    entities += [(f"{path}/{name}", [rr.Scalars(value)]) for name, value in shown.figures.items()]
    if changed and shown.state:
        entities.append(lane(path, shown.state))
    if changed and shown.sentence:
        level = rr.TextLogLevel.INFO if shown.state == "ok" else rr.TextLogLevel.WARN
        entities.append(said(agent, shown.sentence, level))
    return entities
