"""`totalediting train` on a small dataset: every stage learns, resumes and says what is wrong."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
import torch
from answer import Answer
from PIL import Image
from torch import nn

from assets_procedural.conventions import console
from synthgen.dataset import open_dataset
from totalediting import cli
from totalediting.data.clips import ClipPair
from totalediting.data.pairs import MIRRORED, PortraitPair, PortraitPairs
from totalediting.errors import InputError
from totalediting.geometry.field import Control
from totalediting.geometry.identity import faces_of
from totalediting.geometry.mirroring import MIRROR
from totalediting.networks.head_tracker import HeadTracker
from totalediting.presets import PRESETS, preset_with
from totalediting.pretrained import lpips, sface
from totalediting.pretrained.fetch import NetworkError
from totalediting.training import beside, checkpoints, loop, losses, showcase
from totalediting.training import joint as joint_stage
from totalediting.training.joint import JointStage, RealClips
from totalediting.training.lightmaps import LightmapStage
from totalediting.training.reconstruction import ReconstructStage, build, edit_of
from totalediting.training.stage import RealVideo, StageSettings
from totalediting.training.stages import STAGES, Schedule
from totalediting.training.tracker import TrackerStage

Run = Callable[..., Answer]


@pytest.fixture
def totalediting(run_main: Callable[..., Answer]) -> Run:
    return partial(run_main, cli.main)


def trained(run: Path, stage: str) -> list[dict[str, float]]:
    """What was logged of each step."""
    return [json.loads(line) for line in (run / stage / "losses.jsonl").read_text().splitlines()]


@pytest.mark.parametrize("stage", ["tracker", "lightmaps", "reconstruct"])
def test_a_stage_trains_and_resumes(
    totalediting: Run, small_dataset: Path, tmp_path: Path, stage: str
) -> None:
    arguments = ["train", stage, small_dataset, "--batch", 2, "--workers", 0]
    whole = totalediting(*arguments, "--out", tmp_path / "run", "--steps", 3)
    assert whole.returncode == 0, whole.stderr
    assert [line["step"] for line in trained(tmp_path / "run", stage)] == [0, 1, 2]
    assert (checkpoints.best_step(tmp_path / "run" / stage)) == 3
    again = totalediting(*arguments, "--out", tmp_path / "run", "--steps", 3)
    assert again.returncode == 0 and again.stdout.splitlines()[-1] in whole.stdout


@pytest.mark.parametrize("workers", [0, 1])
def test_a_resumed_stage_draws_what_it_would_have_drawn(
    small_dataset: Path, tmp_path: Path, workers: int
) -> None:
    """The data's iterator starts anew, which must not shift the random numbers of a step."""

    def train(run: Path, stop_after: int | None = None) -> None:
        torch.manual_seed(0)
        settings = StageSettings(small_dataset, PRESETS["tiny"], run, 4, workers=workers)
        stage = build(settings)
        stage.most = 1
        loop.train(stage, run, Schedule(4, 1), 0, {}, stop_after=stop_after)

    train(tmp_path / "whole")
    for _ in range(2):
        train(tmp_path / "parts", stop_after=2)
    whole, parts = (tmp_path / run / "losses.jsonl" for run in ("whole", "parts"))
    assert parts.read_text() == whole.read_text()


@pytest.mark.parametrize("kind", [TrackerStage, LightmapStage])
def test_a_single_batch_is_learnt_by_heart(small_dataset: Path, kind: type) -> None:
    torch.manual_seed(0)
    stage = kind(small_dataset, PRESETS["tiny"], seed=0, workers=0)
    batch = next(stage.batches(0, 2, 0, 1))
    optimiser = torch.optim.AdamW(stage.network.parameters(), 3e-4)
    curve = []
    for step in range(100):
        torch.manual_seed(0)
        loss, _ = stage.loss(stage.network, batch, step)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        curve.append(loss.item())
    assert min(curve) < 0.2 * curve[0]  # the last one hops about: nothing slows the steps down


def test_batches_follow_from_the_step_alone(small_dataset: Path) -> None:
    stage = LightmapStage(small_dataset, PRESETS["tiny"], seed=3, workers=0)
    running = stage.batches(0, 2, 0, 1)
    later = [next(running).image for _ in range(4)][-1]
    assert torch.equal(later, next(stage.batches(3, 2, 0, 1)).image)
    halves = [next(stage.batches(3, 1, rank, 2)).image for rank in range(2)]
    assert torch.equal(torch.cat(halves), later)


