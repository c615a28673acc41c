"""Which terms explain the residual: every candidate weighed on top of what is chosen, and how far to trust numbers."""
