"""``s2r data``: simulated training data, made by resumable jobs."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from s2r_protocol.cli.options import UNUSED_FOLDER
from s2r_protocol.exits import UsageError


@click.group()
def data() -> None:
    """Make training data from procedural objects."""


@data.command()
@click.option("--kinds", default="chest,drawer,laptop,faucet,door,lid,dial", show_default=True)
@click.option(
    "--split", type=click.Choice(["train", "validation", "test"]), default="train", show_default=True
)
@click.option("--objects", default=40, show_default=True, help="Per kind.")
@click.option("--first", default=0, show_default=True, help="Number of the first object of every kind.")
@click.option("--pushes", default=64, show_default=True, help="Per object.")
@click.option("--jobs", default=1, show_default=True, help="Processes.")
@click.option(
    "--ray", metavar="ADDRESS", help="Run the jobs on this Ray cluster, 'local' for one on this machine."
)
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="Folder; an interrupted run goes on."
)
def pushes(
    kinds: str, split: str, objects: int, first: int, pushes: int, jobs: int, ray: str | None, out: Path
) -> None:
    """One noisy view per object, and what random pushes at it do."""
    from s2r_sim.batch import jobs_in, run_jobs
    from s2r_sim.objects.catalogue import kind_named
    from s2r_sim.objects.npz_whole import file_of_result_is_whole
    from s2r_sim.objects.push_data import push_object
    from s2r_sim.objects.splits import Split

    if min(objects, pushes, jobs) < 1:
        raise UsageError(f"--objects {objects}, --pushes {pushes}, --jobs {jobs}: each must be 1 or more")
    if first < 0:
        raise UsageError(f"--first {first} must be 0 or more")
    names = [name.strip() for name in kinds.split(",")]
    for name in names:
        kind_named(name)
    results = out / f"{split}.jsonl"
    others = {job[3] for job in jobs_in(results)} - {pushes}
    if others:  # an object has one file, however often it was pushed
        raise UsageError(
            f"{results} is of objects with {', '.join(map(str, sorted(others)))} pushes, not {pushes}: give another "
            "--out, or the same number to go on"
        )
    out.mkdir(parents=True, exist_ok=True)
    number = int(Split[split.upper()])
    todo = [(name, number, seed, pushes) for seed in range(first, first + objects) for name in names]
    work, whole = partial(push_object, folder=str(out)), partial(file_of_result_is_whole, folder=out)
    rows = run_jobs(work, todo, results, jobs, "objects", ray, still_there=whole)
    done, good = sum(row["pushes"] for row in rows), sum(row["useful"] for row in rows)
    click.echo(f"{len(rows)} objects, {done} pushes, {100 * good / max(done, 1):.1f} % useful, in {out}")


@data.command()
@click.option("--kinds", default="chest,laptop,faucet,door,lid,dial", show_default=True)
@click.option(
    "--split", type=click.Choice(["train", "validation", "test"]), default="train", show_default=True
)
@click.option("--objects", default=40, show_default=True, help="Per kind.")
@click.option("--jobs", default=1, show_default=True, help="Processes.")
@click.option(
    "--ray", metavar="ADDRESS", help="Run the jobs on this Ray cluster, 'local' for one on this machine."
)
@click.option(
    "--quick",
    is_flag=True,
    help="Draw the errors of the depth instead of matching images: a fifth of the time.",
)
@click.option("--first", default=0, show_default=True, help="Number of the first object of every kind.")
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="Folder; an interrupted run goes on."
)
def pairs(
    kinds: str, split: str, objects: int, jobs: int, ray: str | None, quick: bool, first: int, out: Path
) -> None:
    """Noisy views of objects before and after their part moved, for 's2r train model'."""
    from s2r_sim.batch import run_jobs
    from s2r_sim.objects.catalogue import kind_named
    from s2r_sim.objects.npz_whole import file_of_result_is_whole
    from s2r_sim.objects.pair_data import pair_object
    from s2r_sim.objects.splits import Split

    if min(objects, jobs) < 1:
        raise UsageError(f"--objects {objects}, --jobs {jobs}: each must be 1 or more")
    if first < 0:
        raise UsageError(f"--first {first} must be 0 or more")
    names = [name.strip() for name in kinds.split(",")]
    for name in names:
        kind_named(name)
    out.mkdir(parents=True, exist_ok=True)
    number = int(Split[split.upper()])
    todo = [(name, number, seed) for seed in range(first, first + objects) for name in names]
    work, whole = (
        partial(pair_object, folder=str(out), quick=quick),
        partial(file_of_result_is_whole, folder=out),
    )
    # Quick views and others may lie in one folder, each with a list of its own: training mixes them.
    results = out / f"{split}{'-quick' if quick else ''}.jsonl"
    rows = run_jobs(work, todo, results, jobs, "objects", ray, {"--quick": quick}, whole)
    click.echo(f"{len(rows)} objects, {sum(row['pairs'] for row in rows)} pairs, in {out}")


@data.command("import")
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option("--part", help="Name or meaning of the part that moves; needed if there are several.")
@click.option(
    "--height", default=0.3, show_default=True, help="Height on the table [m]; the object is scaled to it."
)
@click.option("--out", type=UNUSED_FOLDER, required=True, help="Folder of the result, new or empty.")
def import_(folder: Path, part: str | None, height: float, out: Path) -> None:
    """Put an object on the stand-in's table: scene.xml and object.json.

    FOLDER is of PartNet-Mobility, of Shape2Motion, or one with the URDF of an own object, z up, in meshes (.obj),
    boxes, cylinders and spheres.
    """
    from s2r_sim.objects.mobility_scene import MobilityPlace, write_mobility
    from s2r_sim.objects.sheets import THICKNESS_M

    if not 0.02 <= height <= 1.5:
        raise UsageError(f"--height {height} must lie between 0.02 and 1.5 m")
    made = write_mobility(folder, out, part, MobilityPlace(height_m=height))
    truth = made.joint
    if made.thickened:
        click.echo(
            f"flat, made {1e3 * THICKNESS_M:g} mm thick: {', '.join(made.thickened)} (link_number of its shape)"
        )
    if made.hulled:
        click.echo(
            f"bounding no solid, weighed as their convex hulls: {', '.join(made.hulled)} (link_number of its shape)"
        )
    click.echo(
        f"{truth.joint_type} joint, found at {truth.q_start:.3f}, goes from {truth.q_min:.3f} to {truth.q_max:.3f}; in"
        f" {out}"
    )
