"""Move one joint by 0.2 rad on a stand-in and say how well it followed."""

import tempfile
from pathlib import Path

import numpy as np

from s2r_host.recording import plan_track
from s2r_host.testing.cell import open_executor, stand_in_lab

with (
    tempfile.TemporaryDirectory() as folder,
    stand_in_lab(Path(folder), "xmate3pro") as lab,
    open_executor(lab) as arm,
):
    verdict = arm.start_by([0.2, 0, 0, 0, 0, 0, 0])
    arm.wait_done(verdict)
    recording = arm.recording(verdict.seq)
    measured, reference = (
        plan_track(recording, verdict.seq, f"joint_{kind}") for kind in ("states", "commands")
    )
    error = np.abs(measured.q - reference.q).max()
    print(
        f"{len(measured.t)} ticks over {measured.t[-1]:.2f} s, largest following error {1e3 * error:.2f} mrad"
    )
