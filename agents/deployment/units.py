"""systemd units of a host: one for each process, and a target for all of them.

Each process has a user of its own, and reads its own key only, through LoadCredential=; it says by sd_notify when it is
ready and, from its loop, that it lives. Nothing gains privileges, and nothing but a recorder may write.
"""

import hashlib
from pathlib import PurePosixPath

from agents.deployment.layout import ROUTER, Host, Process
from agents.deployment.places import CERTIFICATES, GROUP, HOME, PROGRAM, RIG_FILE, SESSIONS
from agents.deployment.robot_zenoh import ROBOT_ZENOH
from agents.registry import NAMES, Pace, with_pace
from schemas.topics import MAIN
from shared.runtime.identity import AUTHORITY_FILE

TARGET = "suturegrasp.target"
LONGEST_USER = 31
GUARD = "guard"
AGENTS = (*NAMES, GUARD)
"""What has a loop of its own, from which it tells that it is alive."""
WATCHDOG_S = 10
"""A loop that says nothing for so long hangs; its longest wait is half a second, and its longest step a few."""
WATCHDOG_OF_COMPUTING_S = 60
"""Of what drives nothing, and whose first step takes longest: where others have the processor, it would be killed in it
each time, and never get beyond it."""
COMPUTING = with_pace(Pace.STEPS_BACK)
REALTIME_KINDS = with_pace(Pace.KEEPS_TIME) | {GUARD}
"""What keeps time; the others would take the processor from them."""
REALTIME_PRIORITY = 50
OF_AN_ARM = ("robot_bridge", GUARD)
TOOL_TRACKER = "perception"
"""One beside the thread's own for each arm whose instrument is looked for; its instance is the arm."""
COMMANDS = {
    "robot_bridge": "robot-bridge --arm {instance}",
    GUARD: "guard --arm {instance}",
    "recorder": "record --output {session} --numbered",
}
PEOPLE = "operator"
NOT_OURS = (PEOPLE, ROBOT_ZENOH)
"""Has a certificate and no process of ours: commands run as long as somebody needs them, the robot's Zenoh by ROS."""
HARDENED = """\
NoNewPrivileges=yes
PrivateTmp=yes
ProtectSystem=strict
ProtectHome=yes
ProtectHostname=yes
ProtectClock=yes
ProtectKernelTunables=yes
ProtectKernelModules=yes
ProtectKernelLogs=yes
ProtectControlGroups=yes
ProtectProc=invisible
RestrictNamespaces=yes
RestrictSUIDSGID=yes
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6
LockPersonality=yes
RemoveIPC=no
CapabilityBoundingSet=
SystemCallArchitectures=native
SystemCallFilter=@system-service
UMask=0027
"""


def names_its_arm(process: Process) -> bool:
    """Whether a process is one of an arm's."""
    return process.kind in OF_AN_ARM or (process.kind == TOOL_TRACKER and process.instance != MAIN)


def command_of(process: Process) -> str:
    """What a process is started by, with places for its instance and the session's file."""
    if process.kind == TOOL_TRACKER and process.instance != MAIN:
        return "perception --arm {instance}"
    return COMMANDS.get(process.kind, process.kind)


def unit_name(process: Process) -> str:
    """File name of the unit of a process."""
    ending = f"-{process.instance}" if names_its_arm(process) else ""
    return f"suturegrasp-{process.kind.replace('_', '-')}{ending}.service"


def user_of(process: Process) -> str:
    """The system user that a process runs as: one of its own, of at most the 31 letters that such a name may have."""
    name = unit_name(process).removesuffix(".service")
    if len(name) <= LONGEST_USER:
        return name
    told_apart = hashlib.sha256(name.encode()).hexdigest()[:6]
    return f"{name[: LONGEST_USER - 7]}-{told_apart}"


