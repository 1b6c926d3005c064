"""Where a command may write: what speaks against a place is said before any work is done."""

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from shared.terminal import UsageError


def check_new(path: Path) -> None:
    """Raise a UsageError where something is there already."""
    if path.exists():
        raise UsageError(f"{path} exists already; give another name")


def check_folder(option: str, folder: Path) -> None:
    """Raise a UsageError unless a folder is new or empty."""
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{option} {folder} is a file; give a folder that is new or empty")
    if folder.is_dir() and any(folder.iterdir()):
        raise UsageError(f"{option} {folder} holds something already; give a folder that is new or empty")


def check_outputs(outputs: Mapping[str, Path], inputs: Iterable[tuple[str, Path]]) -> None:
    """Raise a UsageError where a file cannot be written, or would overwrite an input or another output."""
    others = list(inputs)
    for option, path in outputs.items():
        if path.is_dir():
            raise UsageError(f"{option} {path} is a folder; give the name of a file")
        if not path.parent.is_dir():
            raise UsageError(f"the folder {path.parent} of {option} {path} does not exist; create it first")
        if not os.access(path.parent, os.W_OK | os.X_OK):
            raise UsageError(f"the folder {path.parent} of {option} {path} cannot be written to; choose another")
        for other_option, other in others:
            if _is_one_file(path, other):
                raise UsageError(f"{option} {path} would overwrite {other_option} {other}; give another name")
        others.append((option, path))


def _is_one_file(path: Path, other: Path) -> bool:
    """Whether both paths lead to the same file, which may not be there yet."""
    if os.path.realpath(path) == os.path.realpath(other):
        return True
    return path.exists() and other.exists() and path.samefile(other)
