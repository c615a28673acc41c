"""``s2r gap``: where simulation and recordings part, which physics is missing, and what it is worth held out."""
