"""One unit for everything in space: millimetres, whatever the calibration's unit is.

Plans and arms are in metres and a thread is in its calibration's unit, so both are brought to millimetres; a viewer's
camera also cannot come as close as a thread needs when the scene is a tenth of a unit away. Where nobody knows the
calibration's unit, the thread stays in it.
"""

from dataclasses import replace

from schemas.messages import RectifiedStereo, ThreadObservations, ThreadReconstruction

MM = 1e-3
MM_PER_METRE = 1000.0


def camera_in_mm(camera: RectifiedStereo) -> RectifiedStereo:
    """The same cameras, their baseline in millimetres."""
    return replace(camera, baseline=camera.baseline * _mm_per_unit(camera), metres_per_unit=_unit(camera))


def observations_in_mm(observations: ThreadObservations) -> ThreadObservations:
    """The same observations, in millimetres."""
    scale = _mm_per_unit(observations.camera)
    if scale == 1.0:
        return observations
    return replace(
        observations, camera=camera_in_mm(observations.camera), points_camera=observations.points_camera * scale
    )


def reconstruction_in_mm(reconstruction: ThreadReconstruction) -> ThreadReconstruction:
    """The same thread, in millimetres."""
    scale = _mm_per_unit(reconstruction.camera)
    if scale == 1.0:
        return reconstruction
    regions = reconstruction.regions
    return replace(
        reconstruction,
        camera=camera_in_mm(reconstruction.camera),
        control_points_camera=reconstruction.control_points_camera * scale,
        regions=replace(regions, centre_camera=regions.centre_camera * scale, bound_depth=regions.bound_depth * scale),
        posterior_covariance=reconstruction.posterior_covariance * scale**2,
    )


def _mm_per_unit(camera: RectifiedStereo) -> float:
    return 1.0 if camera.metres_per_unit in (None, MM) else camera.metres_per_unit / MM


def _unit(camera: RectifiedStereo) -> float | None:
    return None if camera.metres_per_unit is None else MM
