"""Mitsuba, loaded when the first scene is traced: the one place that imports it."""

import os
import warnings
from functools import lru_cache
from pathlib import Path
from typing import Any

from shared.rendering.render import SceneError

MISSING = "scenes are path-traced by Mitsuba, which is not installed; run make sim, or pip install 'suturegrasp[sim]'"
LLVM_PLACES = (
    "/usr/lib/x86_64-linux-gnu/libLLVM-19.so",
    "/usr/lib/aarch64-linux-gnu/libLLVM-19.so",
    "/usr/lib/llvm-19/lib/libLLVM.so",
)


@lru_cache(maxsize=1)
def engine() -> Any:
    """Mitsuba with a variant set: for a graphics card where one is there, else compiled by LLVM, else plain and slow.

    Raises:
        SceneError: where Mitsuba is not installed, or cannot start; the text names the remedy.
    """
    library = llvm_library()
    if library is not None:
        os.environ["DRJIT_LIBLLVM_PATH"] = str(library)
    try:
        with warnings.catch_warnings():
            # its bindings warn about themselves under some Python versions
            warnings.simplefilter("ignore", DeprecationWarning)
            import drjit  # pyright: ignore[reportMissingImports]
            import mitsuba  # pyright: ignore[reportMissingImports]

            if drjit.has_backend(drjit.JitBackend.CUDA):
                mitsuba.set_variant("cuda_ad_rgb")
            else:
                mitsuba.set_variant("scalar_rgb" if library is None else "llvm_ad_rgb")
    except ImportError as error:
        missing = error.name in ("mitsuba", "drjit")
        raise SceneError(MISSING if missing else f"Mitsuba does not start: {error}") from error
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    drjit.set_thread_count(max(int(os.environ.get("SUTUREGRASP_TRACE_THREADS", "1")), 1))
    return mitsuba


def reinterpreted(pointers: Any) -> Any:
    """Pointers of the compiled variant as the numbers that stand for them in images."""
    import drjit  # pyright: ignore[reportMissingImports]

    return drjit.reinterpret_array(engine().UInt32, pointers)


def llvm_library() -> Path | None:
    """LLVM's library: named by DRJIT_LIBLLVM_PATH, or LLVM 19 where Debian puts it; older ones abort the process.

    Raises:
        SceneError: where the variable names no file.
    """
    named = os.environ.get("DRJIT_LIBLLVM_PATH")
    if named:
        if not Path(named).is_file():
            raise SceneError(f"DRJIT_LIBLLVM_PATH names {named}, where there is no file; unset it or correct it")
        return Path(named)
    found = (Path(place) for place in LLVM_PLACES if Path(place).is_file())
    return next(found, None)
