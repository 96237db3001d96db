"""Motion from one person to another: expression, gaze and the head against the camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from assets_procedural.motion.poses import ARKIT_NAMES
from totalediting.editing.sources import head_in_camera
from totalediting.editing.warping.bust import view_of
from totalediting.errors import InputError
from totalediting.faces import correspondences
from totalediting.geometry.tracking import Tracking


class Rest(NamedTuple):
    """How a driver looks when nothing moves; motion is relative to it."""

    expression: torch.Tensor
    """(1, 52)."""
    gaze: torch.Tensor
    """(1, 2)."""
    head: np.ndarray
    """(3, 3) from the head's axes to the camera's."""


_LEFT, _RIGHT = (ARKIT_NAMES.index(f"eyeBlink{side}") for side in ("Left", "Right"))
_WINK = (0.7, 0.95)  # of the difference of both blinks: the fit's error; meant


def rest_of(trackings: Sequence[Tracking]) -> Rest:
    """Of a clip: the median of its frames."""
    heads = Rotation.from_matrix(np.stack([head_in_camera(one) for one in trackings]))
    expressions = torch.cat([_blinking(one.expression) for one in trackings])
    gazes = torch.cat([one.gaze for one in trackings])
    return Rest(
        expressions.median(0, keepdim=True).values,
        gazes.median(0, keepdim=True).values,
        heads.mean().as_matrix(),
    )


def taken_over(subject: Tracking, driver: Tracking) -> Tracking:
    """A subject (1, …) with a driver's expression and gaze, its head turned against the camera as
    the driver's is."""
    return _turned(subject, driver, head_in_camera(driver))


def moved_off(subject: Tracking, driver: Tracking, rest: Rest | None) -> Tracking:
    """A subject (1, …) that moves off its own look as a driver moves off its rest.

    Without a rest, as of a single photograph: the head is turned as the driver's is, and of both
    expressions only counts what is more than the fit errs by, so that the look of a face at rest
    is not taken for a frown.
    """
    driver = driver._replace(expression=_blinking(driver.expression))
    if rest is None:
        sure = _sure(driver.expression) - _sure(subject.expression)
        moved = driver._replace(expression=(subject.expression + sure).clamp(0, 1))
        return _turned(subject, moved, head_in_camera(driver))
    shown = (subject.expression + driver.expression - rest.expression).clamp(0, 1)
    moved = driver._replace(expression=shown, gaze=subject.gaze + driver.gaze - rest.gaze)
    turn = head_in_camera(driver) @ rest.head.T
    return _turned(subject, moved, turn @ head_in_camera(subject))


def with_expression(tracking: Tracking, added: Mapping[str, float]) -> Tracking:
    """A tracking (1, …) with more, or less, of coefficients by ARKit name, kept in [0, 1].

    Raises:
        InputError: there is no such coefficient, or no such amount.
    """
    check_expression("expression", added)
    if not any(added.values()):
        return tracking
    expression = tracking.expression.clone()
    for name, amount in added.items():
        expression[:, ARKIT_NAMES.index(name)] += amount
    return tracking._replace(expression=expression.clamp(0, 1))


def check_expression(option: str, added: Mapping[str, float]) -> None:
    """Raises `InputError` for a coefficient that is none, or an amount beyond [-1, 1]."""
    for name, amount in added.items():
        if name not in ARKIT_NAMES:
            raise InputError(
                f"{option}: {name}: no such coefficient; give one of {', '.join(ARKIT_NAMES)}"
            )
        if not -1 <= amount <= 1:
            raise InputError(f"{option}: {name}: {amount:g}: give a number from -1 to 1")


def _turned(subject: Tracking, motion: Tracking, head: np.ndarray) -> Tracking:
    """`subject` with expression and gaze of `motion`, its head (3, 3) in the camera's axes."""
    angles = Rotation.from_matrix(view_of(subject).frame[:3, :3] @ head).as_euler("xyz")
    return subject._replace(
        expression=motion.expression,
        gaze=motion.gaze,
        head=torch.from_numpy(angles[None]).float(),
    )


def _blinking(expression: torch.Tensor) -> torch.Tensor:
    """Coefficients (1, 52) that close both eyes alike: turned heads are read as half a wink."""
    both = expression[:, [_LEFT, _RIGHT]]
    off = (both - both.mean(-1, keepdim=True)) * 2
    apart = float(off.abs().max())
    alike = both.mean(-1, keepdim=True) + 0.25 * apart
    share = min(max((apart - _WINK[0]) / (_WINK[1] - _WINK[0]), 0.0), 1.0)
    found = expression.clone()
    found[:, [_LEFT, _RIGHT]] = share * both + (1 - share) * alike
    return found


def _sure(expression: torch.Tensor) -> torch.Tensor:
    """Coefficients (1, 52), those that are within what the fit errs by near 0."""
    scatter = torch.from_numpy(correspondences.load().scatter).to(expression).clamp(0.02, 0.3)
    share = ((expression - 0.5 * scatter) / (1.5 * scatter)).clamp(0, 1)
    return expression * share * share * (3 - 2 * share)
