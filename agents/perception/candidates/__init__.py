"""Several threads: which pieces of the middle belong together, how sure each thread is, and which one is meant."""

from agents.perception.candidates.candidates import Candidates, candidates_in
from agents.perception.candidates.followed import candidates_followed
from agents.perception.candidates.in_common import in_common
from agents.perception.candidates.one_eye import seen_by_both
from agents.perception.candidates.printed import without_printed

__all__ = ["Candidates", "candidates_followed", "candidates_in", "in_common", "seen_by_both", "without_printed"]
