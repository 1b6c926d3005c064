"""What a recorded session holds, in the terminal, on a page, and as tables for other programs."""
