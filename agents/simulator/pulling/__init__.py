"""A thread that is pulled through tissue: two elastic strands, and the friction of what lies between their holes."""
