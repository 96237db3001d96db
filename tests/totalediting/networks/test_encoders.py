"""Encoder networks: shapes of all presets, gradients, zero initialisation, what depends on what."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional

from assets_procedural.conventions.camera import SENSOR_MM, CameraSample
from assets_procedural.motion.poses import ARKIT_NAMES
from totalediting.geometry import field
from totalediting.geometry.field import Table
from totalediting.geometry.relief import CHANNELS
from totalediting.geometry.shown import PIXEL, SIGHT, Sheet
from totalediting.geometry.tracking import CODE, EXPRESSIONS, FILL, FOCAL_MM, SIZES, Tracking
from totalediting.networks import head_tracker
from totalediting.networks.appearance import Appearance, AppearanceEncoder
from totalediting.networks.blocks import (
    Attention,
    FeedForward,
    ResidualBlock,
    TransformerBlock,
    coordinates,
    norm,
    position_grid,
    to_grid,
    to_tokens,
)
from totalediting.networks.head_tracker import HeadTracker, tracking_errors, tracking_loss
from totalediting.networks.reenactment import Deenactor, Reenactor, fuse
from totalediting.networks.triplanes import TriplaneEncoder
from totalediting.presets import PRESETS, Preset

TINY = PRESETS["tiny"]
MINI = replace(
    TINY,
    image=64,
    global_channels=32,
    detail_channels=16,
    tokens=8,
    token_dim=32,
    heads=2,
    deenact_blocks=1,
    reenact_blocks=1,
    motion_tokens=4,
    plane_size=32,
    plane_channels=4,
)


class Encoders(nn.Module):
    """All that lies between pictures and a tri-plane."""

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        self.appearance = AppearanceEncoder(preset)
        self.deenactor, self.reenactor = Deenactor(preset), Reenactor(preset)
        self.triplane = TriplaneEncoder(preset)
        self.tracker = HeadTracker(preset)

    def forward(self, image: Tensor, e_app: Tensor, e_mot: Tensor) -> Tensor:
        global_, detail, _ = self.appearance(sheet(image))
        return self.triplane(fuse(self.deenactor, self.reenactor, global_, e_app, e_mot), detail)


def weight(layer: nn.Module | None) -> torch.Tensor:
    assert layer is not None
    assert isinstance(layer.weight, torch.Tensor)
    return layer.weight


def encoders(preset: Preset = MINI, seed: int = 0) -> Encoders:
    torch.manual_seed(seed)
    return Encoders(preset)


def pictures(count: int, side: int, seed: int = 1) -> Tensor:
    return torch.rand(count, 3, side, side, generator=torch.Generator().manual_seed(seed))


def sheet(image: Tensor) -> Sheet:
    """A source that needs no turning: a slab across the box, seen from afar."""
    batch, side = len(image), image.shape[-1]
    one = torch.ones_like(image[:, :1])
    pixels = torch.cat([image, image, one, one, 100 * one, 100 * one], 1)
    still = torch.zeros(batch, 7, 2, 2, 2)
    still[:, 3] = 1
    camera = torch.eye(4)
    camera[:3, :3] = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    camera[:3, 3] = torch.tensor([0.0, -20.0, 0.0])
    lens = torch.tensor([[32.0 * side, 0, side / 2], [0, 32.0 * side, side / 2], [0, 0, 1]])
    relief = torch.zeros(batch, CHANNELS, 64, 64)
    camera, lens = (a.to(image.device).expand(batch, -1, -1) for a in (camera, lens))
    still = Table(still.to(image.device), (batch,))
    return Sheet(pixels, still, camera, lens, relief.to(image.device))


def codes(count: int, seed: int = 2) -> Tensor:
    return torch.rand(count, CODE, generator=torch.Generator().manual_seed(seed))


def awake(module: nn.Module) -> None:
    """Give cross-attention weights, as training would."""
    for block in module.modules():
        if isinstance(block, TransformerBlock) and block.cross is not None:
            nn.init.normal_(block.cross.out.weight, std=0.1)


@pytest.mark.parametrize("name", PRESETS)
def test_shapes_fit_together_in_every_preset(name, monkeypatch):
    monkeypatch.setattr(field, "check_points", lambda points: None)  # which looks at values
    p = PRESETS[name]
    with torch.device("meta"):
        net = Encoders(p)
        image, code = torch.rand(2, 3, p.image, p.image), torch.rand(2, CODE)
        appearance = net.appearance(sheet(image))
        assert isinstance(appearance, Appearance)
        assert appearance.global_.shape == (2, p.global_channels, p.image // 8, p.image // 8)
        assert appearance.detail.shape == (2, p.detail_channels, p.image // 2, p.image // 2)
        grid = (2, p.token_dim, p.tokens, p.tokens)
        neutral = net.deenactor(appearance.global_, code)
        assert neutral.shape == grid
        fused = net.reenactor(neutral, code)
        assert fused.shape == grid
        planes = net.triplane(fused, appearance.detail)
        assert planes.shape == (2, 3, p.plane_channels, p.plane_size, p.plane_size)
        assert net.tracker(image).code.shape == (2, CODE)


def test_gradients_reach_every_parameter():
    net = encoders()
    awake(net)
    image = pictures(2, MINI.image)
    planes = net(image, codes(2, 2), codes(2, 3))
    assert planes.isfinite().all()
    aligned = net.appearance(sheet(image)).shown.aligned
    found = [planes, aligned, *net.tracker(image)]
    torch.stack([x.square().mean() for x in found]).sum().backward()
    for name, parameter in net.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.isfinite().all() and parameter.grad.abs().max() > 0, name


def test_a_fresh_network_neither_explodes_nor_vanishes():
    net = encoders(TINY)
    image = pictures(1, TINY.image)
    global_, detail, _ = net.appearance(sheet(image))
    fused = fuse(net.deenactor, net.reenactor, global_, codes(1), codes(1))
    for map_ in (global_, detail, fused, net.triplane(fused, detail)):
        assert 0.2 < map_.std() < 5


@torch.no_grad()
def test_a_seed_decides_everything():
    image, code = pictures(1, MINI.image), codes(1)
    first, again, other = (encoders(seed=s)(image, code, code) for s in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.allclose(first, other, atol=0.1)


@torch.no_grad()
def test_pictures_of_a_batch_do_not_influence_each_other():
    net = encoders().train()
    awake(net)
    image, e_app, e_mot = pictures(3, MINI.image), codes(3, 2), codes(3, 3)
    alone = [net(image[i : i + 1], e_app[i : i + 1], e_mot[i : i + 1]) for i in range(3)]
    torch.testing.assert_close(net(image, e_app, e_mot), torch.cat(alone), rtol=1e-3, atol=1e-4)
    tracked = net.tracker(image).code[1:2]
    torch.testing.assert_close(tracked, net.tracker(image[1:2]).code, rtol=1e-3, atol=1e-4)


# Motion


def test_fresh_modules_do_not_see_the_code_and_one_step_later_they_do():
    net = encoders()
    image, rest, smile = pictures(1, MINI.image), torch.zeros(1, CODE), codes(1)

    def planes() -> list[Tensor]:
        return [net(image, *e) for e in ((rest, rest), (smile, rest), (rest, smile))]

    with torch.no_grad():
        before = planes()
    assert torch.equal(before[0], before[1]) and torch.equal(before[0], before[2])
    optimiser = torch.optim.Adam(net.parameters(), 1e-3)
    net(image, smile, rest).square().mean().backward()
    optimiser.step()
    with torch.no_grad():
        after = planes()
    assert (after[1] - after[0]).abs().max() > 1e-3, "the deenactor's code"
    assert (after[2] - after[0]).abs().max() > 1e-3, "the reenactor's code"


@torch.no_grad()
def test_every_coefficient_of_the_code_counts():
    net = encoders()
    awake(net)
    fed = torch.cat([torch.zeros(1, CODE), torch.eye(CODE)])
    neutral = torch.randn(1, MINI.token_dim, MINI.tokens, MINI.tokens).expand(len(fed), -1, -1, -1)
    change = (net.reenactor(neutral, fed)[1:] - net.reenactor(neutral, fed)[0]).flatten(1)
    assert (change.abs().amax(1) > 1e-2).all()
    # No two coefficients do the same.
    angle = functional.normalize(change) @ functional.normalize(change).mT
    assert angle.fill_diagonal_(0).max() < 0.95


def test_code_is_expression_then_gaze():
    assert len(ARKIT_NAMES) == EXPRESSIONS
    tracked = encoders().tracker(pictures(2, MINI.image))
    assert torch.equal(tracked.code[:, :52], tracked.expression)
    assert torch.equal(tracked.code[:, 52:], tracked.gaze)


# Appearance and planes


def test_full_has_the_convolutions_of_a_resnet34():
    with torch.device("meta"):
        trunk = AppearanceEncoder(PRESETS["full"]).trunk
    weights = sum(p.numel() for p in trunk.parameters() if p.ndim == 4)
    # 21,267,648 are those of ResNet-34 without its classifier; beside the picture there are what is
    # known of its light, coverage and skin, both sides of the front, x and y.
    assert weights == 21_267_648 + (PIXEL - 3 + 2 * SIGHT + 2) * 64 * 7 * 7


@torch.no_grad()
def test_detail_is_local_and_the_global_map_is_not():
    encoder = encoders().appearance
    one = pictures(1, MINI.image)
    dotted = one.clone()
    dotted[:, :, 20, 40] = 1 - dotted[:, :, 20, 40]
    before, after = encoder(sheet(one)), encoder(sheet(dotted))
    # 3 pixels of the first convolution and 2 of each of the four others, aligned with the picture.
    changed = (after.shown.aligned != before.shown.aligned)[0].any(0)
    rows, columns = changed.nonzero().unbind(-1)
    assert ((2 * rows - 20).abs() <= 11).all() and ((2 * columns - 40).abs() <= 11).all()
    assert len(rows) >= 9 * 9
    # On the front of the bust, both where it is and in the mirror image.
    laid = (after.detail - before.detail)[0].abs().amax(0) > 1e-6
    assert laid.any() and not laid.all()
    assert (after.global_ != before.global_)[0].any(0).all()


@torch.no_grad()
def test_planes_depend_on_both_inputs_and_differ_from_each_other():
    encoder = encoders().triplane
    feature = torch.randn(2, MINI.token_dim, MINI.tokens, MINI.tokens)
    detail = torch.randn(2, MINI.detail_channels, MINI.image // 2, MINI.image // 2)
    planes = encoder(feature, detail)
    assert (encoder(feature, detail.flip(0)) - planes).abs().mean() > 0.1
    assert (encoder(feature.flip(0), detail) - planes).abs().mean() > 0.1
    assert (planes[:, 0] - planes[:, 1]).abs().mean() > 0.1


@torch.no_grad()
def test_detail_of_another_side_than_the_planes_is_resized():
    preset = replace(MINI, image=128, tokens=16, plane_size=32)
    encoder = TriplaneEncoder(preset)
    assert encoder(torch.randn(1, 32, 16, 16), torch.randn(1, 16, 64, 64)).shape[-1] == 32


# The tracker


@torch.no_grad()
def test_a_fresh_tracker_sees_a_nearly_neutral_face():
    tracked = encoders(TINY).tracker(pictures(4, TINY.image))
    assert (tracked.expression - 0.05).abs().max() < 0.15
    for name, value in tracked._asdict().items():
        if name != "expression":
            assert value.abs().max() < 0.2, name


@torch.no_grad()
def test_expression_stays_in_its_range():
    tracker = encoders().tracker
    nn.init.normal_(weight(tracker.heads["expression"]), std=3)
    free = tracker(pictures(4, MINI.image)).expression
    assert free.min() < 0 and free.max() > 1  # in training, what overshoots keeps its gradient
    expression = tracker.eval()(pictures(4, MINI.image)).expression
    assert torch.equal(expression, free.clamp(0, 1)) and expression.std() > 0.3


def test_neutral_camera_is_the_dataset_s_default():
    camera = CameraSample()
    assert (camera.focal_mm, camera.fill) == (FOCAL_MM, FILL)
    assert SENSOR_MM == 36.0
    zeros = truth(1)
    assert zeros.focal_mm.item() == 85.0 and zeros.fill.item() == 0.5


@torch.no_grad()
def test_one_tracker_serves_all_presets():
    seen = []
    tiny = encoders(TINY).tracker
    nn.init.normal_(weight(tiny.heads["head"]))
    for preset in PRESETS.values():
        tracker = HeadTracker(preset)
        tracker.load_state_dict(tiny.state_dict())
        x, y = coordinates(preset.image, preset.image)
        image = torch.stack([x, y, torch.sin(5 * x + 3 * y)])[None] / 2 + 0.5
        seen.append(tracker(image).head)
    torch.testing.assert_close(seen[0], seen[1], rtol=0.02, atol=0.02)
    torch.testing.assert_close(seen[0], seen[2], rtol=0.02, atol=0.02)
    assert seen[0].abs().max() > 1


def test_a_face_is_laid_out_by_its_points():
    """ArcFace's template turned, scaled and moved into a picture comes back to where it was."""
    tracker, side = encoders(TINY).tracker, 128
    turn = torch.polar(torch.tensor(0.25), torch.tensor(0.4))
    placed = torch.view_as_real(torch.view_as_complex(tracker.template) * turn)
    placed = placed + torch.tensor([0.1, -0.2])  # right and down, in half frames
    x, y = coordinates(side, side)
    image = torch.stack([torch.exp(-((x - u) ** 2 + (y - v) ** 2) / 0.002) for u, v in placed[2:]])
    face = (placed / 2 * torch.tensor([1, -1])).flatten()
    laid = (tracker.lay_out(image[None], face[None])[0] + 1) / 2
    x, y = coordinates(64, 64)
    for dot, wanted in zip(laid, tracker.template[2:], strict=True):
        found = torch.stack([(dot * x).sum(), (dot * y).sum()]) / dot.sum()
        torch.testing.assert_close(found, wanted, atol=0.01, rtol=0)


