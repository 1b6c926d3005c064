"""Render one stereo pair with its truth: python -m shared.rendering --config medium --seed 1 --output DIR."""

import argparse
import sys
from pathlib import Path

from shared.rendering.files import write_pair
from shared.rendering.render import BACKGROUNDS, COLOURS, SceneError, make_scene, render
from shared.rendering.thread_shapes import CONFIGS, ShapeError


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, render, write; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m shared.rendering", description=__doc__)
    parser.add_argument("--config", choices=CONFIGS, default="medium", help="how hard the thread lies")
    parser.add_argument("--background", choices=BACKGROUNDS, default="tissue")
    parser.add_argument("--colour", choices=COLOURS, default="violet")
    parser.add_argument("--distance-mm", type=float, default=95.0, help="from the camera to the tissue")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-masks", action="store_true", help="leave out the coverage images")
    parser.add_argument("--output", type=Path, required=True, help="folder to write into")
    chosen = parser.parse_args(arguments)
    try:
        scene = make_scene(chosen.config, chosen.background, chosen.seed, chosen.colour, chosen.distance_mm)
        write_pair(chosen.output, scene, render(scene), masks=not chosen.no_masks)
    except (SceneError, ShapeError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
