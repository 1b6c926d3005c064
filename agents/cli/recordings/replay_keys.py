"""Keys that steer a replay: space holds it and lets it go on, n steps to the next frame, q ends it.

On a terminal each key counts at once; elsewhere each line of standard input is a step.
"""

import contextlib
import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Generator

from agents.replay.player import Controls

LOOK_S = 0.1


@contextlib.contextmanager
def steered(controls: Controls, by_lines: bool) -> Generator[None]:
    """Have a replay steered by standard input meanwhile: by keys on a terminal, `by_lines` elsewhere, or not at all."""
    on_terminal = sys.stdin is not None and sys.stdin.isatty()
    if not (on_terminal or by_lines):
        yield
        return
    ended = threading.Event()
    thread = threading.Thread(target=_keys if on_terminal else _lines, args=(controls, ended), name="keys", daemon=True)
    with _each_key_at_once() if on_terminal else contextlib.nullcontext():
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join(2 * LOOK_S)


@contextlib.contextmanager
def _each_key_at_once() -> Generator[None]:
    number = sys.stdin.fileno()
    before = termios.tcgetattr(number)
    tty.setcbreak(number)
    try:
        yield
    finally:
        termios.tcsetattr(number, termios.TCSADRAIN, before)


def _keys(controls: Controls, ended: threading.Event) -> None:
    for character in _read(ended):
        match character:
            case " ":
                controls.toggle()
            case "n" | "\n":
                controls.step()
            case "q":
                controls.stop()
            case _:
                pass


def _lines(controls: Controls, ended: threading.Event) -> None:
    for character in _read(ended):
        if character == "\n":
            controls.step()
    if not ended.is_set():
        # whoever stepped has left
        controls.stop_when_done()


def _read(ended: threading.Event) -> Generator[str]:
    """What comes on standard input, until its end or that of the replay."""
    number = sys.stdin.fileno()
    while not ended.is_set():
        if select.select([number], [], [], LOOK_S)[0]:
            read = os.read(number, 1)
            if not read:
                return
            yield read.decode("utf-8", "replace")
