"""How old the calibrations may be that a rig's agents use, and what to do about those that are older."""

from dataclasses import dataclass

from agents.configuration.rig import RigConfig
from agents.diagnostics.status.health_watch import span_of

NS_PER_S, DAY_NS = 1e9, 86400 * 10**9
CHECK = (
    "see with suturegrasp calibrate check whether it still holds, or calibrate anew with suturegrasp calibrate stereo"
)
ANEW = "register the arm anew with suturegrasp calibrate hand-eye"


@dataclass(frozen=True)
class Allowed:
    """How old one may be.

    Fields:
        key: of the rig's file, by which that is told.
        remedy: what to do about an older one.
        untold: why nobody knows when it was made, where its file does not state it.
    """

    days: float
    key: str
    remedy: str
    untold: str = "its file does not tell, as those of suturegrasp calibrate do"

    @property
    def words(self) -> str:
        """As a sentence has it."""
        return f"and {self.key} allows {self.days:g} days"


def allowed_ages(rig: RigConfig) -> dict[str, Allowed]:
    """By `kind/instance`, of agents that use a calibration; what is simulated is as it was told, however long ago."""
    ages: dict[str, Allowed] = {}
    if rig.camera is not None and rig.camera.source != "scene":
        own = Allowed(rig.camera.calibration_days, "camera.calibration_days", CHECK)
        published = "it came with the images" if rig.camera.calibration is None else own.untold
        ages["camera/main"] = Allowed(own.days, own.key, own.remedy, published)
    for arm, section in rig.robot.items():
        if section.T_camera_base_file is None and section.dvrk is None:
            continue
        key, typed = f"robot.{arm}.T_camera_base_days", "it is typed into the rig's file"
        told = {} if section.T_camera_base_file is not None else {"untold": typed}
        ages[f"robot_bridge/{arm}"] = Allowed(section.T_camera_base_days, key, ANEW, **told)
    return ages


def too_old(allowed: Allowed, made_ns: int, at_ns: int) -> str:
    """How old one is that is older than is allowed; else empty."""
    age_s = (at_ns - made_ns) / NS_PER_S
    return f"made {span_of(age_s)} ago, {allowed.words}" if age_s * NS_PER_S > allowed.days * DAY_NS else ""
