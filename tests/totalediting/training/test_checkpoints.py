"""Checkpoints: round trips, old ones dropped, damage and full disks survived, nothing unpickled."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from totalediting.errors import InputError
from totalediting.training import checkpoints
from totalediting.training.checkpoints import Checkpoint


def checkpoint(step: int) -> Checkpoint:
    values = {"layer.weight": torch.full((2, 3), float(step)), "layer.count": torch.tensor(step)}
    return Checkpoint(values, {"a": torch.rand(4)}, {"0/step": torch.tensor(1.0)}, {"step": step})


def test_what_is_saved_is_read(tmp_path: Path) -> None:
    stored = checkpoint(7)
    path = checkpoints.save(tmp_path, stored, is_best=False)
    found = checkpoints.read(path)
    assert found.step == 7
    for name in ("model", "average", "state"):
        for key, value in getattr(stored, name).items():
            assert torch.equal(getattr(found, name)[key], value)
    assert {p.suffix for p in path.iterdir()} == {".safetensors", ".json"}


def test_the_last_and_the_best_are_kept(tmp_path: Path) -> None:
    assert checkpoints.latest(tmp_path) is None
    for step in range(6):
        checkpoints.save(tmp_path, checkpoint(step), is_best=step == 1)
    kept = sorted(int(p.name) for p in (tmp_path / "checkpoints").iterdir())
    assert kept == [1, 4, 5]
    assert checkpoints.latest(tmp_path).step == 5  # pyright: ignore[reportOptionalMemberAccess]
    assert checkpoints.best(tmp_path).step == 1


@pytest.mark.parametrize("damage", ["truncated", "missing", "no JSON"])
def test_a_damaged_checkpoint_is_passed_over(tmp_path: Path, damage: str) -> None:
    checkpoints.save(tmp_path, checkpoint(1), is_best=False)
    path = checkpoints.save(tmp_path, checkpoint(2), is_best=False)
    if damage == "truncated":
        content = (path / "model.safetensors").read_bytes()
        (path / "model.safetensors").write_bytes(content[:-5])
    elif damage == "missing":
        (path / "state.safetensors").unlink()
    else:
        (path / "facts.json").write_text("{")
    with pytest.raises(InputError, match="incomplete or corrupt checkpoint"):
        checkpoints.read(path)
    assert checkpoints.latest(tmp_path).step == 1  # pyright: ignore[reportOptionalMemberAccess]


def test_a_full_disk_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checkpoints.save(tmp_path, checkpoint(1), is_best=True)

    def full(tensors, path) -> None:
        Path(path).write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoints, "save_file", full)
    with pytest.raises(
        InputError, match=r"step 2 cannot be saved .*No space.*step 1 is intact"
    ) as e:
        checkpoints.save(tmp_path, checkpoint(2), is_best=True)
    assert "\n" not in str(e.value)
    assert [p.name for p in (tmp_path / "checkpoints").iterdir()] == ["00000001"]
    assert checkpoints.best(tmp_path).step == 1


def test_what_killed_saves_left_is_removed_by_the_next(tmp_path: Path) -> None:
    checkpoints.save(tmp_path, checkpoint(1), is_best=True)
    left = tmp_path / "checkpoints" / ".00000002.12345"
    left.mkdir()
    (left / "model.safetensors").write_bytes(b"half")
    (tmp_path / ".best.json.12345.tmp").touch()
    checkpoints.save(tmp_path, checkpoint(2), is_best=False)
    assert sorted(p.name for p in (tmp_path / "checkpoints").iterdir()) == ["00000001", "00000002"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["best.json", "checkpoints"]


def test_pickles_are_never_loaded(tmp_path: Path) -> None:
    path = checkpoints.save(tmp_path, checkpoint(1), is_best=False)
    torch.save({"x": Path}, path / "model.safetensors")
    with pytest.raises(InputError):
        checkpoints.read(path)


def test_another_run_in_the_folder_is_refused(tmp_path: Path) -> None:
    config = {"stage": "lightmaps", "preset": "tiny", "seed": 0}
    checkpoints.configure(tmp_path / "run", config)
    checkpoints.configure(tmp_path / "run", config)
    with pytest.raises(InputError, match="trained with preset = tiny, not small"):
        checkpoints.configure(tmp_path / "run", config | {"preset": "small"})


def test_no_model_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no trained model"):
        checkpoints.best(tmp_path)


def test_an_optimiser_goes_on_where_it_was() -> None:
    def made() -> tuple[torch.nn.Linear, torch.optim.Optimizer]:
        torch.manual_seed(0)
        layer = torch.nn.Linear(3, 2)
        return layer, torch.optim.AdamW(layer.parameters(), 0.1)

    def step(layer: torch.nn.Linear, optimiser: torch.optim.Optimizer) -> None:
        optimiser.zero_grad()
        layer(torch.ones(1, 3)).square().sum().backward()
        optimiser.step()

    layer, optimiser = made()
    step(layer, optimiser)
    tensors = {k: v.clone() for k, v in checkpoints.optimiser_tensors(optimiser).items()}
    other, fresh = made()
    other.load_state_dict({k: v.clone() for k, v in layer.state_dict().items()})
    checkpoints.restore_optimiser(fresh, tensors)
    step(layer, optimiser)
    step(other, fresh)
    assert torch.equal(layer.weight, other.weight)


def test_weights_of_another_network_are_refused_in_one_line(tmp_path: Path) -> None:
    checkpoints.configure(tmp_path, {"preset": "tiny", "set": ["decoder=plain"]})
    layer = torch.nn.Linear(2, 2)
    stored = Checkpoint({}, layer.state_dict(), {}, {"step": 1})
    checkpoints.save(tmp_path, stored, is_best=True)
    other = torch.nn.Linear(2, 2)
    checkpoints.load_best(tmp_path, other)
    assert torch.equal(other.weight, layer.weight)
    with pytest.raises(InputError, match="preset = tiny, decoder=plain"):
        checkpoints.load_best(tmp_path, torch.nn.Linear(3, 2))


def test_figures_of_an_older_checkpoint_have_todays_names(tmp_path: Path) -> None:
    old = {"PSNR": 24.0, "normal, mean °": 22.0, "head": 0.1, "of my own": 1.0}
    facts = {"step": 1, "figures": old, "lowest": -24.0, "best": True}
    checkpoints.save(tmp_path, Checkpoint({}, {}, {}, facts), is_best=True)
    assert checkpoints.best(tmp_path).facts["figures"] == {
        "psnr": 24.0,
        "normal_error": 22.0,
        "head_error": 0.1,
        "of my own": 1.0,
    }
