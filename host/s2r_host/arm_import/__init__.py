"""From the URDF of an arm to a first ``arm.yaml``."""

from s2r_host.arm_import.convert import Imported, Wishes, import_arm
from s2r_host.arm_import.home import with_home
from s2r_host.arm_import.text import to_yaml

__all__ = ["Imported", "Wishes", "import_arm", "to_yaml", "with_home"]
