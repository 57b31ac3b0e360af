"""Floor 2: what the iris and the media before it are made of."""