def units(rig: str, host: Host) -> dict[str, str]:
    """Every unit of a host, by file name."""
    services = {unit_name(p): _service(rig, host, p) for p in host.processes if p.kind not in NOT_OURS}
    target = (
        "[Unit]\n"
        f"Description=SutureGrasp, rig {rig}, host {host.name}\n"
        f"Wants={' '.join(services)}\n\n"
        "[Install]\nWantedBy=multi-user.target\n"
    )
    return {**services, TARGET: target}


def _service(rig: str, host: Host, process: Process) -> str:
    command = command_of(process).format(instance=process.instance, session=state_of(process) / "session.mcap")
    if process.kind == "viewer":
        command = f"view --output {state_of(process) / 'session.rrd'} --numbered --show file"
    name = process.common_name
    credentials = (AUTHORITY_FILE, f"{name}.pem", f"{name}.key")
    sections = (
        "[Unit]",
        f"Description=SutureGrasp {process.kind} {process.instance} of rig {rig}",
        "Wants=network-online.target",
        "After=network-online.target time-sync.target",
        f"PartOf={TARGET}",
        *_order(host, process),
        "# it may be away for as long as it takes: nothing is given up",
        "StartLimitIntervalSec=0",
        "",
        "[Service]",
        "Type=notify",
        f"ExecStart={PROGRAM} {command} --config {HOME / RIG_FILE} --host {host.name}",
        f"User={user_of(process)}",
        f"Group={GROUP}",
        *(f"LoadCredential={file}:{CERTIFICATES / file}" for file in credentials),
        "# ready once it has found the router, however long that takes",
        "TimeoutStartSec=infinity",
        *_watchdog(process),
        "TimeoutStopSec=15",
        "# Zenoh keeps the shared memory that images go through from being paged out",
        "LimitMEMLOCK=infinity",
        "Restart=on-failure",
        "# a configuration at fault is not mended by starting again",
        "RestartPreventExitStatus=2",
        "RestartSec=0.5",
        "# systemd before 254 does not know the next two, says so, and waits half a second each time",
        "RestartSteps=5",
        "RestartMaxDelaySec=10",
        *_priority(host, process),
        *_storage(process),
        *_devices(process),
        HARDENED,
    )
    return "\n".join(sections)


def _order(host: Host, process: Process) -> tuple[str, ...]:
    """A guard is there before the bridge that it guards, and goes after it."""
    guarded = Process("robot_bridge", process.instance)
    return (f"Before={unit_name(guarded)}",) if process.kind == GUARD and guarded in host.processes else ()


def _watchdog(process: Process) -> tuple[str, ...]:
    within_s = WATCHDOG_OF_COMPUTING_S if process.kind in COMPUTING else WATCHDOG_S
    return (f"WatchdogSec={within_s}",) if process.kind in AGENTS else ()


def _priority(host: Host, process: Process) -> tuple[str, ...]:
    if host.realtime and process.kind in REALTIME_KINDS:
        # it asks for itself, for the loop's thread alone
        return (f"LimitRTPRIO={REALTIME_PRIORITY}",)
    return ("RestrictRealtime=yes",)


def _storage(process: Process) -> tuple[str, ...]:
    own = f"{SESSIONS.name}/{state_of(process).name}"
    kept = (f"StateDirectory={own}", "StateDirectoryMode=0750")
    if process.kind in ("recorder", "viewer"):
        return (*kept, f"WorkingDirectory={state_of(process)}")
    if process.kind in OF_AN_ARM:
        # for the audit log
        return (*kept, f"WorkingDirectory={HOME}")
    return (f"WorkingDirectory={HOME}",)


def state_of(process: Process) -> PurePosixPath:
    """Where a process keeps what it writes, which is its own."""
    return SESSIONS / unit_name(process).removesuffix(".service").removeprefix("suturegrasp-")


def _devices(process: Process) -> tuple[str, ...]:
    if process.kind == "camera":
        return ("DevicePolicy=closed", "DeviceAllow=char-video4linux rw", "SupplementaryGroups=video")
    return ("PrivateDevices=yes",) if process.kind != ROUTER else ("PrivateDevices=yes", "LimitNOFILE=65536")
