"""What a recording tells of the run that it is of: program, machine, configuration, and what a lab must keep."""

import platform
import socket
from datetime import UTC, datetime, timedelta
from importlib.metadata import PackageNotFoundError, version

import schemas
from agents.configuration.rig import RecorderSection, RigConfig
from agents.recorder.parts import Attached
from schemas.wire import schemas_hash
from shared.clock import now_ns
from shared.recording.entry import Note
from shared.runtime.clocks import ClockOffset, by_host
from shared.runtime.config import config_hash

RUN, STUDY, CLOCKS = "run", "study", "clocks"
PACKAGES = ("eclipse-zenoh", "mcap", "numpy", "opencv-python-headless", "protobuf", "rerun-sdk", "scipy")
CONFIGURATION_FILE = "configuration.json"
STUDY_FACTS = ("protocol", "specimen", "operator", "consent", "retention_days")


def notes_of(rig: RigConfig, section: RecorderSection) -> tuple[Note, ...]:
    """The notes that a recording of a rig begins with."""
    began = datetime.fromtimestamp(now_ns() * 1e-9, UTC)
    facts = {
        "rig": rig.rig,
        "began": began.isoformat(timespec="milliseconds"),
        "suturegrasp": schemas.__version__,
        "schema_hash": schemas_hash(),
        "config_hash": config_hash(rig),
        "host": socket.gethostname(),
        "system": platform.platform(),
        "python": platform.python_version(),
        **{package: _version(package) for package in PACKAGES},
    }
    study = {name: str(value) for name in STUDY_FACTS if (value := getattr(section, name)) is not None}
    if section.retention_days is not None:
        study["delete_after"] = (began + timedelta(days=section.retention_days)).date().isoformat()
    return (Note(RUN, facts), *([Note(STUDY, study)] if study else []))


def attached_to(rig: RigConfig) -> tuple[Attached, ...]:
    """The files that belong to a recording of a rig from its beginning."""
    text = rig.model_dump_json(indent=1, exclude_none=True) + "\n"
    return (Attached(CONFIGURATION_FILE, "application/json", text.encode()),)


def clocks_note(offsets: dict[str, ClockOffset | None]) -> Note:
    """How far the clocks of the agents' hosts are from the recorder's, in milliseconds."""
    known = by_host(offset for offset in offsets.values() if offset is not None)
    told = {offset.host: f"{offset.ahead_ms:+.3f} ms ahead, within {offset.within_ms:.3f} ms" for offset in known}
    silent = sorted(name for name, offset in offsets.items() if offset is None)
    facts = {"at_ns": str(now_ns()), "recorder": socket.gethostname(), **told}
    return Note(CLOCKS, facts | ({"no answer": ", ".join(silent)} if silent else {}))


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
