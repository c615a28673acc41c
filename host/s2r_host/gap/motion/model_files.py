"""Files that a model names: found from wherever the patched model is written, or left out where they say nothing.

A comparison needs masses and joints. Meshes are shapes: where a body states its inertia, one that is not at hand costs
nothing but contacts.
"""

from __future__ import annotations

from pathlib import Path

import mujoco

PACKAGE = "package://"  # of ROS: a name that a workspace resolves, then a path


def find_files(spec: mujoco.MjSpec, path: Path) -> list[str]:
    """Let files be found from anywhere, and take away the meshes that are not there.

    Args:
        spec: As read from ``path``; changed in place.
        path: The model file. A package of ROS is looked for among the folders that it lies in.

    Returns:
        A sentence about what was taken away; none where every file is there.

    Raises:
        ValueError: A mesh is missing that gives a moving body its mass.
    """
    folder = path.resolve().parent
    spec.meshdir, spec.texturedir = str(folder / spec.meshdir), str(folder / spec.texturedir)
    lost: dict[str, str] = {}
    for mesh in list(spec.meshes):
        if not mesh.file:
            continue
        found = _found(spec, mesh.file, folder)
        if found is None:
            lost[mesh.name or Path(mesh.file).stem] = mesh.file
            spec.delete(mesh)
        elif mesh.file.startswith(PACKAGE):
            mesh.file = str(found)
    if not lost:
        return []
    for body in spec.bodies:
        for geom in [geom for geom in body.geoms if geom.meshname in lost]:
            if _weighs(spec, body):
                raise ValueError(
                    f"body '{body.name}' states no inertia of its own, and the mesh that would give it one, "
                    f"'{lost[geom.meshname]}', is not found"
                )
            spec.delete(geom)
    return [
        f"model '{path.name}': {len(lost)} mesh file(s) are not found and left out ({', '.join(lost.values())}); "
        "contacts aside nothing depends on them"
    ]


def _found(spec: mujoco.MjSpec, file: str, folder: Path) -> Path | None:
    """Where a mesh is; None where it is not."""
    if not file.startswith(PACKAGE):
        places = [Path(spec.meshdir) / (Path(file).name if spec.strippath else file)]
    else:
        package, _, rest = file.removeprefix(PACKAGE).partition("/")
        places = [at / rest for at in (folder, *folder.parents) if at.name == package]
        places += [at / package / rest for at in (folder, *folder.parents)]
    return next((place for place in places if place.is_file()), None)


def _weighs(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> bool:
    """Whether the shapes of a body give it its mass, and a joint moves it."""
    from_shapes = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    if body.explicitinertial and spec.compiler.inertiafromgeom != from_shapes:
        return False
    above: mujoco.MjsBody | None = body
    while above is not None:
        if above.joints:
            return True
        above = above.parent
    return False
