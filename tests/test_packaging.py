"""What holds of the distribution as a whole."""

import importlib.metadata
import pathlib
import re
import subprocess

import pytest

import agents
import schemas
import shared

ROOT = pathlib.Path(__file__).parents[1]
PACKAGES = (agents, shared, schemas)


def tracked_files(*patterns):
    listed = subprocess.run(["git", "ls-files", *patterns], cwd=ROOT, capture_output=True, text=True, check=True)  # noqa: S607
    return listed.stdout.split()


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.__name__)
def test_the_packages_with_generic_names_are_ours(package):
    assert pathlib.Path(package.__file__).parent == ROOT / package.__name__


@pytest.mark.slow
@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.__name__)
def test_no_other_distribution_provides_a_package_of_our_names(package):
    providers = importlib.metadata.packages_distributions().get(package.__name__, ["suturegrasp"])
    assert set(providers) == {"suturegrasp"}


def test_the_version_is_that_of_the_installed_distribution():
    assert importlib.metadata.version("suturegrasp") == schemas.__version__


@pytest.mark.parametrize("lock", ["runtime", "dev", "train"])
def test_locks_hold_names_versions_and_hashes_and_no_address(lock):
    lines = (ROOT / "requirements" / f"{lock}.lock").read_text().splitlines()
    pinned = re.compile(r"[a-z0-9._-]+==[^ ]+ \\|    --hash=sha256:[0-9a-f]{64}( \\)?|(# [^/]*)?")
    assert lines
    assert [line for line in lines if not pinned.fullmatch(line)] == []


def test_tests_shadow_no_package():
    assert tracked_files("tests/**/__init__.py", "tests/__init__.py") == []


def test_every_relative_link_in_the_documents_leads_somewhere():
    broken = []
    for name in tracked_files("*.md"):
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", (ROOT / name).read_text()):
            if not (ROOT / name).parent.joinpath(target).exists():
                broken.append(f"{name}: {target}")
    assert broken == []
