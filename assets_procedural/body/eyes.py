"""Eyes: lathed eyeballs with a recessed iris, corneas, tear lines and caruncles.

Frame of one eye: its centre is the origin, the optic axis is -Y, Z is up; `theta` is the angle from
the optic axis and `phi` the azimuth around it (0 towards +X, a quarter turn towards +Z). Lengths in
that frame are in eyeball radii unless said otherwise.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from assets_procedural.body.head import Bust, HeadModel, Identity
from assets_procedural.body.iris import eye_texture, texture_radius
from assets_procedural.body.piece import MeshPiece
from assets_procedural.conventions.parts import Part
from assets_procedural.mesh.subdivision import Subdivision, catmull_clark
from assets_procedural.mesh.sweep import tube_faces
from assets_procedural.mesh.vectors import arctan2, moved, smoothstep
from assets_procedural.person import Person

# Iris radius over eyeball radius. The model's eyeballs are a third larger than real ones (a real
# ratio is .49), its eyelids are not: this ratio gives the iris its share of the visible eye.
IRIS_RATIO = 0.42
_LIMBUS = float(np.arcsin(IRIS_RATIO))
# A real iris is 11.8 mm wide; `Eyes.pupil_mm` is read against that.
_IRIS_MM = 11.8
_SEGMENTS = 64
_CORNEA_BULGE = 0.075
_TEAR_SAMPLES = 48
_SHADE_SAMPLES = 64
# Rows of the lids' shade over the eye, from under the lid inwards: share of its width, darkness.
_SHADE_ROWS = np.array([(-0.25, 1.0), (0.0, 1.0), (0.12, 0.72), (0.35, 0.36), (0.65, 0.1), (1, 0)])
# Its width below the upper and above the lower lid (m).
_SHADE_WIDTH = (3.6e-3, 1.3e-3)


def eyes(person: Person, identity: Identity) -> list[MeshPiece]:
    """Both eyes of a subject: eyeball, cornea, tear line and caruncle each.

    The eyeball (material "eye") has `parameters["texture"]`, a (512, 512, 3) float32 linear albedo
    whose row 0 is v = 1, its disc `uv`, and the vertex input `radial`, the angle from the optic
    axis in radians. Corneas ("cornea"), tear lines ("tear") and the shade that the lids cast
    ("lid_shade", with the vertex input `shade` in [0, 1]) are hidden from the labels.
    """
    rng = np.random.default_rng(person.eyes.seed)
    pupil = float(np.clip(person.eyes.pupil_mm / _IRIS_MM, 0.15, 0.6))
    texture = eye_texture(person.eyes, _LIMBUS, pupil, rng)
    pieces: list[MeshPiece] = []
    for name, part in (("eye_left", Part.LEFT_EYE), ("eye_right", Part.RIGHT_EYE)):
        centre, radius = eyeball(identity, name)
        # The other eye has the mirrored texture: vessels thicken towards both corners.
        picture = texture if name == "eye_left" else texture[:, ::-1]
        ball = _lathe(_eyeball_profile())
        pieces.append(
            MeshPiece(
                name,
                part,
                ball.faces,
                "eye",
                _sunk(name, centre, radius * ball.points),
                {"texture": np.ascontiguousarray(picture), "iris_angle": _LIMBUS},
                ball.disc_uv(),
                {"radial": ball.theta},
            )
        )
        shell = _lathe(_cornea_profile())
        pieces.append(
            MeshPiece(
                name.replace("eye", "cornea"),
                part,
                shell.faces,
                "cornea",
                _sunk(name, centre, radius * shell.points),
                {"ior": 1.376},
                hidden_from_labels=True,
            )
        )
        pieces += [*_lid_pieces(name, part), _lid_shade(name, part)]
    return pieces


def _sink(bust: Bust, name: str) -> float:
    """By what share of its radius an eye shrinks behind its lid, which the cornea would pierce."""
    side = name.removeprefix("eye_").capitalize()
    closed = np.array(bust.pose.expression.get(f"eyeBlink{side}", 0.0))
    return 0.08 * float(smoothstep(0.35, 1.0, closed))


def _sunk(name: str, centre: np.ndarray, offset: np.ndarray) -> Callable[[Bust], np.ndarray]:
    """A `place` of points at `offset` (V, 3) from an eye's centre that turn with its gaze."""

    def place(bust: Bust) -> np.ndarray:
        return moved(centre + (1 - _sink(bust, name)) * offset, bust.bones[name])

    return place


