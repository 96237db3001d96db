"""Losses and figures against hand computations, and gradients only where they should flow."""

import math

import pytest
import torch
import torch.nn.functional as F

from totalediting import metrics
from totalediting.light import lightmaps
from totalediting.networks.lightmap_estimator import fold, texel_weights
from totalediting.training import losses
from totalediting.training.losses import OURS, PAPER, TERMS, LossWeights, total


def test_l1_is_a_mean_and_a_weighted_mean():
    a, b = torch.tensor([[[[0.0, 0.5]]]]), torch.tensor([[[[1.0, 0.25]]]])
    assert losses.l1(a, b).item() == pytest.approx((1.0 + 0.25) / 2)
    weight = torch.tensor([[[[1.0, 3.0]]]])
    assert losses.l1(a, b, weight).item() == pytest.approx((1.0 + 3 * 0.25) / 4)


def test_a_weight_of_one_channel_gives_the_mean_over_channels():
    a, b = torch.zeros(1, 3, 1, 2), torch.ones(1, 3, 1, 2)
    b[..., 1] = 9.0
    mask = torch.tensor([[[[1.0, 0.0]]]])
    assert losses.l1(a, b, mask).item() == 1.0


def test_l1_where_nothing_counts_is_zero_without_gradient():
    a = torch.ones(1, 3, 2, 2, requires_grad=True)
    loss = losses.l1(a, torch.zeros(1, 3, 2, 2), torch.zeros(1, 1, 2, 2))
    loss.backward()
    assert loss.item() == 0.0 and a.grad is not None and not a.grad.any()


def test_figures_say_by_which_pixels():
    """Black around a subject makes an error look small; by the matte it does not count."""
    truth, matte = torch.full((1, 3, 16, 16), 0.5), torch.zeros(1, 1, 16, 16)
    matte[..., :4] = 1.0
    found = metrics.picture_figures(matte * (truth + 0.1), matte * truth, matte)
    assert found["matte_psnr"].item() == pytest.approx(20.0, abs=1e-3)
    assert found["psnr"].item() == pytest.approx(20.0 + 10 * math.log10(4), abs=1e-3)
    assert 0 < found["ssim"].item() < 1
    source = metrics.source_figures(truth + 0.1, matte * truth, matte)
    assert source["source_matte_psnr"].item() == pytest.approx(20.0, abs=1e-3)


def test_other_shapes_are_refused_with_the_shapes():
    with pytest.raises(ValueError, match=r"\(1, 3\).*\(1, 4\)"):
        losses.l1(torch.zeros(1, 3), torch.zeros(1, 4))
    with pytest.raises(ValueError, match="does not broadcast"):
        losses.l1(torch.zeros(1, 3), torch.zeros(1, 3), torch.zeros(1, 2))
    with pytest.raises(ValueError, match=r"\(5,\), not \(4,\)"):
        losses.lightmap_loss(torch.zeros(1, 5, 3), torch.zeros(1, 5, 3), torch.zeros(4))


def test_identity_loss_is_one_minus_cosine_and_moves_only_the_result():
    a = torch.tensor([[1.0, 0.0], [0.0, 2.0]], requires_grad=True)
    b = torch.tensor([[1.0, 1.0], [0.0, 5.0]], requires_grad=True)
    loss = losses.identity_loss(a, b)
    loss.backward()
    assert loss.item() == pytest.approx(1.0 - (math.sqrt(0.5) + 1.0) / 2, abs=1e-6)
    assert a.grad is not None and a.grad.any() and b.grad is None


def test_albedo_loss_knows_that_rendered_albedo_is_premultiplied():
    truth = torch.rand(2, 3, 4, 4, generator=torch.Generator().manual_seed(0))
    matte = torch.tensor([0.0, 0.5, 1.0, 1.0]).expand(2, 1, 4, 4)
    assert losses.albedo_loss(matte * truth, truth, matte).item() == 0.0
    behind = matte * truth + (matte == 0) * 7.0
    assert losses.albedo_loss(behind, truth, matte).item() == 0.0
    assert losses.albedo_loss(matte * truth + 0.1, truth, matte).item() == pytest.approx(0.1)


