"""The training loop: it learns, resumes to the bit, survives SIGKILL and losses of NaN."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch
import toy_training
from torch import Tensor, nn
from toy_training import SCHEDULE, Line

from totalediting.errors import InputError
from totalediting.training import checkpoints, loop
from totalediting.training.loop import learning_rate, paced, train
from totalediting.training.stage import Loss

FACTS = {"data": "line"}
SCRIPT = Path(toy_training.__file__)


def losses(run: Path) -> list[tuple[int, float]]:
    lines = [json.loads(line) for line in (run / "losses.jsonl").read_text().splitlines()]
    return [(line["step"], line["loss"]) for line in lines]


def weights(run: Path) -> dict[str, torch.Tensor]:
    found = checkpoints.latest(run)
    assert found is not None and found.step == SCHEDULE.steps
    return found.model


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory) -> Path:
    run = tmp_path_factory.mktemp("whole")
    train(Line(), run, SCHEDULE, 0, FACTS)
    return run


def test_it_learns(uninterrupted: Path) -> None:
    curve = [loss for _, loss in losses(uninterrupted)]
    assert len(curve) == SCHEDULE.steps
    assert sum(curve[-10:]) < 0.2 * sum(curve[:10])
    assert list((uninterrupted / "tensorboard").iterdir())


def test_a_step_by_itself_is_the_one_of_training(uninterrupted: Path) -> None:
    stage = Line()
    training = loop.Training(loop.launch(loop.Machine()), stage, SCHEDULE)
    parts: list[str] = []
    for (number, loss), batch in zip(
        losses(uninterrupted)[:3], stage.batches(0, 8, 0, 1), strict=False
    ):
        assert loop.step(training, batch, number, parts.append).loss == loss
    assert parts == 3 * ["forward", "backward", "update"]


def test_in_pieces_it_is_the_same_to_the_bit(uninterrupted: Path, tmp_path: Path) -> None:
    for _ in range(4):
        train(Line(), tmp_path, SCHEDULE, 0, FACTS, stop_after=17)
    assert losses(tmp_path) == losses(uninterrupted)
    for name, value in weights(uninterrupted).items():
        assert torch.equal(value, weights(tmp_path)[name])


def test_killed_at_any_step_it_goes_on_as_if_nothing_had_been(
    uninterrupted: Path, tmp_path: Path
) -> None:
    for killed, code in ((33, -9), (-1, 0)):
        command = [sys.executable, str(SCRIPT), str(tmp_path), "1", str(killed)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == code, done.stderr
    assert losses(tmp_path) == losses(uninterrupted)
    for name, value in weights(uninterrupted).items():
        assert torch.equal(value, weights(tmp_path)[name])


def test_two_processes_train_one_network(tmp_path: Path) -> None:
    command = [sys.executable, str(SCRIPT), str(tmp_path), "2", "-1"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr
    curve = [loss for _, loss in losses(tmp_path)]
    assert len(curve) == SCHEDULE.steps
    assert sum(curve[-10:]) < 0.2 * sum(curve[:10])


def test_a_step_whose_loss_is_nan_changes_nothing(tmp_path: Path) -> None:
    stage = Line(broken=range(5))
    before = {name: value.clone() for name, value in stage.network.state_dict().items()}
    train(stage, tmp_path, SCHEDULE, 0, FACTS, stop_after=5)
    for name, value in stage.network.state_dict().items():
        assert torch.equal(before[name], value)


def test_a_loss_that_stays_nan_ends_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"NaN or infinite for 20 consecutive steps, at step 4\d"
    ) as error:
        train(Line(broken=range(25, 99)), tmp_path, SCHEDULE, 0, FACTS)
    assert "\n" not in str(error.value)
    assert checkpoints.latest(tmp_path).step == 40  # pyright: ignore[reportOptionalMemberAccess]


def test_another_seed_or_preset_in_the_folder_is_refused(tmp_path: Path) -> None:
    train(Line(), tmp_path, SCHEDULE, 0, FACTS, stop_after=1)
    with pytest.raises(InputError, match="trained with seed = 0, not 1"):
        train(Line(), tmp_path, SCHEDULE, 1, FACTS)


def test_the_average_is_what_is_validated(uninterrupted: Path) -> None:
    found = checkpoints.latest(uninterrupted)
    assert found is not None
    stage = Line()
    stage.network.load_state_dict(found.average)
    with torch.no_grad():
        error = stage.validate(stage.network.eval()).score
    assert error == found.facts["figures"]["error"]


def test_the_learning_rate_rises_and_falls() -> None:
    rates = [learning_rate(SCHEDULE, step) for step in range(SCHEDULE.steps)]
    assert rates[0] == pytest.approx(0.01)
    assert max(rates) == rates[SCHEDULE.warmup] == pytest.approx(0.05)
    assert rates[-1] < 0.1 * rates[SCHEDULE.warmup]


def test_a_module_sets_its_own_pace() -> None:
    """Adam's first step is the learning rate, whatever the gradient."""
    fast, slow = torch.nn.Linear(2, 1), torch.nn.Linear(1, 1)
    fast.pace = 5.0  # pyright: ignore[reportArgumentType]
    network = torch.nn.Sequential(fast, slow)
    before = [p.clone() for p in network.parameters()]
    optimiser = torch.optim.Adam(paced(network), 1e-3)
    for group in optimiser.param_groups:
        group["lr"] *= group["pace"]
    network(torch.ones(1, 2)).sum().backward()
    optimiser.step()
    moved = [
        float((p - q).detach().abs().max())
        for p, q in zip(network.parameters(), before, strict=True)
    ]
    assert moved == pytest.approx([5e-3, 5e-3, 1e-3, 1e-3], rel=1e-3)


def test_adversaries_are_clipped_each_by_its_own_norm() -> None:
    """A critic's steep step must not shrink the generator's."""

    class Two(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.made, self.critic = nn.Parameter(torch.zeros(2)), nn.Parameter(torch.zeros(2))

        @property
        def clipped(self) -> list[nn.Module]:
            return [nn.ParameterList([self.made]), nn.ParameterList([self.critic])]

    two = Two()

    class Both(Line):
        def __init__(self) -> None:
            super().__init__()
            self.network = two  # pyright: ignore[reportAttributeAccessIssue]

        def loss(self, network: nn.Module, batch: Tensor, step: int) -> Loss:
            return two.made.sum() + 1000 * two.critic.sum(), {}

    training = loop.Training(loop.launch(loop.Machine()), Both(), SCHEDULE)
    made = loop.step(training, torch.zeros(1), 0)
    assert made.gradient == pytest.approx(1000 * 2**0.5)
    for parameter in (two.made, two.critic):
        assert parameter.grad is not None
        assert float(parameter.grad.norm()) == pytest.approx(1.0, rel=1e-4)
