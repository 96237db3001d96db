import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter
from synthetic_faces import a_tracking

from assets_procedural.motion.poses import ARKIT_NAMES
from totalediting.editing.warping import field, relight, warp
from totalediting.editing.warping.bust import (
    GROUPS,
    bust_of,
    group_of_triangle,
    head_model,
    triangles,
    view_of,
)
from totalediting.editing.warping.mouth import inside_lips
from totalediting.editing.warping.portrait import Portrait
from totalediting.geometry.rig import control_of
from totalediting.geometry.tracking import Tracking

SIDE = 96


@pytest.fixture(scope="module")
def tracking() -> Tracking:
    drawn = a_tracking(np.random.default_rng(3), 1)
    still = {name: 0 * getattr(drawn, name) for name in ("head", "gaze", "expression")}
    return drawn._replace(**still)


@pytest.fixture(scope="module")
def portrait(tracking):
    noise = np.random.default_rng(0).random((SIDE, SIDE, 3))
    smooth = gaussian_filter(noise, (3, 3, 0))
    smooth = (smooth - smooth.min()) / np.ptp(smooth)
    return Portrait(smooth, np.ones((SIDE, SIDE)), bust_of(tracking), view_of(tracking))


def test_the_whole_bust_has_the_skin_of_the_control_points(tracking):
    bust = bust_of(tracking)
    skin = control_of(tracking).posed[0].double().numpy()
    assert np.abs(bust.vertices[bust.skin] - skin).max() < 1e-5


def test_the_same_pose_gives_the_same_picture(portrait, tracking):
    found = warp.repose(portrait, bust_of(tracking))
    assert np.abs(found.person - portrait.picture).mean() < 0.01
    assert np.allclose(found.normals, found.normals_before)


def test_a_turned_head_takes_its_pixels_along(portrait, tracking):
    head = torch.tensor([[0.0, 0.0, 0.25]])
    bust = bust_of(tracking._replace(head=head))
    found = warp.repose(portrait, bust)
    # The nose: ahead of all that is between eyes and chin.
    height = portrait.bust.vertices[:, 2]
    nose = np.where((height < 0) & (height > -0.1), portrait.bust.vertices[:, 1], 9).argmin()
    (x, y), _ = portrait.view.project(portrait.bust.vertices[nose], SIDE)
    (u, v), _ = portrait.view.project(bust.vertices[nose], SIDE)
    assert u > x + 3  # to the subject's left
    colour = portrait.picture[int(y), int(x)]
    assert np.abs(found.person[int(v), int(u)] - colour).max() < 0.12
    # The border stays.
    assert np.abs(found.person[0] - portrait.picture[0]).max() < 0.02


def test_light_is_read_off_skin_and_put_onto_it(portrait):
    normals = portrait.raster.interpolate(portrait.bust.normals, triangles())
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)

    def of_sun(sun):
        return (0.3 + np.clip(normals @ np.array(sun), 0, None))[..., None] * [0.5, 0.3, 0.2]

    left, right = of_sun([0.7, -0.7, 0.1]), of_sun([-0.7, -0.7, 0.1])
    covered = portrait.raster.covered
    lights = [relight.light_of(portrait, picture) for picture in (left, right)]
    found = left * relight.ratio_of(covered, 1.0 * covered, lights[0](normals), lights[1](normals))

    def off(picture):
        shown = picture / picture[covered].mean()
        return np.abs(shown - right / right[covered].mean())[covered].mean()

    assert off(found) < 0.5 * off(left)
    same = left * relight.ratio_of(covered, 1.0 * covered, lights[0](normals), lights[0](normals))
    assert np.allclose(same, left)


def test_no_background_bleeds_into_the_person(portrait, tracking):
    matte = gaussian_filter(portrait.raster.covered.astype(float), 2)
    red = matte[..., None] * [0.8, 0.2, 0.2] + (1 - matte[..., None]) * [0.1, 0.9, 0.1]
    person = Portrait(red, matte, portrait.bust, portrait.view)
    found = warp.repose(person, bust_of(tracking._replace(head=torch.tensor([[0.0, 0.0, 0.35]]))))
    assert found.person[found.matte > 0.1][:, 1].max() < 0.3
    assert np.abs(person.background[..., 0] - 0.1).max() < 0.05


def test_what_was_hardly_seen_is_not_stretched_to_streaks(portrait, tracking):
    bust = bust_of(tracking._replace(head=torch.tensor([[0.0, 0.0, 0.35]])))
    raster = bust.raster(portrait.view, SIDE)
    points = raster.interpolate(portrait.bust.vertices, triangles())
    own = portrait.view.project(points, SIDE)[0]
    seen = (portrait.raster.covered & raster.covered).astype(float) * (own[..., 0] > SIDE / 2)
    places = field.moved_along(portrait, bust, portrait.view, raster, own, seen)
    step = np.linalg.norm(np.diff(places, axis=1), axis=-1)
    assert step.min() > 0.2


def test_an_opened_mouth_has_bright_teeth_and_a_dark_inside(portrait, tracking):
    grey = Portrait(np.full((SIDE, SIDE, 3), 0.5), portrait.matte, portrait.bust, portrait.view)
    expression = torch.zeros(1, 52)
    for name in ("jawOpen", "mouthUpperUpLeft", "mouthUpperUpRight"):
        expression[0, ARKIT_NAMES.index(name)] = 0.8
    bust = bust_of(tracking._replace(expression=expression))
    found = warp.repose(grey, bust)
    group = np.where(found.raster.covered, group_of_triangle()[found.raster.triangle], -1)
    inside = inside_lips(grey.view, bust, found.raster)
    teeth = found.person[group == GROUPS.index("teeth_upper")].mean()
    dark = np.percentile(found.person[inside].mean(-1), 10)
    assert teeth > 0.3 and dark < 0.25


def test_a_collar_beside_the_chin_stays_and_hair_beside_the_eyes_goes_along(portrait, tracking):
    bust = bust_of(tracking._replace(head=torch.tensor([[0.0, 0.3, 0.0]])))
    raster = bust.raster(portrait.view, SIDE)
    own = np.stack(np.meshgrid(*2 * [np.arange(SIDE) + 0.5]), -1)
    seen = np.zeros((SIDE, SIDE))
    places = field.moved_along(portrait, bust, portrait.view, raster, own, seen)
    eyes = bust.vertices[head_model().groups["eye_left"]].mean(0)
    shifts = []
    for height in (0.03, -0.13):
        (x, y), _ = portrait.view.project(np.array([0.12, eyes[1] + 0.1, eyes[2] + height]), SIDE)
        shifts.append(np.abs(places[int(y), int(x)] - own[int(y), int(x)]).max())
    assert shifts[0] > 2 and shifts[1] < 1
