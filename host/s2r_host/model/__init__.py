"""Model construction: a joint estimate in, convex pieces, MJCF and URDF out. Start at `build.build_model`."""

from typing import TYPE_CHECKING

from s2r_host.late_names import late_names

if TYPE_CHECKING:
    from s2r_host.model.build import ObjectModel, build_model
    from s2r_host.model.errors import ModelError
else:
    __getattr__ = late_names(__name__, build=("ObjectModel", "build_model"), errors=("ModelError",))

__all__ = ["ModelError", "ObjectModel", "build_model"]
