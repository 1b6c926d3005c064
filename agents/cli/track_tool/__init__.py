"""`suturegrasp track-tool`: where a tool is in recorded images."""
