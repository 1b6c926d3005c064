"""The paper's experiment in closed loop, simulated: what is tried, how a trial goes, what it all comes to."""
