"""The command that shows what each pixel of an image is held to be."""