def test_reconstruction_counts_only_the_subject(small_dataset: Path) -> None:
    torch.manual_seed(0)
    stage = ReconstructStage(small_dataset, PRESETS["tiny"], seed=0, workers=0)
    batch = next(stage.batches(0, 1, 0, 1))

    def loss(batch) -> float:
        torch.manual_seed(1)
        return stage.loss(stage.network, batch, 0)[0].item()

    behind = batch.mot_image * (batch.alpha > 0) + (batch.alpha == 0) * 0.7
    assert loss(batch._replace(mot_image=behind)) == pytest.approx(loss(batch), abs=1e-6)
    other = batch._replace(mot_image=1 - batch.mot_image)
    assert abs(loss(other) - loss(batch)) > 1e-3


def test_the_mean_light_scores_one_against_itself(small_dataset: Path) -> None:
    stage = LightmapStage(small_dataset, PRESETS["tiny"], seed=0, workers=0)
    with torch.no_grad():
        found = stage.validate(stage.network.eval())
    assert found.score == found.figures["relative_light_error"] > 0
    assert found.pictures["light"].shape[0] == 3


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["tracker", "DATA", "--learning-rate", "0"], "--learning-rate: 0.0: give a number"),
        (["tracker", "DATA", "--device", "cuda"], "PyTorch finds no CUDA device here"),
        (["tracker", "nowhere"], "nowhere"),
        (["tracker", "DATA", "--batch", "3", "--devices", "2"], "give a multiple of the 2 devices"),
    ],
)
def test_bad_input_is_one_line(
    totalediting: Run, small_dataset: Path, tmp_path: Path, arguments: list[str], said: str
) -> None:
    if "cuda" in arguments and torch.cuda.is_available():
        pytest.skip("there is a GPU here")
    given = [str(small_dataset) if a == "DATA" else a for a in arguments]
    assert said in totalediting("train", *given, "--out", tmp_path / "run").error
    assert not (tmp_path / "run").exists()


def test_another_preset_in_the_folder_is_refused(
    totalediting: Run, small_dataset: Path, tmp_path: Path
) -> None:
    run = ["train", "tracker", small_dataset, "--out", tmp_path, "--batch", 2, "--workers", 0]
    assert totalediting(*run, "--steps", 1).returncode == 0
    assert (
        "was trained with preset = tiny, not small"
        in totalediting(*run, "--steps", 1, "--preset", "small").error
    )


@pytest.mark.parametrize(
    ("arguments", "option", "choices"),
    [
        (["speech", "DATA"], "STAGE", (*STAGES, "all")),
        (["tracker", "DATA", "--preset", "huge"], "--preset", tuple(PRESETS)),
        (["tracker", "DATA", "--precision", "8"], "--precision", ("32-true", "bf16-mixed", "auto")),
    ],
)
def test_another_choice_is_refused_and_the_choices_are_named(
    totalediting: Run, arguments: list[str], option: str, choices: tuple[str, ...]
) -> None:
    said = totalediting("train", *arguments, "--out", "RUN")
    assert said.returncode == 2 and option in said.stderr
    assert ", ".join(f"'{choice}'" for choice in choices) in " ".join(said.stderr.split())


def test_all_stages_in_order_and_the_joint_one_goes_on_from_them(
    totalediting: Run, small_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lpips, "fetch", _missing)
    monkeypatch.setattr(sface, "fetch", _missing)
    run = ["train", "all", small_dataset, "--out", tmp_path / "run", "--batch", 1]
    said = totalediting(*run, "--steps", 2, "--workers", 0)
    assert said.returncode == 0, said.stderr
    assert "joint: without lpips: lpips_alex: not here" in said.stderr
    assert "joint: without identity: sface: not here" in said.stderr
    assert "joint: PSNR" in said.stdout
    assert {p.name for p in (tmp_path / "run").iterdir()} == {*STAGES, "tables"}
    other = totalediting(*run, "--steps", 2, "--workers", 0, "--seed", 1)
    assert "seed = 0" in other.stderr
    alone = ["train", "joint", small_dataset, "--out", tmp_path / "other", "--batch", 1]
    assert "holds no trained model" in totalediting(*alone, "--workers", 0).error