def eyeball(identity: Identity, name: str) -> tuple[np.ndarray, float]:
    """Centre (3,) and radius in metres of "eye_left" or "eye_right" at rest.

    The least-squares sphere through the head model's own eye vertices, so it follows their shape.
    """
    return _fit_sphere(identity.rest[identity.model.groups[name]])


def _posed_eyeball(bust: Bust, name: str) -> tuple[np.ndarray, float]:
    """`eyeball` of a bust in the head's unposed frame, shrunk as far as its lid is closed."""
    centre, radius = eyeball(bust.identity, name)
    return centre, radius * (1 - _sink(bust, name))


def _fit_sphere(points: np.ndarray) -> tuple[np.ndarray, float]:
    system = np.concatenate([2 * points, np.ones((len(points), 1))], axis=1)
    solution = np.linalg.lstsq(system, (points**2).sum(axis=1), rcond=None)[0]
    centre = solution[:3]
    return centre, float(np.sqrt(solution[3] + centre @ centre))


class _Lathe:
    """A surface of revolution about the optic axis from its pole outwards."""

    def __init__(self, theta: np.ndarray, points: np.ndarray, faces: np.ndarray):
        self.theta, self.points, self.faces = theta, points, faces

    def disc_uv(self) -> np.ndarray:
        phi = arctan2(self.points[:, 2], self.points[:, 0])
        radius = 0.5 * texture_radius(self.theta)
        uv = 0.5 + radius[:, None] * np.stack([np.cos(phi), np.sin(phi)], axis=1)
        return uv[self.faces]


def _lathe(profile: np.ndarray) -> _Lathe:
    """Turn a profile (K, 3) of (radius, forward, theta) into quads; its first row is the pole."""
    phi = np.arange(_SEGMENTS) * 2 * np.pi / _SEGMENTS
    radius, forward, theta = (profile[:, k, None] for k in range(3))
    ring = np.stack(
        np.broadcast_arrays(radius * np.cos(phi), -forward, radius * np.sin(phi)), axis=-1
    )
    index = np.arange(ring.shape[0] * _SEGMENTS).reshape(-1, _SEGMENTS)
    angle = np.broadcast_to(theta, index.shape).ravel().astype(np.float32)
    return _Lathe(angle, ring.reshape(-1, 3), tube_faces(index, flipped=True))


@lru_cache
def _eyeball_profile() -> np.ndarray:
    """Iris as a shallow bowl below the limbus, then the sclera to the back."""
    limbus_plane = np.cos(_LIMBUS)
    share = np.concatenate([[1e-3], np.linspace(0.08, 1, 20)])
    # The lens pushes the pupil's rim forward again; the root of the iris dips deepest.
    depth = 0.045 * (1 - share**6) + 0.03 * share * (1 - share)
    iris = np.stack(
        [share * IRIS_RATIO * 0.985, limbus_plane - 0.012 - depth, share * _LIMBUS], axis=1
    )
    theta = np.concatenate(
        [_LIMBUS + np.array([0.0, 0.02, 0.05]), np.linspace(_LIMBUS + 0.1, np.pi, 32)]
    )
    # The sclera's edge is rounded off towards the iris instead of ending in a step.
    sink = 0.012 * np.exp(-(((theta - _LIMBUS) / 0.03) ** 2))
    sclera = np.stack([(1 - sink) * np.sin(theta), (1 - sink) * np.cos(theta), theta], axis=1)
    return np.concatenate([iris, sclera])


@lru_cache
def _cornea_profile() -> np.ndarray:
    """A wet shell over the front of the eye that bulges over the iris."""
    theta = np.concatenate([[1e-3], np.linspace(0.03, np.radians(72), 40)])
    radius = _cornea_radius(theta)
    return np.stack([radius * np.sin(theta), radius * np.cos(theta), theta], axis=1)


