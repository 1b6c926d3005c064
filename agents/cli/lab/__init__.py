"""What a lab needs before a rig runs: deployment, emulated arms, rendered scenes."""