def test_a_field_is_read_where_it_shows():
    """Where the face is held to be changes what is read off it, how the head is turned, no more."""
    tracker = encoders(TINY).tracker
    image = pictures(1, 128)
    here, there = (torch.full((1, 10), place).cumsum(1) for place in (0.01, -0.02))
    one, other = (tracker(image, face) for face in (here, there))
    changed = {
        name for name in Tracking._fields if not getattr(one, name).equal(getattr(other, name))
    }
    assert changed == {"expression", "gaze", "head", "camera_yaw_pitch_roll"}


def truth(count: int) -> Tracking:
    return Tracking(*(torch.zeros(count, int(size)) for size in SIZES))


@pytest.mark.parametrize("name", Tracking._fields)
def test_tracking_loss_weighs_each_field(name):
    zeros = truth(3)
    assert tracking_loss(zeros, zeros) == 0
    off = zeros._replace(**{name: getattr(zeros, name) - 0.25})
    error = 0.25**2 if name == "expression" else 0.25
    assert tracking_loss(off, zeros).item() == pytest.approx(error * head_tracker.WEIGHTS[name])
    errors = tracking_errors(off, zeros)
    assert errors.pop(name) == 0.25 and not any(errors.values())


def test_tracker_learns_where_and_how_large_something_is():
    tracker = encoders().tracker
    x, y = coordinates(MINI.image, MINI.image)
    shift = torch.tensor([[-0.3, -0.2], [0.3, 0.2], [-0.2, 0.3], [0.2, -0.3]])
    log_fill = torch.tensor([[-0.5], [-0.5], [0.5], [0.5]])
    centre = 2 * shift[:, :, None, None]
    distance = torch.hypot(x - centre[:, 0], y + centre[:, 1])
    image = (distance < 0.5 * log_fill.exp()[..., None]).float()[:, None].expand(-1, 3, -1, -1)
    wanted = truth(4)._replace(shift=shift, log_fill=log_fill)
    optimiser = torch.optim.Adam(tracker.parameters(), 3e-4)
    for _ in range(40):
        optimiser.zero_grad()
        tracking_loss(tracker(image), wanted).backward()
        optimiser.step()
    errors = tracking_errors(tracker(image), wanted)
    assert errors["shift"] < 0.1 and errors["log_fill"] < 0.25


