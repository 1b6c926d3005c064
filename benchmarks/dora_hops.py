"""dora-rs beside us: installed into a virtual environment of its own, and run for the same payload at the same rate."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.hop_ends import Load

PACKAGES = ("dora-rs==1.1.0", "dora-rs-cli==1.1.0", "pyarrow", "numpy")
INSTALL_LIMIT_S = 300.0
NEWEST, EVERY = 1, 1000
"""Messages that wait at dora's receiver: as ours, of frames the newest counts, and of events each one."""
ENDS = Path(__file__).with_name("dora_ends.py")


class NoDoraError(RuntimeError):
    """dora-rs cannot be had or does not run here; the text says why."""


def dora_environment() -> Path:
    """The folder of a virtual environment with dora-rs, made when first asked for and kept in the user's cache.

    Raises:
        NoDoraError: where its packages cannot be installed.
    """
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = cache / "suturegrasp" / "dora-1.1.0"
    done = folder / "done"
    if done.exists():
        return folder
    try:
        _run([sys.executable, "-m", "venv", str(folder)])
        _run([str(folder / "bin" / "python"), "-m", "pip", "install", "--quiet", *PACKAGES])
    except (OSError, subprocess.SubprocessError) as error:
        said = getattr(error, "stderr", "") or str(error)
        raise NoDoraError(f"dora-rs cannot be installed: {said.strip().splitlines()[-1]}") from error
    done.touch()
    return folder


def dora_ms(environment: Path, load: Load) -> list[float]:
    """Milliseconds of each hop between two Python nodes of dora-rs.

    Raises:
        NoDoraError: where its dataflow fails.
    """
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        readings = folder / "readings.json"
        given = {"bytes": load.bytes, "count": load.count, "rate_hz": load.rate_hz, "readings": str(readings)}
        (folder / "flow.yml").write_text(json.dumps(_dataflow(json.dumps(given), NEWEST if load.is_frame else EVERY)))
        path = os.pathsep.join((str(environment / "bin"), os.environ["PATH"]))
        try:
            _run([str(environment / "bin" / "dora"), "run", "flow.yml"], folder, os.environ | {"PATH": path})
            return json.loads(readings.read_text())
        except (OSError, subprocess.SubprocessError) as error:
            raise NoDoraError(f"dora-rs does not run here: {error}") from error


def _dataflow(given: str, waiting: int) -> dict[str, object]:
    """Two nodes; JSON is YAML too."""
    common = {"path": str(ENDS), "env": {"HOP": given}}
    of = {"data": {"source": "send/data", "queue_size": waiting}}
    send = common | {"id": "send", "args": "send", "outputs": ["data"]}
    return {"nodes": [send, common | {"id": "receive", "args": "receive", "inputs": of}]}


def _run(command: list[str], folder: Path | None = None, environment: dict[str, str] | None = None) -> None:
    subprocess.run(
        command, check=True, cwd=folder, env=environment, capture_output=True, text=True, timeout=INSTALL_LIMIT_S
    )
