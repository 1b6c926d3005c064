"""What is wrong with a stereo pair before any thread in it is trusted, question by question."""