# Blocks


def test_position_products_depend_on_the_displacement_alone():
    side, dim = 5, 16
    table = position_grid(side, dim)
    rate = 10000.0 ** -(torch.arange(dim // 4) / (dim // 4))
    row, column = torch.arange(side * side) // side, torch.arange(side * side) % side
    across, down = column - column[:, None], row - row[:, None]
    expected = (across[..., None] * rate).cos().sum(-1) + (down[..., None] * rate).cos().sum(-1)
    torch.testing.assert_close(table @ table.mT, expected)
    with pytest.raises(ValueError, match="multiple of 4, got 6"):
        position_grid(3, 6)


def test_grid_and_tokens_are_inverse_and_row_by_row():
    tokens = torch.arange(6.0 * 9).reshape(1, 9, 6)
    grid = to_grid(tokens)
    assert torch.equal(grid[0, :, 1, 2], tokens[0, 5])
    assert torch.equal(to_tokens(grid), tokens)
    with pytest.raises(ValueError, match=r"\(1, 8, 6\)"):
        to_grid(tokens[:, :8])


def test_coordinates_are_of_pixel_centres():
    xy = coordinates(2, 4)
    assert torch.equal(xy[0, 1], torch.tensor([-0.75, -0.25, 0.25, 0.75]))
    assert torch.equal(xy[1, :, 3], torch.tensor([-0.5, 0.5]))


@torch.no_grad()
def test_attention_is_the_softmax_of_products():
    torch.manual_seed(0)
    layer = Attention(12, 3)
    tokens, context = torch.randn(2, 5, 12), torch.randn(2, 7, 12)
    query, (key, value) = layer.query(tokens), layer.key_value(context).split(12, -1)
    heads = []
    for part in (slice(0, 4), slice(4, 8), slice(8, 12)):
        weight = (query[..., part] @ key[..., part].mT / math.sqrt(4)).softmax(-1)
        heads.append(weight @ value[..., part])
    torch.testing.assert_close(layer(tokens, context), layer.out(torch.cat(heads, -1)))
    with pytest.raises(ValueError, match="5 heads do not divide a width of 12"):
        Attention(12, 5)


@torch.no_grad()
def test_block_knows_no_order_unless_it_has_a_convolution():
    torch.manual_seed(0)
    tokens, context = torch.randn(2, 9, 16), torch.randn(2, 6, 16)
    order = torch.randperm(9)
    plain = TransformerBlock(16, 2, cross=True)
    awake(plain)
    result = plain(tokens, context)
    torch.testing.assert_close(plain(tokens[:, order], context), result[:, order])
    torch.testing.assert_close(plain(tokens, context.flip(1)), result)
    mixed = TransformerBlock(16, 2, conv=True)
    nn.init.normal_(weight(mixed.mlp.mix))
    assert not torch.allclose(mixed(tokens[:, order]), mixed(tokens)[:, order], atol=0.1)


@torch.no_grad()
def test_depthwise_convolution_starts_as_the_identity():
    mixed = FeedForward(8, conv=True)
    plain = FeedForward(8)
    plain.load_state_dict({k: v for k, v in mixed.state_dict().items() if "mix" not in k})
    tokens = torch.randn(2, 16, 8)
    torch.testing.assert_close(mixed(tokens), plain(tokens))


def test_block_takes_a_context_only_if_built_for_it():
    tokens = torch.zeros(1, 4, 8)
    with pytest.raises(ValueError, match="if, and only if"):
        TransformerBlock(8, 2)(tokens, tokens)
    with pytest.raises(ValueError, match="if, and only if"):
        TransformerBlock(8, 2, cross=True)(tokens)


@torch.no_grad()
def test_residual_block_keeps_or_halves_the_side():
    x = torch.randn(1, 16, 8, 8)
    for out, stride, dilation in ((16, 1, 1), (16, 1, 4), (24, 2, 1)):
        y = ResidualBlock(16, out, stride, dilation)(x)
        assert y.shape == (1, out, 8 // stride, 8 // stride) and y.min() >= 0
    same = ResidualBlock(16, 16)
    nn.init.zeros_(weight(same.body[-1]))
    assert torch.equal(same(x), x.relu())


@pytest.mark.parametrize("channels", [3, 13, 16, 96, 1024])
def test_norm_takes_any_number_of_channels(channels):
    y = norm(channels)(5 + 3 * torch.randn(1, channels, 16, 16))
    assert y.mean().abs() < 1e-4 and y.std().item() == pytest.approx(1, abs=1e-2)


# Errors


def test_wrong_shapes_are_refused_with_their_shape():
    net = encoders()
    image, code = pictures(2, MINI.image), codes(2)
    global_, detail, _ = net.appearance(sheet(image))
    feature = torch.zeros(2, MINI.token_dim, MINI.tokens, MINI.tokens)
    wrong = (
        (lambda: net.appearance(sheet(image[..., :32, :32])), r"pixels .*\(2, 10, 32, 32\)"),
        (lambda: net.tracker(image[:, :1]), r"\(2, 1, 64, 64\)"),
        (lambda: net.deenactor(detail, code), r"\(2, 16, 32, 32\)"),
        (lambda: net.deenactor(global_, code[:1]), r"\(1, 54\)"),
        (lambda: net.reenactor(feature, code[:, :52]), r"\(2, 52\)"),
        (lambda: net.reenactor(feature[..., :4], code), r"\(2, 32, 8, 4\)"),
        (lambda: net.triplane(feature[:, :5], detail), r"feature .*\(2, 5, 8, 8\)"),
        (lambda: net.triplane(feature, detail[0]), r"detail .*\(16, 32, 32\)"),
        (lambda: tracking_loss(truth(2), truth(3)), r"\(2, 52\).*\(3, 52\)"),
    )
    for call, message in wrong:
        with pytest.raises(ValueError, match=message):
            call()


@pytest.mark.parametrize(
    ("module", "change", "message"),
    [
        (AppearanceEncoder, {"image": 100}, "image 100"),
        (AppearanceEncoder, {"global_channels": 30}, "global_channels 30"),
        (Deenactor, {"tokens": 3}, "3 tokens do not divide a map of side 8"),
        (TriplaneEncoder, {"tokens": 12}, "32 is not 12 times"),
        (TriplaneEncoder, {"plane_size": 16, "tokens": 32}, "16 is not 32 times"),
    ],
)
def test_presets_that_do_not_fit_are_refused(module, change, message):
    with pytest.raises(ValueError, match=message):
        module(replace(MINI, **change))
