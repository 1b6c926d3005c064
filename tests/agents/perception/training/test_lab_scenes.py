"""Lab scenes: the same for the same seed, classes that share no pixel twice, and files that are left alone."""

from pathlib import Path

import numpy as np
import pytest

from agents.perception.training.lab_ground import SEALED, TRAIN
from agents.perception.training.lab_instruments import Solid, load_meshes
from agents.perception.training.lab_scenes import NAMES, lab_scene, main

pytestmark = pytest.mark.renders

MESHES = Path("../shared/data/instruments")
SEEDS = 12
LEAST_PX = 30


@pytest.fixture(scope="module")
def meshes() -> dict[str, Solid]:
    """The needle driver's."""
    if not MESHES.exists():
        pytest.skip(f"{MESHES} is absent")
    return load_meshes(MESHES)


def test_sealed_scenes_are_drawn_from_lists_of_their_own(meshes: dict[str, Solid]) -> None:
    assert not set(TRAIN.pads) & set(SEALED.pads)
    assert not set(TRAIN.threads) & set(SEALED.threads)
    for name in ("light_angles", "shaft_angles", "jaw_angles", "wrist_angles", "slit_turns"):
        pairs = [(one, two) for one in getattr(TRAIN, name) for two in getattr(SEALED, name)]
        assert all(one[1] <= two[0] or two[1] <= one[0] for one, two in pairs), name
    first, second = (lab_scene(2, meshes, lists).image for lists in (TRAIN, SEALED))
    assert first.shape != second.shape or not np.array_equal(first, second)


def test_files_are_written_once_and_absent_meshes_told_in_one_sentence(
    meshes: dict[str, Solid], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert meshes
    command = ["--seed", "7", "--output", str(tmp_path), "--meshes", str(MESHES)]
    assert main([*command, "--count", "1"]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {f"lab_000007_{name}.png" for name in NAMES}
    kept = tmp_path / "lab_000007_left.png"
    kept.write_bytes(b"kept")
    assert main([*command, "--count", "2"]) == 0
    assert kept.read_bytes() == b"kept"
    assert len(list(tmp_path.iterdir())) == 2 * len(NAMES)
    capsys.readouterr()
    assert main(["--count", "1", "--output", str(tmp_path / "out"), "--meshes", str(tmp_path)]) == 2
    told = capsys.readouterr().err
    assert "roll_4162.dae (No such file" in told
    assert told.count("\n") == 1


def test_one_seed_makes_one_scene_whose_classes_share_pixels_and_all_occur(meshes: dict[str, Solid]) -> None:
    scenes = [lab_scene(seed, meshes) for seed in range(1, SEEDS + 1)]
    for scene in scenes:
        assert scene.covers.shape[1:] == scene.image.shape[:2]
        assert scene.covers.astype(int).sum(axis=0).max() <= 255 + 2
    shown = [(scene.covers > 127).sum(axis=(1, 2)) >= LEAST_PX for scene in scenes]
    assert (np.sum(shown, axis=0) >= 3).all()
    again = lab_scene(1, meshes)
    np.testing.assert_array_equal(scenes[0].image, again.image)
    np.testing.assert_array_equal(scenes[0].covers, again.covers)
