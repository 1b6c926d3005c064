"""`suturegrasp experiment`: the paper's protocol on a real rig."""
