"""A whole rig of several hosts on one machine: network namespaces, processes, and what may go wrong."""
