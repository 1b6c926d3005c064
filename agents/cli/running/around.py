"""What each process of a rig knows of its host and its file, to be told to whoever asks."""

from typing import Any

from agents.cli.rig.config import RigConfig
from agents.cli.rig.digest import rig_sections
from shared.runtime.facts import Surroundings
from shared.runtime.identity import validity_ns


def around(rig: RigConfig, name: str, **own: Any) -> Surroundings:
    """What a process, as `runs` writes it, knows; `own` is what it alone does.

    Raises:
        IdentityError: where its certificate cannot be read.
    """
    identity = rig.identity_of(name)
    return Surroundings(
        certificate_expires_ns=None if identity is None else validity_ns(identity.certificate)[1],
        overrides=rig.overrides,
        rig_sections=rig_sections(rig),
        **own,
    )
