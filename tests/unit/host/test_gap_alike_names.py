"""Files of one name in different folders are recordings, and sessions, of their own."""

from pathlib import Path

import pytest
import yaml

from s2r_host.gap.config import GapConfig
from s2r_host.gap.pipeline import analyse
from s2r_host.gap.recordings.names import distinct_names
from s2r_host.gap.rig import Drive, Secret, simulate, write_model, write_recording

QUICK = GapConfig(simulate=False, baselines=False, report=False, next_experiment=False)
DRIVE = Drive(duration_s=10.0)


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (["mon/run.csv"], ["run"]),
        (["mon/run.csv", "mon/rep.csv"], ["run", "rep"]),
        (["mon/run.csv", "tue/run.csv", "tue/rep.csv"], ["mon/run", "tue/run", "rep"]),
        (["a/mon/run.csv", "b/mon/run.csv", "tue/run.csv"], ["a/mon/run", "b/mon/run", "tue/run"]),
        (["mon/run.csv", "tue/../mon/run.csv"], ["run", "run"]),
        (["mon/run.csv", "mon/run.parquet"], ["run.csv", "run.parquet"]),
        (["mon/run.csv", "mon/run.parquet", "tue/run.csv"], ["run.csv", "run.parquet", "run"]),
    ],
)
def test_a_name_is_as_long_as_it_takes_to_tell_files_apart(tmp_path, paths, names):
    files = [Path(f"{tmp_path}/{path}") for path in paths]
    found = distinct_names(files)
    assert [found[file] for file in files] == names


def recorded(folder, name, friction, motion, noise):
    folder.mkdir(exist_ok=True)
    columns = {c: x[::4] for c, x in simulate(Secret(friction=friction), DRIVE, motion, noise).items()}
    path = write_recording(folder / f"{name}.csv", columns, DRIVE)
    side = yaml.safe_load(path.with_suffix(".yaml").read_text())
    del side["session"]
    path.with_suffix(".yaml").write_text(yaml.safe_dump(side))
    return path


def test_more_friction_on_another_day_is_told_whatever_the_files_are_called(tmp_path):
    fit = recorded(tmp_path / "mon", "run", 0.3, 0, 1)
    again = recorded(tmp_path / "mon", "rep", 0.3, 0, 2)
    held = recorded(tmp_path / "tue", "run", 0.45, 1, 3)
    found = analyse(write_model(tmp_path / "model.xml", 0.3), [fit], [held], [again], QUICK, lambda _: None)
    assert found.decision is not None
    assert [e.name for e in found.decision.effects] == ["session_friction"]
    assert found.decision.effects[0].parameters["factor"]["value"] == pytest.approx(1.4, abs=0.15)
    assert [s.rec.name for s in (found.fit[0], found.hold[0])] == ["mon/run", "tue/run"]
