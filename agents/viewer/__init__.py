"""The viewer agent: what a person sees, on Rerun and as a picture."""