def test_real_clips_are_trained_on_beside_synthetic_pairs(
    totalediting: Run, small_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lpips, "fetch", _missing)
    monkeypatch.setattr(sface, "fetch", _missing)
    for k in range(3):
        (tmp_path / "clips" / "one").mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (40, 30), (60 * k, 90, 120)).save(tmp_path / "clips/one" / f"{k}.png")
    run = [small_dataset, "--out", tmp_path / "run", "--batch", 1, "--workers", 0]
    for stage in STAGES["joint"].needs:
        assert totalediting("train", stage, *run, "--steps", 1).returncode == 0
    joint = ["train", "joint", *run, "--steps", 4, "--clips", tmp_path / "clips"]
    said = totalediting(*joint, "--real-light", "consistent")
    assert said.returncode == 0, said.stderr
    real = ["real_final" in line for line in trained(tmp_path / "run", "joint")]
    assert real == [False, True, False, True]
    lines = trained(tmp_path / "run", "joint")
    assert "real_lightmap" in lines[1] and "real_albedo" not in lines[1]
    assert "give the same" in totalediting(*joint, "--real-light", "same").stderr
    none = ["train", "joint", *run, "--steps", 1, "--clips", tmp_path / "run"]
    assert "no clip in it" in totalediting(*none).error
    half = ["train", "joint", *run, "--steps", 1, "--real-share", 2]
    assert "--real-share: 2.0: give a number from 0 to 1" in totalediting(*half).error


