"""Floor 3: the random process of ILIT, the solvers that integrate or sample it, and depth-resolved transport."""
