"""Checkpoints of a training run: whole, or the one before, whole."""

from __future__ import annotations

import json
import logging

import pytest

torch = pytest.importorskip("torch", reason="needs the extra 'learn'")
pytest.importorskip("safetensors", reason="needs the extra 'learn'")

from s2r_host.learn import checkpoint  # noqa: E402
from s2r_host.perception.errors import InputError  # noqa: E402

SETTINGS = {"epochs": 3, "batch": 8, "rate": 1e-3, "seed": 0, "device": "cpu"}
DIGEST, CHECK_DIGEST = "d1" * 32, "c1" * 32


class Run:
    """A network of one weight, its average and optimiser, after some epochs."""

    def __init__(self, epoch=0):
        self.network, self.average = torch.nn.Linear(1, 1), torch.nn.Linear(1, 1)
        self.optimiser = torch.optim.AdamW(self.network.parameters())
        for _ in range(epoch):
            self.network(torch.ones(1)).backward()
            self.optimiser.step()
        for parameter in self.average.parameters():
            torch.nn.init.constant_(parameter, float(epoch))
        self.epoch = epoch

    def save(self, folder):
        state = {"epoch": self.epoch, "settings": SETTINGS, "metrics": []}
        parts = (self.network, self.average, self.optimiser)
        checkpoint.save(folder, *parts, state, DIGEST, CHECK_DIGEST)

    def resume(self, folder, validation=CHECK_DIGEST, **changed):
        parts = (self.network, self.average, self.optimiser)
        return checkpoint.resume(folder, *parts, SETTINGS | changed, DIGEST, validation)


def test_a_run_goes_on_where_it_was(tmp_path):
    first, again = Run(2), Run()
    first.save(tmp_path)
    state = again.resume(tmp_path)
    assert state["epoch"] == 2
    for one, other in ((first.network, again.network), (first.average, again.average)):
        assert all(torch.equal(a, b) for a, b in zip(one.parameters(), other.parameters(), strict=True))
    assert again.optimiser.state_dict()["state"][0]["step"] == 2


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"batch": 16}, "batch 8, here 16"),
        ({"rate": 2e-3, "seed": 1}, "rate 0.001, here 0.002; seed 0, here 1"),
        ({"epochs": 9}, "epochs 3, here 9"),
    ],
    ids=["batch", "two", "epochs"],
)
def test_changed_settings_are_refused_by_name(tmp_path, changed, said):
    Run(1).save(tmp_path)
    with pytest.raises(InputError, match=said):
        Run().resume(tmp_path, **changed)


def test_other_validation_data_is_refused_with_what_to_do(tmp_path):
    Run(1).save(tmp_path)
    with pytest.raises(
        InputError, match=r"other validation data .*give the same ones with --data, or name a new"
    ):
        Run().resume(tmp_path, validation="c2" * 32)


def test_a_run_of_before_validation_data_was_hashed_goes_on_and_says_so_once(tmp_path, monkeypatch, caplog):
    save_file = checkpoint.save_file

    def unhashed(tensors, path, metadata):
        if state := json.loads(metadata.get("state", "{}")):
            metadata = {"state": json.dumps({k: v for k, v in state.items() if k != "validation_sha256"})}
        save_file(tensors, path, metadata=metadata)

    with monkeypatch.context() as patched:
        patched.setattr(checkpoint, "save_file", unhashed)
        Run(1).save(tmp_path)
    run = Run()
    with caplog.at_level(logging.WARNING):
        assert run.resume(tmp_path)["epoch"] == 1
        run.save(tmp_path)
        Run().resume(tmp_path)
    assert len(caplog.messages) == 1
    assert "validation data it was measured on so far (to epoch 1)" in caplog.text


def test_another_device_goes_on_and_is_noted(tmp_path):
    Run(1).save(tmp_path)
    assert Run().resume(tmp_path, device="cuda")["settings"]["device"] == "cuda"


def test_a_kill_while_a_checkpoint_is_written_leaves_the_one_before(tmp_path, monkeypatch):
    Run(1).save(tmp_path)
    save_file = checkpoint.save_file
    for name, epoch in ((checkpoint.CHECKPOINT, 1), (checkpoint.WEIGHTS, 2)):  # the latter is a copy

        def killed(tensors, path, metadata=None, name=name):
            save_file(tensors, path, metadata=metadata)
            if path.name.startswith(name):
                raise KeyboardInterrupt

        with monkeypatch.context() as patched:
            patched.setattr(checkpoint, "save_file", killed)
            with pytest.raises(KeyboardInterrupt):
                Run(2).save(tmp_path)
        run = Run()
        assert run.resume(tmp_path)["epoch"] == epoch
        assert float(run.average.weight) == epoch
        assert json.loads((tmp_path / "state.json").read_text())["epoch"] == epoch


def test_a_run_of_an_earlier_version_is_not_overwritten(tmp_path):
    (tmp_path / "state.json").write_text("{}")
    with pytest.raises(InputError, match="earlier version"):
        Run().resume(tmp_path)
