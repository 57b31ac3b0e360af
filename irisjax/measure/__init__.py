"""Floor 4: virtual instruments."""
