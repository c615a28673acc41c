"""One concealed object: run, felt, asked; each step keeps its result and is done once."""

from __future__ import annotations

import json
from pathlib import Path

from gap_objects.feel import recordings, run_host
from gap_objects.hidden import draw
from gap_objects.score import Row
from s2r_host.run.physics import ask_gap
from s2r_protocol.exits import S2RError
from s2r_protocol.whole_file import write_whole
from s2r_sim.missing.score import told
from s2r_sim.world import load_world

NOTHING_TOLD: Row = {"effects": [], "parameters_off": [], "notes": [], "wall_s": 0.0}


def folder_of(out: Path, effect: str, index: int) -> Path:
    """What the gap tool gets of an object."""
    return out / "set" / f"{effect}-{index:02d}".replace(" ", "-")


def _sealed(out: Path, folder: Path) -> Path:
    return out / "sealed" / f"{folder.name}.json"


def of_another_seed(out: Path, effect: str, index: int, seed: int) -> Path | None:
    """The folder of an object if what was run there is not what this seed draws."""
    folder = folder_of(out, effect, index)
    sealed = _sealed(out, folder)
    if not sealed.is_file():
        return None
    kept, drawn = load_world(sealed), draw(effect, index, seed).world
    same = kept.to_json() == drawn.model_copy(update={"salt": kept.salt}).to_json()
    return None if same else folder


def felt(out: str, effect: str, index: int, seed: int, anew: bool) -> Row:
    """Fill an object's folder; without ``believed.xml`` where the arm felt nothing. Its truth is written elsewhere."""
    folder = folder_of(Path(out), effect, index)
    done = folder / "done"
    if anew or not done.is_file():
        trial = draw(effect, index, seed)
        sealed = _sealed(Path(out), folder)
        sealed.parent.mkdir(parents=True, exist_ok=True)
        trial.world.save(sealed)
        recordings(run_host(trial, Path(out) / "runs" / folder.name), folder)
        done.touch()
    return {}


def asked(out: str, effect: str, index: int, anew: bool) -> Row:
    """The gap tool's answer to an object's folder, of which it gets nothing else; from its file where that is there."""
    folder = folder_of(Path(out), effect, index)
    path = folder / "answer.json"
    if anew or not path.is_file():
        write_whole(path, json.dumps(_answer(folder), indent=1) + "\n")
    return json.loads(path.read_text(encoding="utf-8"))


def _answer(folder: Path) -> Row:
    believed = folder / "believed.xml"
    if not believed.is_file():
        return NOTHING_TOLD | {"verdict": "no recordings"}
    try:
        _, answer = ask_gap(believed, sorted((folder / "object-log").glob("*.csv")), 0)
    except S2RError as error:
        return NOTHING_TOLD | {"verdict": "refused", "notes": [str(error)]}
    return told(answer) | {"notes": answer["notes"], "wall_s": answer["wall_s"]}