def test_a_real_face_is_compared_where_the_tracker_finds_it(
    small_dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """L_id of a clip: both pictures are aligned by the five points of the target."""
    asked = []

    class Likeness(nn.Module):
        def features(self, picture: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
            asked.append(points)
            return picture.mean((2, 3))

    monkeypatch.setattr(joint_stage, "Recognition", Likeness)
    monkeypatch.setattr(lpips, "fetch", _missing)
    torch.manual_seed(0)
    tiny, frame = PRESETS["tiny"], torch.rand(1, 3, 128, 128)
    tracker = HeadTracker(tiny).eval()
    real = RealClips(None, tracker, RealVideo(Path(), 1.0))  # pyright: ignore[reportArgumentType]
    weights = dataclasses.replace(losses.OURS, identity_from=0, tv=0.0)
    stage = JointStage(small_dataset, tiny, 0, 0, weights=weights, real=real)
    empty = torch.zeros(1, 3, 128, 128)
    matte, unknown = torch.ones(1, 1, 128, 128), torch.tensor([False])
    clip = ClipPair(frame, matte, frame.flip(-1), frame, matte, unknown, empty, ["clip"])  # pyright: ignore[reportArgumentType]
    loss, said = stage.loss(stage.network, clip, 0)
    assert said["real_identity"] > 0 and torch.isfinite(loss)
    wanted = tracker(clip.mot_image).points(128)
    assert len(asked) == 2 and all(torch.equal(points, wanted) for points in asked)


def test_real_steps_are_spread_evenly(small_dataset: Path) -> None:
    for share, wanted in ((0.0, 0), (0.25, 10), (0.5, 20), (1.0, 40)):
        real = RealClips(None, None, RealVideo(Path(), share))  # pyright: ignore[reportArgumentType]
        steps = [step for step in range(40) if real.at(step)]
        assert len(steps) == wanted == real.before(40)
        assert all(real.before(step) == k for k, step in enumerate(steps))


def test_switches_make_another_run(totalediting: Run, small_dataset: Path, tmp_path: Path) -> None:
    run = ["train", "reconstruct", small_dataset, "--batch", 1, "--workers", 0, "--steps", 1]
    plain = [*run, "--out", tmp_path / "plain", "--set", "decoder=plain"]
    assert totalediting(*plain).returncode == 0
    assert showcase.load_model(tmp_path / "plain").preset.decoder == "plain"
    surface = ["--set", "deformation=surface_field", "--set", "rotation=surface_field"]
    assert "set = ['decoder=plain']" in totalediting(*run, "--out", tmp_path / "plain").error
    assert (
        "--set: decoder=none: choose one of"
        in totalediting(*run, "--out", tmp_path, "--set", "decoder=none").error
    )
    assert preset_with("tiny", surface[1::2]).deformation == "surface_field"
    faces = faces_of(preset_with("tiny", surface[1::2]))
    assert faces is not None and faces.min() == 0 and faces.max() == 5464


def test_static_pairs_come_first(small_dataset: Path) -> None:
    stage = ReconstructStage(small_dataset, PRESETS["tiny"], seed=0, workers=0, static_steps=3)
    batches = stage.batches(0, 4, 0, 1)
    found = [next(batches) for _ in range(6)]
    same = [torch.equal(batch.app.code, batch.mot_code) for batch in found]
    assert same[:3] == [True] * 3 and not all(same[3:])
    for first in (1, 3, 5):
        again = next(stage.batches(first, 4, 0, 1))
        assert again.key == found[first].key and torch.equal(
            again.mot_image, found[first].mot_image
        )


def test_deformations_are_solved_once(
    small_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also across runs of the program: in half precision on disk, which every use gets."""

    def stage() -> tuple[ReconstructStage, list[int]]:
        made = ReconstructStage(small_dataset, PRESETS["tiny"], 0, 0, tables=tmp_path / "tables")
        asked, real = [], made.network.deformation
        solve = lambda c: (asked.append(len(c.posed)), real(c))[1]  # noqa: E731
        monkeypatch.setattr(made.network, "deformation", solve)
        return made, asked

    first, asked = stage()
    batch = next(first.batches(0, 2, 0, 1))
    turned = [key.endswith(MIRRORED) for key in batch.key]
    assert sorted(turned) == [False, True], "another seed is wanted"
    table, warp = first.tables(first.network, batch)
    again = first.tables(first.network, batch)
    assert asked == [1]  # all busts of the small dataset are the same, and at rest
    assert torch.equal(again[0].values, table.values) and torch.equal(again[1].values, warp.values)
    exact = first.network.deformation(batch.control)
    assert (table.values - exact.values)[:, :3].abs().max() < 1e-3
    back = first.network.deformation(batch.app.control.back())
    assert (warp.values - back.values)[:, :3].abs().max() < 1e-3
    # The other way round: what was mirrored is not, and what was not is.
    keys = [
        k.removesuffix(MIRRORED) if m else k + MIRRORED
        for k, m in zip(batch.key, turned, strict=True)
    ]
    control, source = (
        Control(*(MIRROR * a for a in c)) for c in (batch.control, batch.app.control)
    )
    other = batch._replace(key=keys, control=control, app=batch.app._replace(control=source))
    del asked[:]
    flipped, _ = first.tables(first.network, other)
    assert not asked and torch.equal(flipped.values, table.mirrored().values)

    later, asked = stage()
    kept = later.tables(later.network, batch)
    assert not asked and torch.equal(kept[0].values, table.values)
    for path in (tmp_path / "tables").rglob("*.npy"):
        path.write_bytes(b"damaged")
    third, asked = stage()
    again = third.tables(third.network, batch)
    assert asked == [1] and torch.equal(again.back.values, warp.values)


def test_every_joint_term_reaches_what_it_should(
    small_dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Adversaries descend on their own parameters; the estimator learns from the result."""
    monkeypatch.setattr(lpips, "fetch", _missing)
    monkeypatch.setattr(sface, "fetch", _missing)
    torch.manual_seed(0)
    weights = dataclasses.replace(losses.OURS, adversarial_from=0, tv=0.0, density_normal=0.0)
    stage = JointStage(small_dataset, PRESETS["tiny"], seed=0, workers=0, weights=weights)
    batch = next(stage.batches(0, 1, 0, 1))
    _, scalars = stage.loss(stage.network, batch, 16)
    assert {"final", "mask", "albedo", "normal", "lightmap", "adversarial", "critic"} <= set(
        scalars
    )

    critic = list(stage.network.discriminator.parameters())
    assert isinstance(batch, PortraitPair)
    edit = edit_of(stage.network.model, batch, None)
    fooled, own = stage._adversarial(edit, batch, 1)
    assert all(
        g is None for g in torch.autograd.grad(fooled, critic, allow_unused=True, retain_graph=True)
    )
    model = [p for p in stage.network.model.parameters() if p.requires_grad]
    assert any(
        g is not None
        for g in torch.autograd.grad(fooled, model, allow_unused=True, retain_graph=True)
    )
    assert all(
        g is None for g in torch.autograd.grad(own, model, allow_unused=True, retain_graph=True)
    )
    assert all(g is not None for g in torch.autograd.grad(own, critic, allow_unused=True))

    assert not any(p.requires_grad for p in stage.network.model.appearance.parameters())
    assert not any(p.requires_grad for p in stage.network.model.deenactor.parameters())
    assert all(p.requires_grad for p in stage.network.model.reenactor.parameters())
    free = JointStage(small_dataset, preset_with("tiny", ["freeze=none"]), 0, 0)
    assert all(p.requires_grad for p in free.network.model.parameters())

    final = dataclasses.replace(weights, **{name: 0.0 for name in losses.TERMS if name != "final"})
    stage.weights = final
    stage.loss(stage.network, batch, 1)[0].backward()
    assert any(p.grad is not None for p in stage.network.estimator.lobe.parameters())
    assert all(p.grad is None for p in stage.network.estimator.to_normal.parameters())


def test_the_papers_weights_are_a_switch(small_dataset: Path, tmp_path: Path) -> None:
    preset = preset_with("tiny", ["weights=paper"])
    stage = build(StageSettings(small_dataset, preset, tmp_path, 1000))
    assert stage.weights == losses.PAPER.over(1000) != losses.OURS.over(1000)
    joint = joint_stage.build(StageSettings(small_dataset, preset, tmp_path, 1000))
    assert joint.weights.adversarial_from == 0 and joint.weights.raw == 0


def test_a_driver_lends_no_identity(small_dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A real pair's bust has the source's identity, the driver's expression and pose."""
    asked = []
    monkeypatch.setattr(lpips, "fetch", _missing)
    monkeypatch.setattr(sface, "fetch", _missing)
    real_control = joint_stage.control_of
    monkeypatch.setattr(joint_stage, "control_of", lambda t: (asked.append(t), real_control(t))[1])
    torch.manual_seed(0)
    tiny, frame = PRESETS["tiny"], torch.rand(1, 3, 128, 128)
    tracker = HeadTracker(tiny).eval()
    with torch.no_grad():
        app, mot = tracker(frame), tracker(frame.flip(-1))
    real = RealClips(None, tracker, RealVideo(Path(), 1.0))  # pyright: ignore[reportArgumentType]
    stage = JointStage(small_dataset, tiny, 0, 0, real=real)
    matte, unknown = torch.ones(1, 1, 128, 128), torch.tensor([False])
    clip = ClipPair(frame, matte, frame.flip(-1), frame, matte, unknown, 0 * frame, ["clip"])  # pyright: ignore[reportArgumentType]
    stage.loss(stage.network, clip, 0)
    shown, source = asked
    assert torch.equal(shown.identity, app.identity) and not torch.equal(app.identity, mot.identity)
    assert torch.equal(shown.expression, mot.expression) and torch.equal(shown.head, mot.head)
    assert torch.equal(source.expression, app.expression)


def _missing(name: str, path: object = None) -> Path:
    raise NetworkError(f"{name}: not here")


def test_a_page_shows_as_many_people_as_it_can(small_dataset: Path) -> None:
    pairs = PortraitPairs(small_dataset, PRESETS["tiny"], "train")
    people = sorted(set(pairs.shots.subjects))
    for count in (2, 99):
        shown = [s.key.split("_")[0] for s in showcase.of_different_people(pairs, count)]
        assert len(shown) == len(set(shown)) == min(count, len(people))
    assert sorted(shown) == people


def test_a_trained_run_is_shown(
    totalediting: Run, small_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for stage in ("lightmaps", "reconstruct"):
        run = ["train", stage, small_dataset, "--out", tmp_path / "run", "--batch", 1]
        assert totalediting(*run, "--steps", 1, "--workers", 0).returncode == 0
    page = showcase.draw(tmp_path / "run", small_dataset, tmp_path / "page.png", 2, "train")
    with Image.open(page) as picture:
        assert picture.width > 11 * 128 and picture.height > 2 * 128
    monkeypatch.setattr(console, "FIRST_LINE", 0.0)
    figures = totalediting("evaluate", tmp_path / "run", small_dataset, "--split", "validation")
    assert "measuring stages: 0 s so far\n" in figures.stderr
    shown = totalediting("show", tmp_path / "run", small_dataset, "--output", tmp_path / "p.png")
    assert shown.returncode == 0 and "drawing: 0 s so far\n" in shown.stderr
    run = beside.open_run(tmp_path / "run", small_dataset)
    key = open_dataset(small_dataset, split="validation").keys()[0]
    measured = run.measure(key, "validation")
    assert measured.keys() == run.figures.keys() and measured["psnr"] > 0
    again = beside.open_run(tmp_path / "run", small_dataset).measure(key, "validation")
    assert again == pytest.approx(measured, nan_ok=True)
    pictures = [run.picture(key, "validation", name) for name in run.pictures]
    assert {p.shape for p in pictures} == {(128, 128, 3)} and pictures[3].any()
    with pytest.raises(InputError, match="is no shot of the split train"):
        run.measure(key, "train")
    assert "lightmaps: light error / that of the mean light: " in figures.stdout
    assert "reconstruct: PSNR of the source: " in figures.stdout
    for what in ("PSNR of pixels that the source shows", "PSNR of the matte's pixels"):
        assert f"reconstruct: {what}: " in figures.stdout
    monkeypatch.setattr(console, "FIRST_LINE", 60.0)
    empty = totalediting("evaluate", tmp_path, small_dataset).error
    assert "nothing was trained there" in empty
    missing = totalediting("show", tmp_path / "nothing", small_dataset).error
    assert "nothing was trained there" in missing
