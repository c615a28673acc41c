"""``s2r demo``: the whole loop on one machine, three real processes, then the truth is opened and scored."""
