"""Where the jaw of an arm's instrument closes, out of the file that a rig's configuration names."""

from agents.configuration.sections import ArmSection
from shared.calibration import CalibrationError
from shared.calibration.jaw.file import JawZero, read_jaw_zero
from shared.runtime.config import ConfigError


def jaw_zero_of(arm: str, section: ArmSection) -> JawZero | None:
    """What the file of an arm's section tells; None where it names none.

    Raises:
        ConfigError: where the file is none, or is of another arm or instrument.
    """
    if section.jaw_file is None:
        return None
    try:
        found = read_jaw_zero(section.jaw_file)
    except CalibrationError as error:
        raise ConfigError(f"robot.{arm}.jaw_file: {error}") from None
    tool = "" if section.dvrk is None else section.dvrk.tool
    for told, own in ((found.arm, arm), (found.instrument, tool)):
        if own and told != own:
            other = f"{section.jaw_file} is of {told}, and this is {own}"
            raise ConfigError(f"robot.{arm}.jaw_file: {other}; name its own, of suturegrasp calibrate jaw")
    return found
