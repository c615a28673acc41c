"""How far an arm's links stay from each other: one number for who describes, plans and admits."""

SHAPE_INFLATION_M = 0.005
"""By how much the executor makes every shape thicker before it checks a plan (``admission.collision_inflation_m``)."""

LINKS_APART_M = 2 * SHAPE_INFLATION_M
"""Two links of an arm are further apart than this in every plan that is admitted."""
