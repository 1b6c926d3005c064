"""Method `refined`: sub-pixel curves of both images, aligned along the rows, and one spline fitted to both."""
