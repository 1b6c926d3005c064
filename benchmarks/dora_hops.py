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
        (folder / "flow.yml").write_text(json.dumps(_dataflow(json.dumps(given))))
        path = os.pathsep.join((str(environment / "bin"), os.environ["PATH"]))
        try:
            _run([str(environment / "bin" / "dora"), "run", "flow.yml"], folder, os.environ | {"PATH": path})
            return json.loads(readings.read_text())
        except (OSError, subprocess.SubprocessError) as error:
            raise NoDoraError(f"dora-rs does not run here: {error}") from error


def _dataflow(given: str) -> dict[str, object]:
    """JSON is YAML too. A queue of one is dora's way to the newest message."""
    common = {"path": str(ENDS), "env": {"HOP": given}}
    send = common | {"id": "send", "args": "send", "outputs": ["data"]}
    receive = common | {
        "id": "receive",
        "args": "receive",
        "inputs": {"data": {"source": "send/data", "queue_size": 1}},
    }
    return {"nodes": [send, receive]}


def _run(command: list[str], folder: Path | None = None, environment: dict[str, str] | None = None) -> None:
    subprocess.run(
        command, check=True, cwd=folder, env=environment, capture_output=True, text=True, timeout=INSTALL_LIMIT_S
    )
