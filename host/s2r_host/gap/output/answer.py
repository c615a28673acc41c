"""``gap.json``, ``model_patched.xml``, ``patch.py`` and ``predictions.parquet``."""

from __future__ import annotations

import json
import math
import time
from pathlib import Path

import mujoco
import numpy as np

from s2r_host.gap.motion.flat_bodies import WRITTEN, thickened
from s2r_host.gap.output.baselines import BASELINES, not_fitted
from s2r_host.gap.pipeline import Analysis, floor_json
from s2r_host.gap.simulation.forward import Errors, first_held
from s2r_host.gap.simulation.generic import forms
from s2r_host.gap.simulation.replay import HARD_SOLIMP, HARD_SOLREF, Twin
from s2r_host.gap.verdict.rejected import without_answered
from s2r_protocol.whole_file import write_whole

SCHEMA = 1
ANSWER_FILES = (
    "gap.json",
    "report.html",
    "model_patched.xml",
    "patch.py",
    "predictions.parquet",
    "next_experiment.csv",
    "next_experiment.mcap",
)
FITS = ("train", "holdout", "open_loop_holdout")
RUNNING = "gap.json.part"  # from when files of a run are written until its answer is whole
PATCH_TEXT = '''"""What `s2r gap` found and stock MuJoCo has no attribute for: effects, or a correction without a name.

    import mujoco, patch
    model = mujoco.MjModel.from_xml_path("model_patched.xml")
    off = patch.install(model)     # forces appear in qfrc_passive from now on
    off()                          # the stock model again, and others can be loaded: MuJoCo loads none meanwhile

Where the zero of a recorded effort is off, that is in the drive or its sensor and in no model: to reproduce
predictions.parquet take `effort_offset` of gap.json (fit, per_joint) off the effort before it acts.
"""

try:
    from s2r_host.gap.simulation.live import install_terms
except ImportError as error:
    raise ImportError("patch.py needs the equations of the effects: install the sim2real2 package") from error

JOINTS = {joints}
TERMS = {terms}


def install(model):
    """Switch the effects on; returns the off switch."""
    return install_terms(model, TERMS, JOINTS)
'''


def make_answer(a: Analysis, seed: int) -> dict:
    """The contract's JSON."""
    together = a.decision is not None and len(a.decision.effects) > 1
    effects = [e.as_json(together) for e in a.decision.effects] if a.decision else []
    off = a.decision.parameters_off if a.decision else []
    if a.verdict in ("insufficient", "nothing_missing"):  # whoever reads a number there takes it over
        effects, off = [], []
    rejected = without_answered(a.decision.rejected, effects, _with_joints(off, a)) if a.decision else []
    answer = clean(
        {
            "schema": SCHEMA,
            "seed": seed,
            "wall_s": round(time.monotonic() - a.started, 2),
            "verdict": a.verdict,
            "floor": floor_json(a),
            "where": [p.as_json() for p in a.places],
            "effects": effects,
            "parameters_off": off,
            "rejected": rejected,
            "fit": fit_json(a),
            "baselines": {name: a.baselines.get(name, not_fitted("not asked for")) for name in BASELINES}
            | a.baselines,
            "next_experiment": a.next_experiment,
            "notes": a.notes + (a.decision.reasons if a.decision else []),
        }
    )
    assert isinstance(answer, dict)
    return answer


def _with_joints(off: list[dict], a: Analysis) -> list[dict]:
    """Numbers that are off, those of bodies with the joint that moves them."""

    def joint(body: str) -> str:
        bodies = range(1, a.model.model.nbody)
        return a.model.joint_that_moves(next(b for b in bodies if a.model.body_name(b) == body))

    return [p if "joint" in p else p | {"joint": joint(p["body"])} for p in off]


def stamped(answer: dict, a: Analysis) -> dict:
    """The answer with the seconds that the run took up to here, baselines, next experiment and report included."""
    return answer | {"wall_s": round(time.monotonic() - a.started, 2)}


def fit_json(a: Analysis) -> dict:
    """Position errors before and after; the closed loop when the law is known, else open-loop windows.

    The keys are always there: None where nothing was simulated, or nothing could be compared.
    """
    units = sorted({a.model.unit(j) for j in a.model.joints})
    found: dict = {"unit": units[0] if len(units) == 1 else "rad or m, per joint"}
    found |= dict.fromkeys(f"{kind}_{when}" for kind in FITS for when in ("before", "after")) | {
        "per_joint": {}
    }
    if a.before is None or a.after is None:
        return found
    closed = bool(np.any(np.isfinite(a.before.held)))
    for key, closed_key, open_key in (("train", "train", "open_train"), ("holdout", "held", "open_held")):
        use = closed_key if closed else open_key
        found[f"{key}_before"] = rms(getattr(a.before, use), a)
        found[f"{key}_after"] = rms(getattr(a.after, use), a)
    found["open_loop_holdout_before"] = rms(a.before.open_held, a)
    found["open_loop_holdout_after"] = rms(a.after.open_held, a)
    found["closed_loop"] = closed
    if a.decision is not None:
        s = a.decision.solution
        found["effort_holdout_before"], found["effort_holdout_after"] = (
            math.sqrt(s.raw_held[0]),
            math.sqrt(s.raw_held[1]),
        )
    found["per_joint"] = {
        joint: {
            "holdout_before": float(a.before.held[i] if closed else a.before.open_held[i]),
            "holdout_after": float(a.after.held[i] if closed else a.after.open_held[i]),
            "open_loop_holdout_before": float(a.before.open_held[i]),
            "open_loop_holdout_after": float(a.after.open_held[i]),
            "effort_offset": float(a.twin.offset[i]) if a.twin is not None else 0.0,
        }
        for i, joint in enumerate(a.model.joints)
    }
    return found


