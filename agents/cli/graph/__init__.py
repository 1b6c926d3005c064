"""`suturegrasp graph`: who says what to whom."""
