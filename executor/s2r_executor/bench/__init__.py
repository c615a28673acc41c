"""``s2r bench executor``: what the executor does on this machine, as ratios to what the machine can do at all."""