def rms(values: np.ndarray, a: Analysis) -> float:
    """Root mean square over the joints that were compared."""
    joints = a.problem.joints if a.problem is not None else range(len(a.model.joints))
    return float(np.sqrt(np.mean(values[list(joints)] ** 2))) if len(values) else float("nan")


def clean(x: object) -> object:
    """Numbers JSON can hold: no numpy scalars, no infinities."""
    if isinstance(x, dict):
        return {str(k): clean(v) for k, v in x.items()}
    if isinstance(x, list | tuple):
        return [clean(v) for v in x]
    if isinstance(x, bool | np.bool_):
        return bool(x)
    if isinstance(x, int | np.integer):
        return int(x)
    if isinstance(x, float | np.floating):
        return float(x) if math.isfinite(float(x)) else None
    return x


def write_answer(answer: dict, folder: Path) -> None:
    """Write ``gap.json``, whole or not at all, after everything else: where it stands, the run was finished."""
    part = folder / RUNNING
    part.write_text(json.dumps(answer, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    part.replace(folder / "gap.json")


def forget_answer(folder: Path) -> None:
    """Take away what an earlier run left in a folder: its model or its next experiment is no part of a new answer."""
    for name in ANSWER_FILES:
        (folder / name).unlink(missing_ok=True)
    (folder / RUNNING).touch()


def write_outputs(a: Analysis, folder: Path) -> None:
    """Write everything but the report and the answer."""
    folder.mkdir(parents=True, exist_ok=True)
    if a.twin is not None:
        write_model(a.twin, folder)
    if a.after is not None and a.before is not None:
        write_predictions(a.before, a.after, a, folder / "predictions.parquet")


def write_model(twin: Twin, folder: Path) -> None:
    """The patched model, loadable by stock MuJoCo, and the callback module where it needs one."""
    survive_rounding(twin)
    harden_friction(twin)
    path = folder / "model_patched.xml"
    write_whole(path, twin.spec.to_xml())
    mujoco.MjModel.from_xml_path(str(path))
    step, effects = float(twin.model.opt.timestep), forms()
    terms = [
        {
            "effect": t.effect,
            "joint": t.joint,
            "shape": {k: float(v) for k, v in t.shape.items()},
            "theta": [float(x) for x in t.theta],
            "given": effects[t.effect].given(twin.ctx, t.joint, t.shape),
        }
        for t in twin.live
        if effects[t.effect].runtime(twin.ctx, t.joint, t.shape, t.theta, step) is not None
    ]
    if not terms:
        return
    joints = json.dumps(list(twin.rigid.joints))
    text = PATCH_TEXT.replace("{joints}", joints).replace("{terms}", json.dumps(terms, indent=4))
    write_whole(folder / "patch.py", text)


def harden_friction(twin: Twin) -> None:
    """Write dry friction as hard as it was simulated: MuJoCo's default creeps, by milliradians within seconds."""
    live = {t.joint for t in twin.live}
    for j, name in enumerate(twin.rigid.joints):
        joint = twin.spec.joint(name)
        if (joint.frictionloss > 0.0 or j in live) and all(s.lead[j] == 0.0 for s in twin.ctx.sessions):
            joint.solref_friction, joint.solimp_friction = HARD_SOLREF, HARD_SOLIMP


def survive_rounding(twin: Twin) -> None:
    """Compile the patched model and thicken what is flat or thin in it, as MuJoCo writes six digits."""
    compiled = twin.spec.compile()
    for i in range(1, compiled.nbody):
        moments = compiled.body_inertia[i]
        thick = thickened(moments, WRITTEN)
        if np.array_equal(thick, moments):
            continue
        body = twin.spec.body(compiled.body(i).name)
        body.mass, body.ipos, body.iquat = (
            compiled.body_mass[i],
            compiled.body_ipos[i],
            compiled.body_iquat[i],
        )
        body.inertia = thick
        body.explicitinertial, body.fullinertia = 1, np.full(6, np.nan)
    twin.spec.compile()


def write_predictions(before: Errors, after: Errors, a: Analysis, path: Path) -> None:
    """Held-out traces: recording, its own time, measured, before, after, closed or open loop, per joint."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns: dict[str, list] = {"recording": [], "t": [], "closed_loop": []}
    for joint in a.model.joints:
        for kind in ("q", "q_before", "q_after", "tau", "tau_before", "tau_after"):
            columns[f"{kind}.{joint}"] = []
    for b, c in zip(before.traces, after.traces, strict=True):
        if not b.held and a.hold:
            continue
        s, stop = b.session, b.start + min(len(b.q), len(c.q))
        rows = slice(b.start if a.hold else max(b.start, first_held(s)), stop)
        made = slice(rows.start - b.start, stop - b.start)
        n = rows.stop - rows.start
        columns["recording"] += [s.rec.name] * n
        columns["t"] += (s.rec.start_s + s.t[rows]).tolist()
        columns["closed_loop"] += [b.closed] * n
        for i, joint in enumerate(a.model.joints):
            columns[f"q.{joint}"] += s.q_raw[rows, i].tolist()
            columns[f"q_before.{joint}"] += b.q[made, i].tolist()
            columns[f"q_after.{joint}"] += c.q[made, i].tolist()
            columns[f"tau.{joint}"] += s.u[rows, i].tolist()
            columns[f"tau_before.{joint}"] += b.u[made, i].tolist()
            columns[f"tau_after.{joint}"] += c.u[made, i].tolist()
    pq.write_table(pa.table(columns), path)
