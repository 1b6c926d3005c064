"""The middle of the thread in one image, to a fraction of a pixel."""

from agents.perception.centrelines.centrelines import thread_centrelines

__all__ = ["thread_centrelines"]
