"""Procedural articulated objects with hidden parameters.

A new kind needs three things: a parameter set with a ``kind`` literal, a function that draws it and one that
adds it to a world. They meet in :mod:`s2r_sim.objects.catalogue`.
"""