def _cornea_radius(theta: np.ndarray) -> np.ndarray:
    inside = np.clip(1 - (theta / (_LIMBUS * 1.12)) ** 2, 0, 1)
    return 1.006 + _CORNEA_BULGE * inside**1.5


class _Lids:
    """The skin around one eye, refined as it is rendered, to find where it meets the eyeball."""

    def __init__(self, model: HeadModel, name: str):
        self.name = name
        template = model.template
        ball = template[model.groups[name]]
        centre = ball.mean(axis=0)
        faces = model.faces["skin"]
        distance = np.linalg.norm(template[faces].mean(axis=1) - centre, axis=1)
        self.subdivision: Subdivision = catmull_clark(faces[distance < 0.032], len(template))
        quads = self.subdivision.faces
        edges = np.stack([quads, np.roll(quads, -1, axis=1)], axis=-1).reshape(-1, 2)
        self.edges = np.unique(np.sort(edges, axis=1), axis=0)

        # The inner corner is where the opening of the lids reaches farthest to the nose; it is
        # found once, on the template, and then followed by its vertices.
        points = self.subdivision.matrix @ template
        inward = np.pi if name == "eye_left" else 0.0
        phi = inward + np.linspace(-0.6, 0.6, 49)
        centre, radius = _fit_sphere(ball)
        theta = self._contact(points, centre, radius, phi)
        k = int(np.argmax(theta))
        corner = centre + _polar(theta[k], phi[k], np.array(radius))
        used = np.unique(quads)
        near = used[np.argsort(np.linalg.norm(points[used] - corner, axis=1))[:6]]
        self.corner = self.subdivision.matrix[near]

    def inner_corner(self, bust: Bust) -> np.ndarray:
        """(3,) the inner canthus in the head's unposed frame."""
        return (self.corner @ bust.unposed).mean(axis=0)

    def contact(self, bust: Bust, centre: np.ndarray, radius: float, phi: np.ndarray) -> np.ndarray:
        """Smallest angle theta (N,) at which the lids touch the eyeball at azimuths `phi`.

        In the head's unposed frame; azimuths without any contact take their neighbours'.
        """
        return self._contact(self.subdivision.matrix @ bust.unposed, centre, radius, phi)

    def _contact(
        self, vertices: np.ndarray, centre: np.ndarray, radius: float, phi: np.ndarray
    ) -> np.ndarray:
        points = (vertices - centre) / radius
        height = np.linalg.norm(points, axis=1) - 1.0
        a, b = self.edges.T
        crossing = (height[a] < 0) != (height[b] < 0)
        a, b = a[crossing], b[crossing]
        t = (height[a] / (height[a] - height[b]))[:, None]
        hit = points[a] + t * (points[b] - points[a])
        hit = hit[hit[:, 1] < 0]
        theta = arctan2(np.hypot(hit[:, 0], hit[:, 2]), -hit[:, 1])
        azimuth = arctan2(hit[:, 2], hit[:, 0])
        # The innermost contact in each azimuth bin; bins without one are bridged.
        bins = 96
        which = np.floor((azimuth / (2 * np.pi) % 1.0) * bins).astype(int) % bins
        inner = np.full(bins, np.inf)
        np.minimum.at(inner, which, theta)
        known = np.flatnonzero(np.isfinite(inner))
        if len(known) == 0:
            return np.full(len(phi), np.pi / 2)
        place = (known + 0.5) * 2 * np.pi / bins
        return np.interp(phi % (2 * np.pi), place, inner[known], period=2 * np.pi)


@lru_cache(maxsize=4)
def _lids(model: HeadModel, name: str) -> _Lids:
    return _Lids(model, name)


