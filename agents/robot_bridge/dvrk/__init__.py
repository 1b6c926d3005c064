"""A PSM of a da Vinci research kit as a backend of the bridge."""
