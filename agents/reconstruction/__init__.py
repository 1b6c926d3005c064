"""The reconstruction agent: from observations to a spline with confidence."""
