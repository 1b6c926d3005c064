"""What each host of a rig needs, derived from the rig's one file: certificates, units, containers, configuration."""
