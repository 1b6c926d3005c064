"""The paper's experiment, and pulls, simulated in one process: what is tried, how a trial goes, what it comes to."""
