"""What is asked of a system on held-out people: the same pairs for every system, without chance.

Each person's first shot is the source, in the first of its environments:

    views         every other view of the same moment, same light (multiview subsets)
    reenactment   every other moment, same light (video subsets)
    relighting    the source itself, in the second of its environments
    cross         the moments of the next person of the subset, whose light they are seen in
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from assets_procedural.person import Person
from totalediting.data import shots
from totalediting.data.pairs import PortraitPair, PortraitPairs
from totalediting.geometry.identity import identity_basis
from totalediting.geometry.rig import control_of
from totalediting.geometry.tracking import Tracking

NAMES = ("views", "reenactment", "relighting", "cross")
MOST_OF_PERSON = 8
"""Targets of a person in a task."""


class Question(NamedTuple):
    """One picture that is asked for, and what is given for it."""

    task: str
    source: int
    """Number of the source's shot."""
    target: int
    """Of the shot whose motion and camera are given, and, but for `cross`, which is the truth."""
    lights: tuple[int, int]
    """Environment of source and target."""
    person: int
    """Number of the source's person."""


def questions(pairs: PortraitPairs) -> list[Question]:
    """All that a split asks."""
    people: dict[str, list[int]] = {}
    for number, subject in enumerate(pairs.shots.subjects):
        people.setdefault(subject, []).append(number)
    asked = []
    everybody = list(people.values())
    for person, numbers in enumerate(everybody):
        first, others = numbers[0], numbers[1 : 1 + MOST_OF_PERSON]
        task = "reenactment" if pairs.shots.moves(first) else "views"
        asked += [Question(task, first, other, (0, 0), person) for other in others]
        if pairs.shots.environments(first) > 1:
            asked.append(Question("relighting", first, first, (0, 1), person))
        moving = [o for o in everybody if o is not numbers and pairs.shots.moves(o[0])]
        if moving and pairs.shots.moves(first):
            after = next((o for o in moving if o[0] > first), moving[0])
            asked += [
                Question("cross", first, other, (0, 0), person) for other in after[:MOST_OF_PERSON]
            ]
    return sorted(asked, key=lambda question: NAMES.index(question.task))


def pair_of(pairs: PortraitPairs, question: Question) -> PortraitPair:
    """What is given for a question, and the truth; of `cross`, the driver stands for that."""
    if question.task != "cross":
        return pairs.of(question.target, question.source, question.lights)
    driver = pairs.of(question.target, question.target, question.lights)
    own = pairs.of(question.source, question.source, question.lights)
    meta = pairs.shots.read(question.target, "meta")["meta"]
    person = pairs.shots.read(question.source, "meta")["meta"]["person"]
    identity = identity_basis().coefficients(Person.model_validate(person)).float()
    shown = _batched(shots.tracking(meta, identity))
    control = control_of(shown)
    if pairs.warped:
        still = shown._replace(expression=0 * shown.expression, gaze=0 * shown.gaze)
        control = control.showing(control_of(still))
    control = type(control)(*(field[0] for field in control))
    return driver._replace(
        app=own.app._replace(control=own.app.control.showing(control)),
        app_depth=own.app_depth,
        control=control,
        app_key=own.key,
    )


def source_points(pairs: PortraitPairs, question: Question) -> Tensor:
    """(5, 2) pixels of the source: eyes, nose, corners of the mouth."""
    meta = pairs.shots.read(question.source, "meta")["meta"]
    return shots.five_points(meta, pairs.side)


def key_of(question: Question, source: str, target: str) -> str:
    """Name of the picture that is asked for, of shots "<subset>/<shot>":
    "<task>/<subset>/<source>-<target>"."""
    subset, _, shot = source.rpartition("/")
    return "/".join([question.task, subset, f"{shot}-{target.rpartition('/')[2]}"])


def batches(pairs: PortraitPairs, size: int) -> Iterator[tuple[list[Question], list[PortraitPair]]]:
    """All questions of a split with their pairs, those of a task together."""
    asked = questions(pairs)
    for name in NAMES:
        here = [question for question in asked if question.task == name]
        for start in range(0, len(here), size):
            some = here[start : start + size]
            yield some, [pair_of(pairs, question) for question in some]


def _batched(tracking: Tracking) -> Tracking:
    return Tracking(*(torch.as_tensor(field)[None] for field in tracking))
