"""What lifts a rig's configuration of an older version to this one: files on disk, and those that recordings hold."""

from typing import Any

from schemas.migrations import lifted_agent


def lifted(told: dict[str, Any]) -> dict[str, Any]:
    """The sections of this version for those of an older one; what was never valid is left for the checks to judge.

    Raises:
        ValueError: where something was set that there no longer is.
    """
    return _without_links(_with_tool_trackers(told))


def _without_links(told: dict[str, Any]) -> dict[str, Any]:
    """Recordings of 0.2.0 hold `[links]`, with what it was unless somebody set it."""
    if told.get("links", {}) not in ({}, {"direct": False}):
        raise ValueError("[links] is gone: images go through the router, in shared memory; leave it out")
    return {name: section for name, section in told.items() if name != "links"}


def _with_tool_trackers(told: dict[str, Any]) -> dict[str, Any]:
    """Until 0.2.0 an arm's tool tracker was an instance of perception, named by `perception.track_tool`."""
    found = dict(told)
    perception = told.get("perception")
    if isinstance(perception, dict) and isinstance(tracked := perception.get("track_tool"), list | tuple):
        found["perception"] = {name: value for name, value in perception.items() if name != "track_tool"}
        if tracked:
            found["tool_tracker"] = {arm: {} for arm in tracked} | told.get("tool_tracker", {})
    for arm, section in _named(told, "robot"):
        if section.get("correction") == "perception":
            found["robot"] = found["robot"] | {arm: section | {"correction": "tool_tracker"}}
    for host, section in _named(told, "hosts"):
        if isinstance(runs := section.get("runs"), list | tuple):
            found["hosts"] = found["hosts"] | {host: section | {"runs": [_run_lifted(name) for name in runs]}}
    return found


def _named(told: dict[str, Any], name: str) -> list[tuple[str, dict[str, Any]]]:
    """The sections `[name.*]`."""
    sections = told.get(name)
    found = sections.items() if isinstance(sections, dict) else ()
    return [(one, section) for one, section in found if isinstance(section, dict)]


def _run_lifted(name: Any) -> Any:
    return lifted_agent(name.replace(" ", "/")).replace("/", " ") if isinstance(name, str) else name
