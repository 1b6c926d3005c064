"""While a thread is followed, one part of one image after the other is segmented, to see what following cannot."""
