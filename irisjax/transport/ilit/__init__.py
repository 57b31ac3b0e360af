"""The random process of [LB06], integrated, tabulated and sampled."""
