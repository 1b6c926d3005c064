"""What agents of a rig tell of themselves, with as little of it as a test needs."""

from typing import Any

from schemas.messages import AgentFacts, AgentHealth, InputHealth

NOW_NS = 1_800_000_000_000_000_000
DAY_NS = 86400 * 10**9


def health(agent="camera", instance="main", inputs=(), outputs=(), fault="", uptime_s=60.0, version="0.2.0", host="a"):
    """How an agent fares, by its own account."""
    return AgentHealth(
        agent, instance, host, version, "hash", NOW_NS, uptime_s, 7, 2.0, 3.0, tuple(inputs), tuple(outputs), fault
    )


def heard(topic, rate_hz=30.0, age_ms: float | None = 5.0, missed=0, refused=0):
    """What an agent says of one of its inputs."""
    return InputHealth(topic, rate_hz, age_ms, 100, 0, missed, refused)


def facts(**told):
    """What an agent that began tells once."""
    values: dict[str, Any] = {
        "agent": "camera", "instance": "main", "host": "a", "at_ns": NOW_NS, "version": "0.2.0", "schemas_hash": "s",
        "config_hash": "c", "python": "3.11", "zenoh": "1", "shared_memory": False, "shared_memory_reason": "it is far",
        "realtime_asked": None, "realtime_granted": None, "realtime_reason": "", "writes_to": "",
        "disk_free_bytes": None, "calibrated_ns": None, "certificate_expires_ns": None, "processor_s": 1.0,
        "resident_bytes": 1,
    }  # fmt: skip
    return AgentFacts(**(values | told))
