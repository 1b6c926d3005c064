"""Where an arm's instrument is in the images, as a correction of where its joints and the registration have it."""
