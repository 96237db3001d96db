"""Where a face folds: named curves on the template, as seen from in front.

Points are (x, z) in millimetres from the template's origin, on the subject's left where x > 0; a
fold that each side has is given on the left, and `creases` mirrors it. Anatomy after Ekman &
Friesen's action units: folds lie across the pull of the muscles that the ARKit actions stand for.
"""

from __future__ import annotations

from dataclasses import dataclass

from assets_procedural.motion.expressions import Actions

Points = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Fold:
    """A bundle of valleys that one muscle folds.

    `curves`: polylines; `width` of the valley, mm; `depth` at full strength, mm; `ageing`: depth
    at rest of the most wrinkled face, as a share; `smooth`: the same of the smoothest; `pulls`:
    share of the depth that each action adds, without its side; `bulge`: height of the shoulder
    to the right of the curve's direction (below 0, to the left) as a share of the depth; `often`:
    the chance that a curve is as deep as that and not a quarter of it; `sided`: whether each side
    of the face has its own.
    """

    curves: tuple[Points, ...]
    width: float
    depth: float
    ageing: float
    smooth: float
    pulls: Actions
    bulge: float = 0.0
    often: float = 1.0
    sided: bool = True


FOLDS: dict[str, Fold] = {
    # From the wing of the nose round the corner of the mouth; the cheek stands over it.
    "nasolabial": Fold(
        (((18.6, 691.5), (21.5, 688), (25.5, 681.5), (29.5, 673.5), (32.5, 665), (33.3, 657.5)),),
        width=2.3, depth=1.15, ageing=0.62, smooth=0.13, bulge=-0.55,
        pulls={"mouthSmile": 0.55, "noseSneer": 0.4, "mouthUpperUp": 0.3, "cheekSquint": 0.15,
               "mouthDimple": 0.2, "mouthStretch": 0.2},
    ),
    "marionette": Fold(
        (((27.2, 657.5), (29.6, 652), (31.2, 645), (31.0, 637), (29.5, 631)),),
        width=2.0, depth=0.8, ageing=0.6, smooth=0.04, bulge=-0.3,
        pulls={"mouthFrown": 0.5, "mouthPress": 0.2, "mouthStretch": 0.15},
    ),
    "mouth_corner": Fold(
        (((26.0, 661.2), (28.6, 659.6), (30.2, 656.8)),),
        width=1.5, depth=0.6, ageing=0.55, smooth=0.3,
        pulls={"mouthSmile": 0.3, "mouthDimple": 0.6, "mouthPress": 0.3, "mouthFrown": 0.3},
    ),
    "smile_line": Fold(
        (((37.5, 671), (39.5, 663), (39.5, 655), (37.5, 648)),),
        width=2.4, depth=0.55, ageing=0.3, smooth=0.0, bulge=-0.3,
        pulls={"mouthSmile": 0.5, "mouthDimple": 0.4, "mouthStretch": 0.4},
    ),
    # The trough under the eye, and the bag above it.
    "trough": Fold(
        (((19.5, 721), (23.5, 717), (29.5, 713.6), (36.5, 713), (42.5, 715.2)),),
        width=2.6, depth=0.75, ageing=0.75, smooth=0.2, bulge=-0.8,
        pulls={"cheekSquint": 0.3, "mouthSmile": 0.15, "eyeSquint": 0.15},
    ),
    "lower_lid": Fold(
        (((20.5, 722.6), (27, 719.4), (34.5, 718.6), (41.5, 721)),
         ((24.5, 719.2), (31, 716.2), (38.5, 716.2), (44, 719.6)),
         ((33, 721.4), (39.5, 722), (44.5, 724.2))),
        width=0.95, depth=0.42, ageing=0.65, smooth=0.06, often=0.9,
        pulls={"eyeSquint": 0.6, "cheekSquint": 0.6, "mouthSmile": 0.15, "eyeBlink": 0.15},
    ),
    "malar": Fold(
        (((29, 707.5), (36, 704.6), (44, 704.8), (51, 709)),
         ((37, 710.5), (44.5, 711), (51.5, 715))),
        width=1.7, depth=0.5, ageing=0.55, smooth=0.0, often=0.8, bulge=-0.3,
        pulls={"cheekSquint": 0.5, "mouthSmile": 0.15},
    ),
    "crows_feet": Fold(
        (((48.5, 729.5), (53.5, 731.3), (59, 734.5), (62.5, 738)),
         ((49.3, 727.6), (55, 727.8), (61.5, 729.3)),
         ((49, 725.6), (54, 723.8), (60.5, 722.2)),
         ((47.6, 723.6), (52.3, 719.8), (57.5, 716.2)),
         ((52, 729.9), (57, 731.2), (61, 732.2)),
         ((51, 721.8), (55.5, 719.6), (59.5, 719.2))),
        width=1.05, depth=0.62, ageing=0.55, smooth=0.0, often=0.85,
        pulls={"cheekSquint": 0.55, "eyeSquint": 0.4, "mouthSmile": 0.25, "eyeBlink": 0.1},
    ),
    "bunny": Fold(
        (((3.5, 727), (7, 724.6), (9.3, 720.6)), ((2.8, 721.5), (6.6, 720.2), (9.4, 716.2))),
        width=1.0, depth=0.55, ageing=0.22, smooth=0.0,
        pulls={"noseSneer": 0.9, "eyeSquint": 0.1, "cheekSquint": 0.1},
    ),
    "glabella": Fold(
        (((6.6, 737), (7.6, 742.5), (7.4, 749), (8.8, 756)),),
        width=1.45, depth=0.85, ageing=0.62, smooth=0.03, often=0.9,
        pulls={"browDown": 0.75, "noseSneer": 0.15},
    ),
    "procerus": Fold(
        (((-8, 735.5), (-3.5, 733.6), (3.5, 733.6), (8, 735.5)),
         ((-6, 731), (0, 729.8), (6, 731))),
        width=1.3, depth=0.6, ageing=0.5, smooth=0.0, sided=False,
        pulls={"browDown": 0.35, "noseSneer": 0.6},
    ),
    # Each side folds as its brow rises; the middle follows the inner ends.
    "forehead": Fold(
        (((-1, 762), (8, 763.2), (20, 766), (32, 766.5), (43, 763)),
         ((-1, 768.4), (9, 769.4), (21, 772.4), (33, 772.8), (44, 769)),
         ((-1, 775), (9, 776), (21, 778.8), (32, 779.2), (42, 776)),
         ((-1, 782), (10, 783), (20, 785), (29, 785.2)),
         ((-1, 788.4), (8, 789), (16, 790))),
        width=1.55, depth=0.72, ageing=0.6, smooth=0.02, often=0.85, bulge=-0.12,
        pulls={"browOuterUp": 0.65, "browInnerUp": 0.5, "eyeWide": 0.15},
    ),
    "chin": Fold(
        (((-15, 641.4), (-7, 643.6), (7, 643.6), (15, 641.4)),),
        width=2.6, depth=0.8, ageing=0.5, smooth=0.22, sided=False,
        pulls={"mouthShrugLower": 0.5, "mouthFrown": 0.2, "mouthPucker": 0.2},
    ),
    # Above the red of the lips; deep in old women and smokers.
    "perioral": Fold(
        (((3.6, 673.6), (3.9, 678.5)), ((7.6, 674.2), (8.4, 680.2)), ((11.4, 673.8), (12.8, 680)),
         ((15, 672.3), (17.2, 678.6)), ((18.4, 670), (21.4, 675.6)), ((9.4, 674), (10.4, 677.5))),
        width=0.85, depth=0.36, ageing=0.8, smooth=0.0, often=0.8,
        pulls={"mouthPucker": 0.5, "mouthFunnel": 0.25},
    ),
    "neck": Fold(
        (((-32, 595), (-18, 592.5), (0, 591), (18, 592.5), (32, 595)),
         ((-34, 606), (-18, 603.5), (0, 602.5), (18, 603.5), (34, 606))),
        width=1.8, depth=0.7, ageing=0.7, smooth=0.16, often=0.75, sided=False, pulls={},
    ),
}  # fmt: skip
"""By name. The order matters: each person's own folds are drawn in it."""
