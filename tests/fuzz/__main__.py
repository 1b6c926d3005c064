"""Look for bytes that a target does not stand: `python -m tests.fuzz TARGET [--seconds 60]`.

Where atheris is installed (pip install atheris) it is led by coverage, and what reaches new lines is kept in
tests/fuzz/corpus/TARGET, the smallest of each; without it the corpus is changed at random. Every kept file is a test.
"""

import argparse
import random
import subprocess
import sys
import tempfile
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from shared.clock import monotonic_s

CORPUS = Path(__file__).parent / "corpus"
NAMES = ("console", "ros", "guarded", "heartbeats", "page", "mcap", "calibration", "hand_eye")
LONGEST, MOST_KEPT = 4096, 150
INSTRUMENTED = ["agents", "schemas", "shared", "mcap", "rosbags"]


def main() -> int:
    """Fuzz one target, or all in turn."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("target", choices=(*NAMES, "all"))
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--led-by-coverage", metavar="PROGRAM", help=argparse.SUPPRESS)
    options, rest = parser.parse_known_args()
    if options.led_by_coverage:
        return _coverage_guided(options.target, [options.led_by_coverage, *rest])
    failed = 0
    for name in NAMES if options.target == "all" else (options.target,):
        (CORPUS / name).mkdir(parents=True, exist_ok=True)
        failed |= _by_coverage(name, options.seconds) if find_spec("atheris") else _at_random(name, options.seconds)
    return failed


def _by_coverage(name: str, seconds: float) -> int:
    """libFuzzer ends its process, so each run is one of its own: look for, then keep the smallest of what was found."""
    from tests.fuzz.targets import seeds

    corpus = CORPUS / name
    with tempfile.TemporaryDirectory() as folder:
        found, smallest, program = (Path(folder) / part for part in ("found", "smallest", "fuzz"))
        for part in (found, smallest):
            part.mkdir()
        # libFuzzer starts itself anew by its first argument
        program.write_text(f'#!/bin/sh\nexec {sys.executable} -m tests.fuzz {name} --led-by-coverage "$0" "$@"\n')
        program.chmod(0o755)
        own = [str(program), f"-artifact_prefix={corpus}/"]
        for number, seed in enumerate(seeds(name)):
            (found / f"seed{number}").write_bytes(seed)
        limits = [f"-max_total_time={seconds:g}", f"-max_len={LONGEST}", "-timeout=20", "-rss_limit_mb=4096"]
        ended = subprocess.run([*own, *limits, str(found), str(corpus)], check=False).returncode
        subprocess.run([*own, "-merge=1", str(smallest), str(corpus), str(found)], check=True)
        for old in corpus.iterdir():
            old.unlink()
        kept = sorted(smallest.iterdir(), key=lambda path: path.stat().st_size)[:MOST_KEPT]
        for path in kept:
            (corpus / path.name[:16]).write_bytes(path.read_bytes())
    sys.stdout.write(f"{name}: {len(kept)} kept, {'a defect: see above' if ended else 'no defect'}\n")
    return int(ended != 0)


def _coverage_guided(name: str, arguments: list[str]) -> int:
    # it is no dependency: the index has it for some systems only
    atheris: Any = import_module("atheris")

    with atheris.instrument_imports(include=INSTRUMENTED, enable_loader_override=False):
        from tests.fuzz.targets import TARGETS
    atheris.Setup(arguments, TARGETS[name])
    atheris.Fuzz()
    return 0


def _at_random(name: str, seconds: float) -> int:
    from tests.fuzz.targets import TARGETS, seeds

    rng, until_s, tried = random.Random(0), monotonic_s() + seconds, 0
    known = seeds(name) + [path.read_bytes() for path in sorted((CORPUS / name).iterdir())]
    while monotonic_s() < until_s:
        data = changed(rng.choice(known), rng.choice(known), rng)
        tried += 1
        if (why := fails(TARGETS[name], data)) is not None:
            (CORPUS / name / "defect").write_bytes(data)
            sys.stdout.write(f"{name}: {why}; kept as {CORPUS / name / 'defect'}\n")
            return 1
    sys.stdout.write(f"{name}: {tried} tried at random, no defect (atheris is not installed)\n")
    return 0


def changed(data: bytes, other: bytes, rng: random.Random) -> bytes:
    """Bytes with a few changes: bits, numbers, cuts, and parts of others."""
    found = bytearray(data)
    for _ in range(rng.randint(1, 6)):
        at = rng.randrange(len(found) + 1)
        match rng.randrange(5):
            case 0 if at < len(found):
                found[at] ^= 1 << rng.randrange(8)
            case 1:
                found[at : at + rng.choice((1, 2, 4, 8))] = rng.choice((b"\xff", b"\x00", b"\x7f", b"\x80"))
            case 2:
                del found[at : at + rng.randint(1, 32)]
            case 3:
                start = rng.randrange(len(other) + 1)
                found[at:at] = other[start : start + rng.randint(1, 64)]
            case _:
                found[at:at] = rng.randbytes(rng.randint(1, 8))
    return bytes(found[:LONGEST])


def fails(target: Callable[[bytes], None], data: bytes) -> str | None:
    """What a target raises, or None."""
    try:
        target(data)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return None


if __name__ == "__main__":
    sys.exit(main())