def _lid_pieces(name: str, part: Part) -> list[MeshPiece]:
    """The tear line along the lower lid and the caruncle in the inner corner."""
    inner = np.pi if name == "eye_left" else 2 * np.pi
    outer = 2 * np.pi if name == "eye_left" else np.pi
    phi = np.linspace(inner, outer, _TEAR_SAMPLES)
    # The meniscus' cross-section: millimetres along the eyeball from the lid, and above it.
    along = np.array([-0.75, -0.35, 0.0, 0.35])
    above = np.array([0.02, 0.14, 0.42, 0.85])

    def tear(bust: Bust) -> np.ndarray:
        centre, radius = _posed_eyeball(bust, name)
        theta = _lids(bust.model, name).contact(bust, centre, radius, phi)
        kernel = np.ones(5) / 5
        theta = np.convolve(np.pad(theta, 2, mode="edge"), kernel, mode="valid")
        taper = np.sin(np.linspace(0.05, 1, _TEAR_SAMPLES) * np.pi * 0.97)[:, None] ** 0.5
        angle = theta[:, None] + taper * along * 1e-3 / radius
        distance = radius * 1.006 + taper * above * 1e-3
        points = centre + _polar(angle, phi[:, None], distance).reshape(-1, 3)
        return moved(points, bust.bones["head"])

    rows = np.arange(_TEAR_SAMPLES * 4).reshape(-1, 4)
    strip = np.stack([rows[:-1, :-1], rows[1:, :-1], rows[1:, 1:], rows[:-1, 1:]], axis=-1)
    bead = _lathe(
        np.array([[np.sin(t) + 1e-3, np.cos(t), t] for t in np.linspace(0, np.pi * 0.5, 8)])
    )

    def caruncle(bust: Bust) -> np.ndarray:
        centre, radius = _posed_eyeball(bust, name)
        corner = _lids(bust.model, name).inner_corner(bust) - centre
        seat = corner + (1.1e-3 if name == "eye_left" else -1.1e-3) * np.array([1, 0, 0])
        seat *= (radius - 0.2e-3) / np.linalg.norm(seat)
        axes = np.array([0.0020, 0.0010, 0.0014])
        return moved(centre + seat + bead.points * axes, bust.bones["head"])

    return [
        MeshPiece(
            name.replace("eye", "tear"),
            part,
            strip.reshape(-1, 4).astype(np.int32),
            "tear",
            tear,
            {"ior": 1.336},
            hidden_from_labels=True,
        ),
        MeshPiece(
            name.replace("eye", "caruncle"),
            part,
            bead.faces,
            "gums",  # the same wet mucous tissue
            caruncle,
            {"colour": (0.55, 0.22, 0.18)},
        ),
    ]


def _lid_shade(name: str, part: Part) -> MeshPiece:
    """A band on the eye along both lids, dark under them: they and the lashes keep light away."""
    phi = np.arange(_SHADE_SAMPLES) * 2 * np.pi / _SHADE_SAMPLES
    upper = smoothstep(-0.35, 0.35, np.sin(phi))
    width = _SHADE_WIDTH[1] + (_SHADE_WIDTH[0] - _SHADE_WIDTH[1]) * upper
    share, dark = _SHADE_ROWS.T
    shade = dark * (0.6 + 0.4 * upper[:, None])

    def place(bust: Bust) -> np.ndarray:
        centre, radius = _posed_eyeball(bust, name)
        theta = _lids(bust.model, name).contact(bust, centre, radius, phi)
        theta = np.convolve(np.pad(theta, 2, mode="wrap"), np.ones(5) / 5, mode="valid")
        inwards = np.minimum(width / radius, 0.6 * theta)
        angle = theta[:, None] - share * inwards[:, None]
        # Over the cornea, which it would otherwise cut.
        distance = radius * (_cornea_radius(angle) + 0.004)
        points = centre + _polar(angle, phi[:, None], distance).reshape(-1, 3)
        return moved(points, bust.bones["head"])

    index = np.arange(_SHADE_SAMPLES * len(share)).reshape(_SHADE_SAMPLES, -1).T
    return MeshPiece(
        name.replace("eye", "lid_shade"),
        part,
        tube_faces(index),
        "lid_shade",
        place,
        vertex={"shade": shade.ravel()},
        hidden_from_labels=True,
    )


def _polar(theta: np.ndarray, phi: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Points (..., 3) in the frame of the eye."""
    x = np.sin(theta) * np.cos(phi)
    z = np.sin(theta) * np.sin(phi)
    return np.stack([x, -np.cos(theta), z], axis=-1) * np.asarray(distance)[..., None]
