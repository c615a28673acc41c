"""Model construction: a joint estimate in, convex pieces, MJCF and URDF out. Start at `build.build_model`."""

from s2r_host.model.build import ObjectModel, build_model
from s2r_host.model.errors import ModelError

__all__ = ["ModelError", "ObjectModel", "build_model"]
