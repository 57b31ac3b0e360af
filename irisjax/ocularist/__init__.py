"""A prosthetic iris as an ocularist paints it: thin coats of paint on stacked cones  [L03]."""
