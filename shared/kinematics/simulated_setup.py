"""Where simulated arms stand before the camera: psm1 to its right, psm2 to its left.

The remote centre of psm1 lies 45 mm to the right of the endoscope and 80 mm behind the lens, so that the whole field of
view (55° x 30°, 70 to 115 mm deep) is 150 to 220 mm beyond it: well within the insertion, and seen from there at no
more than 32° from the optical axis. That leaves the wrist enough to tilt the fingers by 45° from that axis, any way
round. psm2 is its mirror image. Nothing has a body here: with the tool in the far corner of the field, a real shaft
would touch a real endoscope, and two arms would touch each other.
"""

import numpy as np
from jaxtyping import Float64

from shared.rigid_transforms import transform

_REMOTE_CENTRES_CAMERA = {"psm1": (0.045, 0.01, -0.08), "psm2": (-0.045, 0.01, -0.08)}
_FIELD_CENTRE_CAMERA = (0.0, 0.0, 0.0925)


def _looking_at_the_field(remote_centre: tuple[float, float, float]) -> Float64[np.ndarray, "4 4"]:
    """The base with -z, the shaft's direction at joints 0, towards the field, and x to the right of the image."""
    origin = np.array(remote_centre)
    z = origin - _FIELD_CENTRE_CAMERA
    z /= np.linalg.norm(z)
    y = np.cross(z, (1.0, 0.0, 0.0))
    y /= np.linalg.norm(y)
    T_camera_base = transform(np.stack((np.cross(y, z), y, z), axis=1), origin)
    T_camera_base.flags.writeable = False
    return T_camera_base


SIMULATED_BASES = {arm: _looking_at_the_field(centre) for arm, centre in _REMOTE_CENTRES_CAMERA.items()}
"""`T_camera_base` of each arm that has a place of its own: its base coordinates to camera coordinates, metres."""
SIMULATED_T_CAMERA_BASE = SIMULATED_BASES["psm1"]
