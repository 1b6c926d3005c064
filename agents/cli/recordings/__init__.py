"""The commands that make recordings and work on them."""
