"""What both eyes' centrelines tell together."""
