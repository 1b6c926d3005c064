"""`suturegrasp evaluate`: the paper's experiment in closed loop."""