def test_normal_loss_is_of_directions_in_the_foreground():
    truth = torch.zeros(1, 3, 1, 4)
    truth[0, 2, 0, :3] = 1.0
    normal = torch.zeros(1, 3, 1, 4)
    normal[0, :, 0, 0] = torch.tensor([0.0, 0.0, 0.3])  # parallel, premultiplied
    normal[0, :, 0, 1] = torch.tensor([0.0, 2.0, 0.0])  # at a right angle
    normal[0, :, 0, 2] = torch.tensor([0.0, 0.0, -1.0])  # opposite, but not in the matte
    normal[0, :, 0, 3] = 1.0  # where the truth has none
    matte = torch.tensor([1.0, 1.0, 0.0, 1.0]).view(1, 1, 1, 4)
    assert losses.normal_loss(normal, truth, matte).item() == pytest.approx(0.5)


def test_normal_loss_has_a_finite_gradient_where_nothing_is_rendered():
    normal = torch.zeros(1, 3, 2, 2, requires_grad=True)
    losses.normal_loss(normal, torch.ones(1, 3, 2, 2), torch.ones(1, 1, 2, 2)).backward()
    assert normal.grad is not None and normal.grad.isfinite().all()


def test_lightmap_loss_is_by_solid_angle():
    # Wrong in the whole upper half, by 1: half of the sphere, though rows differ.
    height = 8
    truth = torch.zeros(2, 5, 3, height, 2 * height)
    wrong = truth.clone()
    wrong[..., : height // 2, :] = 1.0
    found = losses.lightmap_loss(fold(wrong), fold(truth), texel_weights(height))
    assert found.item() == pytest.approx(0.5)
    # Only the row at the pole: its share of the sphere.
    wrong = truth.clone()
    wrong[..., :1, :] = 1.0
    found = losses.lightmap_loss(fold(wrong), fold(truth), texel_weights(height))
    assert found.item() == pytest.approx((1.0 - math.cos(math.pi / height)) / 2, abs=1e-6)


def test_regularisers():
    a, b = torch.tensor([[1.0, 2.0]]), torch.tensor([[1.5, 0.0]])
    assert losses.tv_loss(a, b).item() == pytest.approx(1.25)
    assert losses.mask_loss(torch.full((1, 1, 2, 2), 0.25), torch.ones(1, 1, 2, 2)).item() == 0.75


def test_surface_loss_is_a_mean_distance_whatever_the_opacity():
    weights = torch.tensor([[[0.2, 0.2], [0.5, 0.0], [0.3, 0.1]]], requires_grad=True)
    points = torch.zeros(1, 3, 2, 3)
    points[0, :, 0, 0], points[0, :, 1, 2] = 0.1, -0.3
    truth, known = torch.zeros(1, 3, 3), torch.tensor([[1.0, 1.0, 0.0]])
    loss = losses.surface_loss(weights, points, truth, known)
    assert loss.item() == pytest.approx((0.2 + 0.1) / 2)
    loss.backward()
    assert weights.grad is not None
    # Nearer samples gain, farther ones lose; what is not known does not count.
    assert weights.grad[0, 0, 0] < 0 < weights.grad[0, 0, 1] and not weights.grad[0, 2].any()
    faint = losses.surface_loss(0.1 * weights.detach(), points, truth, known)
    assert faint.item() == pytest.approx(loss.item(), rel=1e-5)


def test_density_normal_loss_weighs_and_moves_normals_alone():
    normal = torch.tensor([[[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]])
    density = torch.tensor([[[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]]])
    weights = torch.tensor([[0.25, 0.5, 0.25]])
    for tensor in (normal, density, weights):
        tensor.requires_grad_()
    loss = losses.density_normal_loss(normal, density, weights)
    # Aligned: 0. At a right angle: 1. Density that faces nowhere: 0.
    assert loss.item() == pytest.approx(0.5)
    loss.backward()
    assert normal.grad is not None and normal.grad[0, 1].any() and not normal.grad[0, 2].any()
    assert density.grad is None and weights.grad is None


def test_presets_are_the_papers_and_ours():
    assert set(OURS.at(1_000_000)) == set(TERMS)
    paper = PAPER.at(0)
    absent = {"raw", "foreground", "surface"}
    assert {n for n, w in paper.items() if w == 0} == absent
    assert all(w == 1 for n, w in paper.items() if n not in absent)
    late = OURS.at(100_000)
    assert (late["final"], late["mask"], late["normal"], late["adversarial"]) == (1, 1, 0.5, 0.01)
    assert late["density_normal"] == 0.05 and late["residual"] == 0.1


def test_the_schedule():
    weights = LossWeights(
        density_normal=0.5,
        density_normal_from=100,
        density_normal_until=300,
        identity_from=50,
        adversarial_from=60,
        tv=0.25,
        tv_every=4,
    )
    ramp = {s: weights.at(s)["density_normal"] for s in (0, 100, 150, 200, 300, 900)}
    assert ramp == {0: 0, 100: 0, 150: 0.125, 200: 0.25, 300: 0.5, 900: 0.5}
    assert [weights.at(s)["identity"] for s in (49, 50)] == [0, 1]
    assert [weights.at(s)["adversarial"] for s in (59, 60)] == [0, 0.01]
    # Lazily: one step in four, four times the weight.
    assert [weights.at(s)["tv"] for s in range(6)] == [1, 0, 0, 0, 1, 0]
    half = weights.over(50_000)
    assert (half.identity_from, half.density_normal_until, half.tv_every) == (25, 150, 4)


@pytest.mark.parametrize("steps", [1, 50, 1_000, 2_000, 100_000, 250_000])
def test_dates_keep_their_share_of_a_run(steps: int):
    weights = OURS.over(steps)
    whole, start = OURS.at(100_000), weights.at(0)
    # L_adv is last; L_LPIPS and L_id are there from the first step on.
    first = steps * 50 // 100
    adversarial = [weights.at(step)["adversarial"] for step in (first, first + 1, steps)]
    assert adversarial == 3 * [whole["adversarial"]]
    assert not any(weights.at(s)["adversarial"] for s in {0, first - 1} if 0 <= s < first)
    assert start["lpips"] == whole["lpips"] and start["identity"] == whole["identity"]
    # R_n: nothing until 2 % of the run, half at 6 %, all from 10 % on.
    low, middle, high = (steps * percent // 100 for percent in (2, 6, 10))
    ramp = [weights.at(step)["density_normal"] for step in (low, middle, high, steps)]
    assert ramp[2:] == [whole["density_normal"]] * 2
    if steps >= 1_000:
        half = 0.5 * whole["density_normal"]
        assert ramp[:2] == [0.0, pytest.approx(half)] and start["density_normal"] == 0.0
    # The rest knows no date, and the end is that of the schedule it comes from.
    dated = ("adversarial", "density_normal", "tv")
    assert all(start[term] == whole[term] for term in TERMS if term not in dated)
    assert weights.tv_every == OURS.tv_every
    assert {**weights.at(steps), "tv": 0.0} == {**whole, "tv": 0.0}
    assert OURS.over(100_000) == OURS and PAPER.over(steps) == PAPER


def test_total_adds_what_is_given_and_says_what_is_off():
    final = torch.tensor(0.5, requires_grad=True)
    late = torch.tensor(3.0, requires_grad=True)
    terms = {
        "final": final,
        "mask": torch.tensor(2.0),
        "identity": late,
        "albedo": None,
        "tv": torch.tensor(1.0),
        "raw": torch.tensor(4.0),
    }
    weights = LossWeights(raw=0.0, identity_from=10)
    found = total(terms, weights, step=1)
    assert found.loss.item() == pytest.approx(0.5 + 2.0)
    assert found.scalars == pytest.approx({"final": 0.5, "mask": 2.0, "total": 2.5})
    assert found.off["albedo"] == found.off["lightmap"] == "not given"
    assert found.off["identity"] == "not yet" and found.off["raw"] == "weight 0"
    assert found.off["tv"] == "not in this step" and found.off["adversarial"] == "not yet"
    found.loss.backward()
    assert final.grad is not None and final.grad.item() == 1.0 and late.grad is None
    assert total(terms, weights, step=16).loss.item() == pytest.approx(2.5 + 3.0 + 0.25 * 16)


def test_total_refuses_what_it_does_not_know():
    with pytest.raises(ValueError, match=r"unknown terms \['colour'\]"):
        total({"colour": torch.tensor(1.0)}, OURS, 0)
    with pytest.raises(ValueError, match=r"final must be one number, not \(2,\)"):
        total({"final": torch.ones(2)}, OURS, 0)
    with pytest.raises(ValueError, match="no term counts at step 0"):
        total({"albedo": None}, OURS, 0)


def test_psnr_by_hand_and_by_matte():
    truth = torch.zeros(2, 3, 4, 4)
    prediction = truth.clone()
    prediction[1] += 0.1
    found = metrics.psnr(prediction, truth)
    assert found[0] == math.inf and found[1].item() == pytest.approx(20.0, abs=1e-4)
    matte = torch.zeros(2, 1, 4, 4)
    matte[..., :2] = 1.0
    # Half of the pixels are black in both: half of the error, 3 dB.
    halved = metrics.psnr(prediction, truth, matte)[1].item()
    assert halved == pytest.approx(20.0 + 10 * math.log10(2.0), abs=1e-4)


def ssim_by_hand(a: torch.Tensor, b: torch.Tensor) -> float:
    """Of two (11, 11) pictures: one window, its sums written out."""
    g = [math.exp(-((k - 5) ** 2) / (2 * 1.5**2)) for k in range(11)]
    w = torch.tensor([[u * v for v in g] for u in g], dtype=torch.float64)
    w = w / w.sum()
    mean_a, mean_b = (w * a).sum(), (w * b).sum()
    variance_a, variance_b = (w * (a - mean_a) ** 2).sum(), (w * (b - mean_b) ** 2).sum()
    covariance = (w * (a - mean_a) * (b - mean_b)).sum()
    top = (2 * mean_a * mean_b + 1e-4) * (2 * covariance + 9e-4)
    return (top / ((mean_a**2 + mean_b**2 + 1e-4) * (variance_a + variance_b + 9e-4))).item()


def test_ssim_by_hand():
    generator = torch.Generator().manual_seed(1)
    a = torch.rand(1, 1, 11, 11, generator=generator, dtype=torch.float64)
    b = 0.5 * a + 0.5 * torch.rand(1, 1, 11, 11, generator=generator, dtype=torch.float64)
    assert metrics.ssim(a, b).item() == pytest.approx(ssim_by_hand(a[0, 0], b[0, 0]), abs=1e-9)
    assert metrics.ssim(a, a).item() == pytest.approx(1.0)
    with pytest.raises(ValueError, match="at least 11"):
        metrics.ssim(a[..., :10], b[..., :10])


def test_ssim_is_scikit_images():
    row, column = torch.meshgrid(torch.arange(30.0), torch.arange(40.0), indexing="ij")
    channels = [((row * (k + 2) + column * 3) % 17) / 16 for k in range(3)]
    a = torch.stack(channels)[None].double()
    b = (0.8 * a + 0.2 * ((row * column) % 5) / 4).double()
    # structural_similarity of scikit-image 0.26 with gaussian_weights, sigma=1.5, data_range=1 and
    # use_sample_covariance=False.
    assert metrics.ssim(a, b).item() == pytest.approx(0.938280747, abs=1e-6)


def test_ssim_of_what_lies_outside_the_matte_is_perfect():
    generator = torch.Generator().manual_seed(3)
    a, b = torch.rand(2, 1, 3, 24, 24, generator=generator)
    assert metrics.ssim(a, b, torch.zeros(1, 1, 24, 24)).item() == 1.0


def test_normal_error_is_a_mean_angle():
    truth = torch.zeros(1, 3, 1, 3)
    truth[0, 2, 0, :2] = 1.0
    normal = torch.zeros(1, 3, 1, 3)
    normal[0, :, 0, 0] = torch.tensor([0.0, math.sin(0.2), math.cos(0.2)]) * 3.0
    normal[0, :, 0, 1] = torch.tensor([1.0, 0.0, 0.0])
    both = metrics.normal_error(normal, truth, torch.ones(1, 1, 1, 3))
    assert both.item() == pytest.approx((math.degrees(0.2) + 90.0) / 2, abs=1e-3)
    first = torch.tensor([1.0, 0.0, 0.0]).view(1, 1, 1, 3)
    assert metrics.normal_error(normal, truth, first).item() == pytest.approx(math.degrees(0.2))


def sun(direction: torch.Tensor, height: int = 64, power: float = 2000.0) -> torch.Tensor:
    """A panorama of a small round light and some sky."""
    cosine = lightmaps.texel_directions(height) @ F.normalize(direction, dim=0)
    return (0.05 + power * (cosine > 0.995))[..., None].expand(-1, -1, 3).contiguous()


def light_errors(environments: list[torch.Tensor], places: torch.Tensor, height: int):
    maps = torch.stack([lightmaps.bake(environment, height) for environment in environments])
    cosine = (metrics.dominant_light(maps) * places).sum(1)
    return torch.rad2deg(cosine.clamp(-1, 1).acos())


def test_dominant_light_is_found_finer_than_texels():
    generator = torch.Generator().manual_seed(4)
    places = F.normalize(torch.randn(60, 3, generator=generator), dim=1)
    suns = [sun(place) for place in places]
    # Texels are 11.25 and 5.625 degrees wide.
    assert light_errors(suns, places, 16).max() < 2.6
    assert light_errors(suns, places, 32).max() < 1.0
    # A bright sky beside the sun pulls little.
    sky = 20.0 * (lightmaps.texel_directions(64)[..., 2:] > 0)
    skies = [sun(place, power=150.0) + sky for place in places]
    assert light_errors(skies, places, 32).mean() < 1.0


def test_dominant_light_takes_the_stronger_of_two():
    left, right = torch.tensor([1.0, 0.0, 0.0]), torch.tensor([0.0, 1.0, 0.0])
    maps = lightmaps.bake(sun(left) + sun(right, power=1500.0), 32)[None]
    assert (metrics.dominant_light(maps)[0] @ left).item() > math.cos(math.radians(2.0))
    turned = lightmaps.bake(sun(right), 32)[None]
    assert metrics.light_error(maps, turned).item() == pytest.approx(90.0, abs=2.0)
    assert metrics.light_error(maps, maps).item() == pytest.approx(0.0, abs=1e-3)


def test_lightmap_error_by_hand_and_relative_to_the_mean():
    dark, bright = torch.zeros(1, 5, 3, 4, 8), torch.full((1, 5, 3, 4, 8), math.e**2 - 1.0)
    assert metrics.lightmap_error(dark, bright).item() == pytest.approx(2.0, abs=1e-5)
    both = torch.cat([dark, bright])
    mean = metrics.mean_lightmaps(both)
    assert metrics.lightmap_error(mean, both).tolist() == pytest.approx([1.0, 1.0], abs=1e-5)
    upper = dark.clone()
    upper[..., :1, :] = math.e - 1.0
    share = (1.0 - math.cos(math.pi / 4)) / 2
    assert metrics.lightmap_error(upper, dark).item() == pytest.approx(share, abs=1e-6)


def test_metrics_refuse_other_shapes():
    with pytest.raises(ValueError, match=r"matte must be \(1, 1, 2, 2\), not \(1, 2, 2\)"):
        metrics.psnr(torch.zeros(1, 3, 2, 2), torch.zeros(1, 3, 2, 2), torch.zeros(1, 2, 2))
    with pytest.raises(ValueError, match=r"\(B, 5, 3, H, 2H\), not \(5, 3, 4, 8\)"):
        metrics.dominant_light(torch.zeros(5, 3, 4, 8))
    with pytest.raises(ValueError, match="lobe must be one of diffuse"):
        metrics.dominant_light(torch.zeros(1, 5, 3, 4, 8), "specular5")
