"""Perception of threads as a rig's configuration says."""

from agents.configuration.rig import PerceptionSection
from agents.perception.agent import Perception, PerceptionConfig
from agents.perception.segmentation.promptable_model import PromptableFileError, PromptableFiles
from shared.runtime.agent import Agent
from shared.runtime.config import ConfigError


def perception_config(section: PerceptionSection, needs_matching: bool, needle: bool = False) -> PerceptionConfig:
    """What perception is told; whether it matches pixels is as the method of reconstruction needs it, if unset."""
    return PerceptionConfig(
        segmenter=None if section.segmenter == "auto" else section.segmenter,
        matching=needs_matching if section.matching is None else section.matching,
        needle=needle,
        promptable=promptable_files(section),
    )


def promptable_files(section: PerceptionSection) -> PromptableFiles | None:
    """Where the network lies that segmenter `promptable` runs; None where none is configured."""
    if section.promptable_encoder is None or section.promptable_decoder is None:
        return None
    return PromptableFiles(
        section.promptable_encoder,
        section.promptable_decoder,
        section.promptable_encoder_sha256,
        section.promptable_decoder_sha256,
    )


def built_perception(section: PerceptionSection, needs_matching: bool, needle: bool) -> Agent:
    """Perception of threads.

    Raises:
        ConfigError: where a configured network cannot be used.
    """
    try:
        return Perception(perception_config(section, needs_matching, needle))
    except PromptableFileError as error:
        raise ConfigError(f"[perception] {error}") from None
