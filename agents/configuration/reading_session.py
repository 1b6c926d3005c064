"""With which of this host's certificates a command looks at a rig: all of them may read all of it."""

from pathlib import Path

from agents.configuration.hosts import OPERATOR
from agents.configuration.rig import RigConfig
from agents.deployment.layout import SERVERS
from shared.runtime.identity import AUTHORITY_FILE, identity_in
from shared.runtime.session import SessionSettings

KEY_SUFFIX = ".key"


def reading_session(rig: RigConfig) -> SessionSettings:
    """How `status` and `doctor` reach a rig: as this host's operator, or where it has none, as whatever it has."""
    own = rig.session
    if rig.security is None or own.identity is None or own.identity.certificate.exists():
        return own
    names = certificate_names(rig.security.certificates)
    return session_as(rig, names[0]) if names else own


def session_as(rig: RigConfig, name: str) -> SessionSettings:
    """How a common name reaches a rig that has certificates."""
    identity = None if rig.security is None else identity_in(rig.security.certificates, name)
    return SessionSettings(rig.rig, rig.router_endpoint, identity, rig.rows_otherwise)


def certificate_names(folder: Path) -> list[str]:
    """The common names that this host has certificates and keys of, those of routers left out; operators come first."""
    if not folder.is_dir():
        return []
    names = [p.stem for p in folder.glob("*.pem") if p.name != AUTHORITY_FILE and p.with_suffix(KEY_SUFFIX).exists()]
    agents = [name for name in names if "." in name and name.split(".")[0] not in SERVERS]
    return sorted(agents, key=lambda name: (not name.startswith(f"{OPERATOR}."), name))
