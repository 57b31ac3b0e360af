"""Floor 1: optics that knows nothing of eyes."""
