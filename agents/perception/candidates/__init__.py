"""Several threads: which pieces of the middle belong together, how sure each thread is, and which one is meant."""

from agents.perception.candidates.both_eyes import length_in_common_px
from agents.perception.candidates.candidates import Candidates, candidates_in
from agents.perception.candidates.followed import candidates_followed

__all__ = ["Candidates", "candidates_followed", "candidates_in", "length_in_common_px"]
