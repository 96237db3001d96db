import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter
from synthetic_faces import a_tracking

from totalediting.editing import relight, warp
from totalediting.editing.bust import bust_of, triangles, view_of
from totalediting.editing.edit import _put_back, in_motion_of
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
    return warp.portrait_of(smooth, bust_of(tracking), view_of(tracking))


def test_the_whole_bust_has_the_skin_of_the_control_points(tracking):
    bust = bust_of(tracking)
    skin = control_of(tracking).posed[0].double().numpy()
    assert np.abs(bust.vertices[bust.skin] - skin).max() < 1e-5


def test_the_same_pose_gives_the_same_picture(portrait, tracking):
    found = warp.repose(portrait, bust_of(tracking), np.ones((SIDE, SIDE)))
    assert np.abs(found.picture - portrait.picture).mean() < 0.01
    assert np.allclose(found.normals, found.normals_before)


def test_a_turned_head_takes_its_pixels_along(portrait, tracking):
    head = torch.tensor([[0.0, 0.0, 0.25]])
    bust = bust_of(tracking._replace(head=head))
    found = warp.repose(portrait, bust, np.ones((SIDE, SIDE)))
    # The nose: ahead of all that is between eyes and chin.
    height = portrait.bust.vertices[:, 2]
    nose = np.where((height < 0) & (height > -0.1), portrait.bust.vertices[:, 1], 9).argmin()
    (x, y), _ = portrait.view.project(portrait.bust.vertices[nose], SIDE)
    (u, v), _ = portrait.view.project(bust.vertices[nose], SIDE)
    assert u > x + 3  # to the subject's left
    colour = portrait.picture[int(y), int(x)]
    assert np.abs(found.picture[int(v), int(u)] - colour).max() < 0.12
    # The border stays.
    assert np.abs(found.picture[0] - portrait.picture[0]).max() < 0.02


def test_the_drivers_turn_against_the_camera_is_taken_over(tracking):
    driver = a_tracking(np.random.default_rng(4), 1)
    found = in_motion_of(tracking, driver)
    turns = []
    for one in (found, driver):
        bust = bust_of(one._replace(identity=0 * one.identity, expression=0 * one.expression))
        still = bust_of(
            one._replace(
                identity=0 * one.identity, expression=0 * one.expression, head=0 * one.head
            )
        )
        skull = bust.vertices[:, 2].argsort()[-200:]
        axes = view_of(one).frame[:3, :3]
        left, right = ((b.vertices[skull] - b.vertices[skull].mean(0)) for b in (bust, still))
        turns.append(np.linalg.lstsq(right, left @ axes, rcond=None)[0])
    assert np.abs(turns[0] - turns[1]).max() < 0.05
    assert (found.expression == driver.expression).all()


def test_light_is_read_off_skin_and_put_onto_it(portrait):
    normals = portrait.raster.interpolate(portrait.bust.normals, triangles())
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)

    def of_sun(sun):
        return (0.3 + np.clip(normals @ np.array(sun), 0, None))[..., None] * [0.5, 0.3, 0.2]

    left, right = of_sun([0.7, -0.7, 0.1]), of_sun([-0.7, -0.7, 0.1])
    covered = portrait.raster.covered
    lights = [relight.light_of(portrait, picture) for picture in (left, right)]
    found = relight.relit(left, covered, (lights[0], normals), (lights[1], normals))

    def off(picture):
        shown = picture / picture[covered].mean()
        return np.abs(shown - right / right[covered].mean())[covered].mean()

    assert off(found) < 0.5 * off(left)
    same = relight.relit(left, covered, (lights[0], normals), (lights[0], normals))
    assert np.allclose(same, left)


def test_a_square_is_put_back_where_it_was_cut(portrait, tracking):
    from totalediting.editing.edit import Subject, _cut

    whole = (255 * np.random.default_rng(1).random((90, 120, 3))).astype(np.uint8)
    square = np.array([-10.0, 5.0, 100.0])
    subject = Subject(whole, square, tracking, portrait, np.ones((100, 100)))
    found = _put_back(subject, _cut(whole, square, 100) / 255)
    assert np.abs(found.astype(int) - whole).mean() < 1
