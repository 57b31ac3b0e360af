"""Floor 3: the random process of ILIT, the solvers of it, and depth-resolved transport."""
