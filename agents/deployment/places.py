"""Where things lie on a host of the rig, and in a container."""

from pathlib import PurePosixPath

PROGRAM = PurePosixPath("/opt/suturegrasp/.venv/bin/suturegrasp")
"""A checkout of this project lies in /opt/suturegrasp, with its virtual environment as `make install` makes it."""
HOME = PurePosixPath("/etc/suturegrasp")
RIG_FILE = "rig.toml"
CERTIFICATES = HOME / "certificates"
UNITS = PurePosixPath("/etc/systemd/system")
GROUP = "suturegrasp"
"""Of all services, and of people who read what they record; it reads no key."""
OPERATORS, ROBOT_USERS = "suturegrasp-operators", "suturegrasp-robot"
"""People who give commands, and the user that runs the robot's Zenoh: each group reads one key, and no service is in
either."""
SESSIONS = PurePosixPath("/var/lib/suturegrasp")
SECRETS = PurePosixPath("/run/secrets")
"""Where Compose puts what a container alone may read."""
AUTHORITY_FOLDER = "authority"
"""Where the authority's key lies, beside the folders that are copied to hosts."""
