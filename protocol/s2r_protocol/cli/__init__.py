"""The ``s2r`` command: one lazy root over the commands of every installed part."""
