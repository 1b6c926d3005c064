"""`suturegrasp page`: the operator's page."""
