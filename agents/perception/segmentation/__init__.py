"""Which pixels are thread: one function an approach, all of the same signature."""
